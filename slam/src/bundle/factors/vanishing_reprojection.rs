//! How far a segment is from pointing at the vanishing point of its direction.

use crate::features::LineFeature;
use geometry::nalgebra::{Matrix1x2, Matrix1x3, Matrix1x6, Vector1, Vector2, Vector3};
use geometry::{Direction, Pinhole, Pose, so3};
use optim::{Factor, Linearized};

/// A vanishing point nearer to the segment's middle than this many of its lengths says nothing about its
/// direction.
const MIN_DISTANCE_LENGTHS: f64 = 1.0;

/// Distance of a segment's end from the line that joins its middle to the vanishing point of a direction, in
/// standard deviations.
///
/// `r(T, d) = (p · h) / (‖h₁₂‖ σ)` with `h = q × K R d`, where `T` is `camera_from_world` with rotation `R`,
/// `d` the direction in the world, `q` the segment's middle and `p` its end (undistorted, pixels) and `σ` the
/// standard deviation of the end across the segment (pixels). The start's distance is the same with the
/// opposite sign. [method: Vanishing-point error]. Works for vanishing points at infinity; not defined where
/// the vanishing point lies on the segment.
#[derive(Clone, Copy, Debug)]
pub struct VanishingReprojectionFactor {
    /// The ideal camera.
    pub pinhole: Pinhole,
    /// The segment's undistorted start, pixels.
    pub start_px: Vector2<f64>,
    /// The segment's undistorted end, pixels.
    pub end_px: Vector2<f64>,
    /// One over the standard deviation of the end's position across the segment, 1/pixels.
    pub inverse_sigma: f64,
}

/// The line through the segment's middle and the vanishing point.
struct Pointing {
    direction_in_camera: Vector3<f64>,
    /// Of unit normal.
    line: Vector3<f64>,
    norm: f64,
    middle: Vector3<f64>,
}

impl VanishingReprojectionFactor {
    /// Of a segment whose end counts for `sigma_factor` times as uncertain as it is measured.
    pub(crate) fn of(pinhole: Pinhole, segment: &LineFeature, sigma_factor: f64) -> Self {
        let inverse_sigma = 1.0 / (segment.sigma_px * sigma_factor);
        Self { pinhole, start_px: segment.start, end_px: segment.end, inverse_sigma }
    }

    fn point(&self, camera_from_world: &Pose, direction: &Direction) -> Option<Pointing> {
        let direction_in_camera = camera_from_world.rotation * direction.as_vector();
        let vanishing = self.pinhole.matrix() * direction_in_camera;
        let middle = (self.start_px + self.end_px) / 2.0;
        let middle = Vector3::new(middle.x, middle.y, 1.0);
        let line = middle.cross(&vanishing);
        let norm = line.xy().norm();
        // ‖h₁₂‖ is the distance of the two, times the third coordinate of the vanishing point.
        let length = (self.end_px - self.start_px).norm();
        let is_defined = norm > MIN_DISTANCE_LENGTHS * length * vanishing.z.abs() && norm > 0.0;
        is_defined.then(|| Pointing { direction_in_camera, line: line / norm, norm, middle })
    }

    fn distance(&self, line: &Vector3<f64>) -> f64 {
        line.x * self.end_px.x + line.y * self.end_px.y + line.z
    }
}

impl Factor for VanishingReprojectionFactor {
    type Residual = Vector1<f64>;
    type Variables = (Pose, Direction);

    #[inline]
    fn residual(&self, (camera_from_world, direction): (&Pose, &Direction)) -> Option<Vector1<f64>> {
        let pointing = self.point(camera_from_world, direction)?;
        Some(Vector1::new(self.distance(&pointing.line) * self.inverse_sigma))
    }

    #[inline]
    fn linearize(&self, (camera_from_world, direction): (&Pose, &Direction)) -> Option<Linearized<Self>> {
        let Pointing { direction_in_camera, line, norm, middle } =
            self.point(camera_from_world, direction)?;
        let distance = self.distance(&line);
        let across = (self.end_px - line.xy() * distance) / norm;
        let d_distance_d_line = Matrix1x3::new(across.x, across.y, 1.0 / norm);
        let d_residual_d_direction_in_camera =
            d_distance_d_line * so3::skew(&middle) * self.pinhole.matrix() * self.inverse_sigma;
        let mut d_residual_d_pose = Matrix1x6::zeros();
        d_residual_d_pose
            .fixed_view_mut::<1, 3>(0, 0)
            .copy_from(&(d_residual_d_direction_in_camera * -so3::skew(&direction_in_camera)));
        let d_residual_d_direction: Matrix1x2<f64> =
            d_residual_d_direction_in_camera * camera_from_world.rotation_matrix() * direction.basis();
        let residual = Vector1::new(distance * self.inverse_sigma);
        Some((residual, (d_residual_d_pose, d_residual_d_direction)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector6;

    const PINHOLE: Pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };

    fn factor(start: Vector2<f64>, end: Vector2<f64>) -> VanishingReprojectionFactor {
        VanishingReprojectionFactor { pinhole: PINHOLE, start_px: start, end_px: end, inverse_sigma: 0.8 }
    }

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let pose = Pose::exp(&Vector6::new(0.4 * s.sin(), 0.3 * s.cos(), 0.1 * s, 0.2, -0.3, 0.4));
            let direction =
                Direction::new(Vector3::new(s.cos(), (1.7 * s).sin(), 0.6 * (0.9 * s).cos())).unwrap();
            let factor = factor(Vector2::new(200.0 + 9.0 * s, 40.0), Vector2::new(230.0, 90.0 + 5.0 * s));
            if factor.residual((&pose, &direction)).is_some() {
                optim::testing::assert_jacobians_match(&factor, &(pose, direction), 1e-6, 1e-5);
            }
        }
    }

    #[test]
    fn a_segment_that_points_at_its_vanishing_point_has_no_residual() {
        let pose = Pose::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 3.0));
        // Ahead, across (a vanishing point at infinity), and between.
        for in_camera in [Vector3::new(0.3, 0.1, 1.0), Vector3::x(), Vector3::new(1.0, 0.5, 0.2)] {
            let a = Vector3::new(-0.8, 0.7, 3.0);
            let (start, end) = (PINHOLE.project(&a), PINHOLE.project(&(a + in_camera * 0.5)));
            let direction = Direction::new(pose.rotation.inverse() * in_camera).unwrap();
            assert!(factor(start, end).residual((&pose, &direction)).unwrap().x.abs() < 1e-9);
            // Turned about its middle, the end is as far off as the start was moved.
            let across = Vector2::new(-(end - start).y, (end - start).x).normalize();
            let turned = factor(start - across, end + across).residual((&pose, &direction)).unwrap();
            assert!((turned.x.abs() - 0.8).abs() < 0.05, "{turned}");
        }
    }

    #[test]
    fn a_vanishing_point_on_the_segment_has_no_residual() {
        let ahead = Direction::new(Vector3::z()).unwrap();
        let factor = factor(Vector2::new(360.0, 240.0), Vector2::new(380.0, 260.0));
        assert!(factor.residual((&Pose::identity(), &ahead)).is_none());
    }
}
