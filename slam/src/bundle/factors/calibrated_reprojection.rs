//! How far a keypoint lies from the projection of its point by a camera that is not exactly known.

use super::point_reprojection::MIN_DEPTH;
use crate::map::Keyframe;
use geometry::nalgebra::{Matrix2, Matrix2x3, Matrix2x6, SMatrix, SVector, Vector2, Vector3};
use geometry::{CameraCorrection, Pinhole, Pose, so3};
use optim::{Factor, Linearized};

/// The members of a [`CameraCorrection`] in their order.
pub type CorrectionVector = SVector<f64, 5>;

/// Distance between a keypoint and the projection of its point, in standard deviations, with the camera's
/// focal length, principal point and radial distortion as unknowns.
///
/// `r(T, c, X) = (z − π_c(T · X)) / σ` as in [`PointReprojectionFactor`](super::PointReprojectionFactor),
/// where `c = (focal, center_x, center_y, k1, k2)` are the members of a [`CameraCorrection`], and `z` is in
/// the undistorted pixels of the calibration. Not defined where the distortion folds back.
#[derive(Clone, Copy, Debug)]
pub struct CalibratedReprojectionFactor {
    /// The ideal camera of the calibration.
    pub nominal: Pinhole,
    /// The keypoint undistorted by the calibration alone, pixels.
    pub observed_px: Vector2<f64>,
    /// One over the standard deviation of the keypoint's position, 1/pixels.
    pub inverse_sigma: f64,
}

impl CalibratedReprojectionFactor {
    /// Of a keypoint of a keyframe.
    pub(crate) fn of(keyframe: &Keyframe, feature_idx: usize) -> Self {
        Self {
            nominal: keyframe.features.nominal_pinhole,
            observed_px: keyframe.features.nominal_px(feature_idx),
            inverse_sigma: 1.0 / keyframe.features.sigma_px(feature_idx),
        }
    }
}

/// A correction as a vector to be optimized.
pub fn correction_of(vector: &CorrectionVector) -> CameraCorrection {
    let [focal, center_x, center_y, k1, k2] = (*vector).into();
    CameraCorrection { focal, center_x, center_y, k1, k2 }
}

/// Reverses [`correction_of`].
pub fn vector_of(correction: &CameraCorrection) -> CorrectionVector {
    let CameraCorrection { focal, center_x, center_y, k1, k2 } = *correction;
    CorrectionVector::from([focal, center_x, center_y, k1, k2])
}

/// A point on the plane `z = 1` with what radial distortion does to it.
struct Bent {
    place: Vector2<f64>,
    r2: f64,
    factor: f64,
    /// Derivative of the factor by `r²`.
    d_factor: f64,
}

impl Bent {
    /// `None` behind the camera and where the distortion folds back.
    #[inline]
    fn of(in_camera: &Vector3<f64>, c: &CorrectionVector) -> Option<Self> {
        if in_camera.z <= MIN_DEPTH {
            return None;
        }
        let place = in_camera.xy() / in_camera.z;
        let r2 = place.norm_squared();
        let (factor, d_factor) = (1.0 + r2 * (c[3] + r2 * c[4]), c[3] + 2.0 * c[4] * r2);
        (factor + 2.0 * r2 * d_factor > 0.0).then_some(Self { place, r2, factor, d_factor })
    }
}

impl Factor for CalibratedReprojectionFactor {
    type Residual = Vector2<f64>;
    type Variables = (Pose, CorrectionVector, Vector3<f64>);

    #[inline]
    fn residual(
        &self,
        (camera_from_world, correction, point): (&Pose, &CorrectionVector, &Vector3<f64>),
    ) -> Option<Vector2<f64>> {
        let bent = Bent::of(&camera_from_world.transform(point), correction)?;
        let pinhole = correction_of(correction).apply(&self.nominal);
        Some((self.observed_px - pinhole.denormalized(&(bent.place * bent.factor))) * self.inverse_sigma)
    }

