//! How far a keypoint lies from the projection of its point by a camera that reads its rows one after the
//! other.

use super::calibrated_reprojection::{CalibratedReprojectionFactor, CorrectionVector};
use geometry::Pose;
use geometry::nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector6};
use optim::{Factor, Linearized};

/// The members of a [`CameraCorrection`](geometry::CameraCorrection) in their order, then the readout,
/// seconds.
pub type RollingCamera = SVector<f64, 6>;

/// Distance between a keypoint and the projection of its point, in standard deviations, with the camera's
/// correction and the readout of its shutter as unknowns.
///
/// `r(T, (c, ρ), X) = r_c(exp(ρ m) U⁻¹ T, c, X)`, where `r_c` is that of a [`CalibratedReprojectionFactor`],
/// `ρ` the readout in seconds and `m` how the camera moves from its middle row to that of the keypoint in a
/// readout of a second: its velocity in its own frame, rotation first, times the row's share of the readout.
/// `U` is the same motion as far as it was taken out of the keypoint's place already.
#[derive(Clone, Copy, Debug)]
pub struct RolledReprojectionFactor {
    /// As a camera sees it that reads all rows at once.
    pub still: CalibratedReprojectionFactor,
    /// The motion `m`, radians and map units.
    pub motion: Vector6<f64>,
    /// The inverse of the motion `U`.
    pub middle_from_place: Pose,
}

fn parts(camera: &RollingCamera) -> (CorrectionVector, f64) {
    (camera.fixed_rows::<5>(0).into_owned(), camera[5])
}

impl Factor for RolledReprojectionFactor {
    type Residual = Vector2<f64>;
    type Variables = (Pose, RollingCamera, Vector3<f64>);

    #[inline]
    fn residual(
        &self,
        (camera_from_world, camera, point): (&Pose, &RollingCamera, &Vector3<f64>),
    ) -> Option<Vector2<f64>> {
        let (correction, readout_s) = parts(camera);
        let at_row = Pose::exp(&(self.motion * readout_s)) * self.middle_from_place * *camera_from_world;
        self.still.residual((&at_row, &correction, point))
    }

    #[inline]
    fn linearize(
        &self,
        (camera_from_world, camera, point): (&Pose, &RollingCamera, &Vector3<f64>),
    ) -> Option<Linearized<Self>> {
        let (correction, readout_s) = parts(camera);
        let row_from_middle = Pose::exp(&(self.motion * readout_s)) * self.middle_from_place;
        let at_row = row_from_middle * *camera_from_world;
        let (residual, (by_pose_at_row, by_correction, by_point)) =
            self.still.linearize((&at_row, &correction, point))?;
        let mut by_camera = SMatrix::<f64, 2, 6>::zeros();
        by_camera.fixed_view_mut::<2, 5>(0, 0).copy_from(&by_correction);
        by_camera.set_column(5, &(by_pose_at_row * self.motion));
        Some((residual, (by_pose_at_row * row_from_middle.adjoint(), by_camera, by_point)))
    }
}

/// What was known of the camera before, member by member: `r(c) = (c − m) / σ`.
#[derive(Clone, Copy, Debug)]
pub struct RollingCameraPriorFactor {
    /// The expectation `m`.
    pub mean: RollingCamera,
    /// One over the standard deviations.
    pub inverse_sigmas: RollingCamera,
}

impl Factor for RollingCameraPriorFactor {
    type Residual = RollingCamera;
    type Variables = (RollingCamera,);

    fn residual(&self, (camera,): (&RollingCamera,)) -> Option<RollingCamera> {
        Some(self.inverse_sigmas.component_mul(&(camera - self.mean)))
    }

    fn linearize(&self, (camera,): (&RollingCamera,)) -> Option<Linearized<Self>> {
        Some((self.residual((camera,))?, (SMatrix::from_diagonal(&self.inverse_sigmas),)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pinhole;

    #[test]
    fn jacobians_match_central_differences() {
        let nominal = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };
        for seed in 0..32 {
            let s = f64::from(seed);
            let pose = Pose::exp(&Vector6::new(s.sin(), 0.3 * s.cos(), 0.1 * s, 0.2, -0.3 * s.sin(), 0.4));
            let point = pose.inverse().transform(&Vector3::new(s.cos(), (2.0 * s).sin(), 3.0 + s.sin()));
            let camera = RollingCamera::from([
                0.04 * s.sin(),
                0.02 * s.cos(),
                0.01,
                0.03 * s.cos(),
                0.02,
                0.05 * (2.0 * s).sin(),
            ]);
            let still = CalibratedReprojectionFactor {
                nominal,
                observed_px: Vector2::new(300.0 + s, 200.0 - s),
                inverse_sigma: 1.0 / (1.0 + 0.1 * s),
            };
            let motion = Vector6::new(0.3, -0.4 * s.cos(), 0.2, 0.5, 0.3 * s.sin(), -0.4);
            let middle_from_place = Pose::exp(&(motion * -0.03 * s.cos()));
            let factor = RolledReprojectionFactor { still, motion, middle_from_place };
            optim::testing::assert_jacobians_match(&factor, &(pose, camera, point), 1e-6, 1e-5);
            let inverse_sigmas = RollingCamera::from([100.0, 50.0, 20.0, 10.0, 30.0, 7.0]);
            let prior = RollingCameraPriorFactor { mean: camera * 0.3, inverse_sigmas };
            optim::testing::assert_jacobians_match(&prior, &(camera,), 1e-6, 1e-5);
        }
    }
}
