//! How well a similarity between two pieces of map carries a point of each into the view of the other.

use super::point_reprojection::MIN_DEPTH;
use geometry::nalgebra::{Matrix2x3, Matrix3, SMatrix, Vector2, Vector3, Vector4};
use geometry::{Pinhole, Pose, Similarity, so3};
use optim::{Factor, Linearized};

/// Two estimates of the same point, each held against the keypoint that sees the other.
///
/// `r(S) = [(z_t − π(T_t · S · X_s)) / σ_t, (z_s − π(T_s · S⁻¹ · X_t)) / σ_s]`, where `S` is
/// `target_from_source` (worlds of reference, each in its own map units), `X` the point in either world, `T`
/// a `camera_from_world` of either side, `z` its undistorted keypoint (pixels) and `σ` the keypoint's
/// standard deviation (pixels). Not defined for points behind a camera.
/// [method: Loop detection and correction]
#[derive(Clone, Copy, Debug)]
pub struct SimilarityReprojectionFactor {
    /// The sighting of the point on the target's side.
    pub target: PlacedSighting,
    /// The sighting of the same point on the source's side.
    pub source: PlacedSighting,
}

/// A point of a map with one of the keypoints that see it.
#[derive(Clone, Copy, Debug)]
pub struct PlacedSighting {
    /// The ideal camera.
    pub pinhole: Pinhole,
    /// Pose of the camera that sees the point, map units of this side.
    pub camera_from_world: Pose,
    /// The point in the world of this side, map units.
    pub point: Vector3<f64>,
    /// The undistorted keypoint, pixels.
    pub observed_px: Vector2<f64>,
    /// One over the standard deviation of the keypoint's position, 1/pixels.
    pub inverse_sigma: f64,
}

impl PlacedSighting {
    /// How far the keypoint lies from the projection of a point of this side's world, in standard deviations.
    pub fn residual(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let in_camera = self.camera_from_world.transform(point);
        (in_camera.z > MIN_DEPTH)
            .then(|| (self.observed_px - self.pinhole.project(&in_camera)) * self.inverse_sigma)
    }

    /// The same with its derivative by the point.
    fn linearize(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let in_camera = self.camera_from_world.transform(point);
        if in_camera.z <= MIN_DEPTH {
            return None;
        }
        let (projected, d_projection) = self.pinhole.project_with_jacobian(&in_camera);
        let residual = (self.observed_px - projected) * self.inverse_sigma;
        Some((residual, d_projection * self.camera_from_world.rotation_matrix() * -self.inverse_sigma))
    }
}

impl SimilarityReprojectionFactor {
    /// The squared residuals on the target's and on the source's side, `None` where there is none.
    pub fn squared_residuals(&self, target_from_source: &Similarity) -> Option<(f64, f64)> {
        let in_target = self.target.residual(&target_from_source.transform(&self.source.point))?;
        let in_source = self.source.residual(&target_from_source.inverse().transform(&self.target.point))?;
        Some((in_target.norm_squared(), in_source.norm_squared()))
    }
}

impl Factor for SimilarityReprojectionFactor {
    type Residual = Vector4<f64>;
    type Variables = (Similarity,);

    fn residual(&self, (target_from_source,): (&Similarity,)) -> Option<Vector4<f64>> {
        let in_target = self.target.residual(&target_from_source.transform(&self.source.point))?;
        let in_source = self.source.residual(&target_from_source.inverse().transform(&self.target.point))?;
        Some(Vector4::new(in_target.x, in_target.y, in_source.x, in_source.y))
    }

    fn linearize(&self, (target_from_source,): (&Similarity,)) -> Option<Linearized<Self>> {
        let source_from_target = target_from_source.inverse();
        let moved = target_from_source.transform(&self.source.point);
        let (in_target, d_target_d_point) = self.target.linearize(&moved)?;
        let (in_source, d_source_d_point) =
            self.source.linearize(&source_from_target.transform(&self.target.point))?;
        // exp(δ) moves y to y + ω × y + v + σ y; the inverse undoes that before it goes back to the source.
        let d_back =
            source_from_target.rotation.to_rotation_matrix().into_inner() * -source_from_target.scale;
        let mut d_residual = SMatrix::<f64, 4, 7>::zeros();
        d_residual.fixed_rows_mut::<2>(0).copy_from(&(d_target_d_point * d_moved_d_similarity(&moved)));
        d_residual
            .fixed_rows_mut::<2>(2)
            .copy_from(&(d_source_d_point * d_back * d_moved_d_similarity(&self.target.point)));
        Some((Vector4::new(in_target.x, in_target.y, in_source.x, in_source.y), (d_residual,)))
    }
}

/// Derivative of `exp(δ) · y` by `δ = [rotation, translation, log scale]` at zero.
pub(super) fn d_moved_d_similarity(y: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut derivative = SMatrix::<f64, 3, 7>::zeros();
    derivative.fixed_columns_mut::<3>(0).copy_from(&-so3::skew(y));
    derivative.fixed_columns_mut::<3>(3).copy_from(&Matrix3::identity());
    derivative.column_mut(6).copy_from(y);
    derivative
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::{SVector, Vector6};

    #[test]
    fn jacobians_match_central_differences() {
        let pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };
        for seed in 0..32 {
            let s = f64::from(seed);
            let target_from_source =
                Similarity::exp(&SVector::from_fn(|i, _| 0.5 * (s * (1.3 + i as f64)).sin()));
            let sighting = |camera_from_world: Pose, shift: f64| PlacedSighting {
                pinhole,
                camera_from_world,
                point: camera_from_world.inverse().transform(&Vector3::new(
                    (s + shift).cos(),
                    (2.0 * s).sin(),
                    5.0 + s.sin(),
                )),
                observed_px: Vector2::new(300.0 + s, 200.0 - s),
                inverse_sigma: 1.0 / (1.0 + 0.1 * s),
            };
            let target_camera = Pose::exp(&Vector6::new(0.3 * s.sin(), 0.1, 0.2, 0.2, -0.3 * s.sin(), 0.4));
            // Such that what one camera sees the other sees as well.
            let source_camera = (Similarity::from_pose(&target_camera) * target_from_source).pose_part();
            let factor = SimilarityReprojectionFactor {
                target: sighting(target_camera, 0.0),
                source: sighting(source_camera, 0.1),
            };
            optim::testing::assert_jacobians_match(&factor, &(target_from_source,), 1e-6, 1e-5);
        }
    }
}