    #[inline]
    fn linearize(
        &self,
        (camera_from_world, correction, point): (&Pose, &CorrectionVector, &Vector3<f64>),
    ) -> Option<Linearized<Self>> {
        let rotation = camera_from_world.rotation_matrix();
        let in_camera = rotation * point + camera_from_world.translation;
        let Bent { place, r2, factor, d_factor } = Bent::of(&in_camera, correction)?;
        let Pinhole { fx, fy, .. } = self.nominal;
        let pinhole = correction_of(correction).apply(&self.nominal);
        let (seen, inverse_z) = (place * factor, 1.0 / in_camera.z);
        let residual = (self.observed_px - pinhole.denormalized(&seen)) * self.inverse_sigma;
        let focals = Matrix2::new(pinhole.fx, 0.0, 0.0, pinhole.fy);
        let d_seen_d_place = Matrix2::identity() * factor + place * place.transpose() * (2.0 * d_factor);
        let d_place_d_in_camera =
            Matrix2x3::new(inverse_z, 0.0, -place.x * inverse_z, 0.0, inverse_z, -place.y * inverse_z);
        let d_residual_d_in_camera: Matrix2x3<f64> =
            focals * d_seen_d_place * d_place_d_in_camera * -self.inverse_sigma;
        let mut d_residual_d_pose = Matrix2x6::zeros();
        d_residual_d_pose
            .fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&(d_residual_d_in_camera * -so3::skew(&in_camera)));
        d_residual_d_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&d_residual_d_in_camera);
        let (by_k1, by_k2) = (focals * place * r2, focals * place * (r2 * r2));
        let d_residual_d_correction = SMatrix::<f64, 2, 5>::from_columns(&[
            Vector2::new(fx * seen.x, fy * seen.y),
            Vector2::new(fx, 0.0),
            Vector2::new(0.0, fy),
            by_k1,
            by_k2,
        ]) * -self.inverse_sigma;
        Some((residual, (d_residual_d_pose, d_residual_d_correction, d_residual_d_in_camera * rotation)))
    }
}

/// What was known of the camera before its images.
///
/// `r(c) = (ln(1 + focal) − m₁, center_x − m₂, center_y − m₃, k1 − m₄, k2 − k1²) / σ`, member by member. The
/// second coefficient of a lens goes with the square of the first: so the two together bend an image all the
/// way out and do not fold it back.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationPriorFactor {
    /// The expectation `m`; its last member counts for nothing.
    pub mean: CorrectionVector,
    /// One over the standard deviations.
    pub inverse_sigmas: CorrectionVector,
}

impl Factor for CalibrationPriorFactor {
    type Residual = CorrectionVector;
    type Variables = (CorrectionVector,);

    fn residual(&self, (correction,): (&CorrectionVector,)) -> Option<CorrectionVector> {
        let [focal, center_x, center_y, k1, k2] = (*correction).into();
        let mut difference = CorrectionVector::from([focal.ln_1p(), center_x, center_y, k1, 0.0]) - self.mean;
        difference[4] = k2 - k1 * k1;
        (focal > -1.0).then(|| self.inverse_sigmas.component_mul(&difference))
    }

    fn linearize(&self, (correction,): (&CorrectionVector,)) -> Option<Linearized<Self>> {
        let mut jacobian = SMatrix::<f64, 5, 5>::from_diagonal(&self.inverse_sigmas);
        jacobian[(0, 0)] /= 1.0 + correction[0];
        jacobian[(4, 3)] = -2.0 * correction[3] * self.inverse_sigmas[4];
        Some((self.residual((correction,))?, (jacobian,)))
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
            let correction =
                CorrectionVector::from([2.0 * s.sin(), s.cos(), (3.0 * s).sin(), 4.0 * s.cos(), 1.0]) * 0.02;
            let factor = CalibratedReprojectionFactor {
                nominal,
                observed_px: Vector2::new(300.0 + s, 200.0 - s),
                inverse_sigma: 1.0 / (1.0 + 0.1 * s),
            };
            optim::testing::assert_jacobians_match(&factor, &(pose, correction, point), 1e-6, 1e-5);
            let prior = CalibrationPriorFactor {
                mean: correction * 0.3,
                inverse_sigmas: CorrectionVector::from([100.0, 50.0, 20.0, 10.0, 30.0]),
            };
            optim::testing::assert_jacobians_match(&prior, &(correction,), 1e-6, 1e-5);
        }
    }

    #[test]
    fn the_factor_sees_points_where_the_corrected_camera_does() {
        use geometry::{Camera, CameraModel, CameraParameters};
        let camera = Camera::new(CameraParameters {
            model: CameraModel::Pinhole,
            width: 752,
            height: 480,
            fx: 600.0,
            fy: 601.0,
            cx: 375.5,
            cy: 239.5,
            distortion: Vec::new(),
        })
        .unwrap();
        let correction =
            CameraCorrection { focal: -0.24, center_x: -0.01, center_y: 0.02, k1: -0.28, k2: 0.07 };
        let point = Vector3::new(0.7, -0.4, 1.2);
        let observed_px = camera.with_correction(correction).project(&point).unwrap();
        let factor =
            CalibratedReprojectionFactor { nominal: camera.pinhole(), observed_px, inverse_sigma: 1.0 };
        let residual = factor.residual((&Pose::identity(), &vector_of(&correction), &point)).unwrap();
        assert!(residual.norm() < 1e-9, "{residual}");
        let folded = CameraCorrection { k1: -0.9, k2: 0.0, ..correction };
        assert!(factor.residual((&Pose::identity(), &vector_of(&folded), &point)).is_none());
    }
}
