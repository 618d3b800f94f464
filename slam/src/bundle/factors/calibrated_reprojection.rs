//! How far a keypoint lies from the projection of its point by a camera that is not exactly known.

use super::point_reprojection::MIN_DEPTH;
use geometry::nalgebra::{Matrix2x3, Matrix2x6, Matrix3, Vector2, Vector3};
use geometry::{Pinhole, PinholeCorrection, Pose, so3};
use optim::{Factor, Linearized};

/// Distance between a keypoint and the projection of its point, in standard deviations, with the camera's
/// focal length and principal point as unknowns.
///
/// `r(T, c, X) = (z − π_c(T · X)) / σ` as in [`PointReprojectionFactor`](super::PointReprojectionFactor),
/// where `c = (focal, center_x, center_y)` are the members of a [`PinholeCorrection`].
#[derive(Clone, Copy, Debug)]
pub struct CalibratedReprojectionFactor {
    /// The ideal camera of the calibration.
    pub nominal: Pinhole,
    /// The undistorted keypoint, pixels.
    pub observed_px: Vector2<f64>,
    /// One over the standard deviation of the keypoint's position, 1/pixels.
    pub inverse_sigma: f64,
}

/// A correction as a vector to be optimized.
pub fn correction_of(vector: &Vector3<f64>) -> PinholeCorrection {
    PinholeCorrection { focal: vector.x, center_x: vector.y, center_y: vector.z }
}

/// Reverses [`correction_of`].
pub fn vector_of(correction: &PinholeCorrection) -> Vector3<f64> {
    Vector3::new(correction.focal, correction.center_x, correction.center_y)
}

impl Factor for CalibratedReprojectionFactor {
    type Residual = Vector2<f64>;
    type Variables = (Pose, Vector3<f64>, Vector3<f64>);

    #[inline]
    fn residual(
        &self,
        (camera_from_world, correction, point): (&Pose, &Vector3<f64>, &Vector3<f64>),
    ) -> Option<Vector2<f64>> {
        let in_camera = camera_from_world.transform(point);
        let pinhole = correction_of(correction).apply(&self.nominal);
        (in_camera.z > MIN_DEPTH)
            .then(|| (self.observed_px - pinhole.project(&in_camera)) * self.inverse_sigma)
    }

    #[inline]
    fn linearize(
        &self,
        (camera_from_world, correction, point): (&Pose, &Vector3<f64>, &Vector3<f64>),
    ) -> Option<Linearized<Self>> {
        let rotation = camera_from_world.rotation_matrix();
        let in_camera = rotation * point + camera_from_world.translation;
        if in_camera.z <= MIN_DEPTH {
            return None;
        }
        let Pinhole { fx, fy, .. } = self.nominal;
        let pinhole = correction_of(correction).apply(&self.nominal);
        let (projected, d_projection) = pinhole.project_with_jacobian(&in_camera);
        let residual = (self.observed_px - projected) * self.inverse_sigma;
        let d_residual_d_in_camera: Matrix2x3<f64> = d_projection * -self.inverse_sigma;
        let mut d_residual_d_pose = Matrix2x6::zeros();
        d_residual_d_pose
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(d_residual_d_in_camera * -so3::skew(&in_camera)));
        d_residual_d_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&d_residual_d_in_camera);
        let (x, y) = (in_camera.x / in_camera.z, in_camera.y / in_camera.z);
        let d_residual_d_correction = Matrix2x3::new(fx * x, fx, 0.0, fy * y, 0.0, fy) * -self.inverse_sigma;
        Some((residual, (d_residual_d_pose, d_residual_d_correction, d_residual_d_in_camera * rotation)))
    }
}

/// What the calibration says of the correction: that there is none, within its tolerance.
///
/// `r(c) = c / σ`, member by member.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationPriorFactor {
    /// One over the standard deviations of the members of `c`.
    pub inverse_sigmas: Vector3<f64>,
}

impl Factor for CalibrationPriorFactor {
    type Residual = Vector3<f64>;
    type Variables = (Vector3<f64>,);

    fn residual(&self, (correction,): (&Vector3<f64>,)) -> Option<Vector3<f64>> {
        Some(self.inverse_sigmas.component_mul(correction))
    }

    fn linearize(&self, (correction,): (&Vector3<f64>,)) -> Option<Linearized<Self>> {
        Some((self.residual((correction,))?, (Matrix3::from_diagonal(&self.inverse_sigmas),)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector6;

    #[test]
    fn jacobians_match_central_differences() {
        let nominal = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };
        for seed in 0..32 {
            let s = f64::from(seed);
            let pose = Pose::exp(&Vector6::new(s.sin(), 0.3 * s.cos(), 0.1 * s, 0.2, -0.3 * s.sin(), 0.4));
            let point = pose.inverse().transform(&Vector3::new(s.cos(), (2.0 * s).sin(), 3.0 + s.sin()));
            let correction = Vector3::new(s.sin(), s.cos(), (3.0 * s).sin()) * 0.02;
            let factor = CalibratedReprojectionFactor {
                nominal,
                observed_px: Vector2::new(300.0 + s, 200.0 - s),
                inverse_sigma: 1.0 / (1.0 + 0.1 * s),
            };
            optim::testing::assert_jacobians_match(&factor, &(pose, correction, point), 1e-6, 1e-5);
            let prior = CalibrationPriorFactor { inverse_sigmas: Vector3::new(100.0, 50.0, 20.0) };
            optim::testing::assert_jacobians_match(&prior, &(correction,), 1e-6, 1e-6);
        }
    }
}
