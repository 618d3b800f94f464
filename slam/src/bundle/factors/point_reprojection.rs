//! How far a keypoint lies from the projection of the point it observes.

use geometry::nalgebra::{Matrix2x3, Matrix2x6, Vector2, Vector3};
use geometry::{Pinhole, Pose};
use optim::{Factor, Linearized};

/// Points nearer than this to the camera's plane are not projected, map units: the first map's median depth
/// is 1.
pub(super) const MIN_DEPTH: f64 = 1e-4;

/// Distance between a keypoint and the projection of its point, in standard deviations.
///
/// `r(T, X) = (z − π(T · X)) / σ`, where `T` is `camera_from_world`, `X` the point in the world (map units),
/// `π` the ideal pinhole projection (pixels), `z` the undistorted keypoint (pixels) and `σ` its standard
/// deviation (pixels). [method: Point reprojection error]. Not defined for points behind the camera.
#[derive(Clone, Copy, Debug)]
pub struct PointReprojectionFactor {
    /// The ideal camera.
    pub pinhole: Pinhole,
    /// The undistorted keypoint, pixels.
    pub observed_px: Vector2<f64>,
    /// One over the standard deviation of the keypoint's position, 1/pixels.
    pub inverse_sigma: f64,
}

impl Factor for PointReprojectionFactor {
    type Residual = Vector2<f64>;
    type Variables = (Pose, Vector3<f64>);

    #[inline]
    fn residual(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Vector2<f64>> {
        let in_camera = camera_from_world.transform(point);
        (in_camera.z > MIN_DEPTH)
            .then(|| (self.observed_px - self.pinhole.project(&in_camera)) * self.inverse_sigma)
    }

    #[inline(always)]
    fn linearize(&self, (camera_from_world, point): (&Pose, &Vector3<f64>)) -> Option<Linearized<Self>> {
        let rotation = camera_from_world.rotation_matrix();
        let in_camera = rotation * point + camera_from_world.translation;
        if in_camera.z <= MIN_DEPTH {
            return None;
        }
        let (x, y, z) = (in_camera.x, in_camera.y, in_camera.z);
        let Pinhole { fx, fy, cx, cy } = self.pinhole;
        // d(residual)/d(in_camera) = [a 0 c; 0 b d]. Written out, since products with its zeros would be
        // computed: this is where bundle adjustment linearizes.
        let inverse_z = 1.0 / z;
        let (u, v) = (x * inverse_z, y * inverse_z);
        let scale = -self.inverse_sigma * inverse_z;
        let (a, b) = (fx * scale, fy * scale);
        let (c, d) = (-a * u, -b * v);
        let projected = Vector2::new(fx * u + cx, fy * v + cy);
        let residual = (self.observed_px - projected) * self.inverse_sigma;
        // d(in_camera)/d(rotation) = -[in_camera]x, d(in_camera)/d(translation) = I for a left perturbation.
        #[rustfmt::skip]
        let d_residual_d_pose = Matrix2x6::new(
            c * y,         a * z - c * x, -a * y, a,   0.0, c,
            d * y - b * z, -d * x,        b * x,  0.0, b,   d,
        );
        let [r0, r1, r2] = [rotation.row(0), rotation.row(1), rotation.row(2)];
        let d_residual_d_point = Matrix2x3::from_rows(&[r0 * a + r2 * c, r1 * b + r2 * d]);
        Some((residual, (d_residual_d_pose, d_residual_d_point)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector6;

    #[test]
    fn jacobians_match_central_differences() {
        let pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };
        for seed in 0..32 {
            let s = f64::from(seed);
            let pose = Pose::exp(&Vector6::new(s.sin(), 0.3 * s.cos(), 0.1 * s, 0.2, -0.3 * s.sin(), 0.4));
            let point = pose.inverse().transform(&Vector3::new(s.cos(), (2.0 * s).sin(), 3.0 + s.sin()));
            let factor = PointReprojectionFactor {
                pinhole,
                observed_px: Vector2::new(300.0 + s, 200.0 - s),
                inverse_sigma: 1.0 / (1.0 + 0.1 * s),
            };
            optim::testing::assert_jacobians_match(&factor, &(pose, point), 1e-6, 1e-5);
        }
    }

    #[test]
    fn points_behind_the_camera_have_no_residual() {
        let factor = PointReprojectionFactor {
            pinhole: Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 },
            observed_px: Vector2::zeros(),
            inverse_sigma: 1.0,
        };
        assert!(factor.residual((&Pose::identity(), &Vector3::new(0.0, 0.0, -1.0))).is_none());
        assert!(factor.linearize((&Pose::identity(), &Vector3::zeros())).is_none());
    }
}
