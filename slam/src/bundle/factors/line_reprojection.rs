//! How far the ends of a segment lie from the projection of the line it observes.

use geometry::nalgebra::{Matrix2x4, Matrix2x6, Vector2, Vector3};
use geometry::{OrthonormalLine, Pinhole, Pose};
use optim::{Factor, Linearized};

/// An image line whose normal is shorter than this, relative to the focal length, is seen end on: the line
/// passes the camera's center.
const MIN_NORMAL: f64 = 1e-9;

/// Distances of the two ends of a segment from the projection of its line, in standard deviations.
///
/// `r(T, L) = (l · p_s, l · p_e) / (‖l₁₂‖ σ)` with `l = K n`, where `T` is `camera_from_world`, `n` the
/// moment in the camera of the line `L`, `K` the projection of moments (pixels), `p_s` and `p_e` the
/// undistorted ends (pixels) and `σ` their standard deviation across the segment (pixels).
/// [method: Line reprojection error]. `L` is given about the point `origin` of the world (map units), near
/// the line but not on it, where its four parameters are well conditioned. Not defined for a line through the
/// camera's center.
#[derive(Clone, Copy, Debug)]
pub struct LineReprojectionFactor {
    /// The ideal camera.
    pub pinhole: Pinhole,
    /// The segment's undistorted start, pixels.
    pub start_px: Vector2<f64>,
    /// The segment's undistorted end, pixels.
    pub end_px: Vector2<f64>,
    /// One over the standard deviation of the ends across the segment, 1/pixels.
    pub inverse_sigma: f64,
    /// Where the line's parameters have their origin, world, map units.
    pub origin: Vector3<f64>,
}

/// The image line of unit normal, and how it was made.
struct Projected {
    /// Of the origin of the line's parameters.
    translation: Vector3<f64>,
    moment: Vector3<f64>,
    direction: Vector3<f64>,
    line: Vector3<f64>,
    norm: f64,
}

impl LineReprojectionFactor {
    fn project(&self, camera_from_world: &Pose, line: &OrthonormalLine) -> Option<Projected> {
        let (moment, direction) = line.pluecker();
        let translation = camera_from_world.transform(&self.origin);
        let direction = camera_from_world.rotation * direction;
        let moment = camera_from_world.rotation * moment + translation.cross(&direction);
        let Pinhole { fx, fy, cx, cy } = self.pinhole;
        let (x, y) = (fy * moment.x, fx * moment.y);
        let line = Vector3::new(x, y, fx * fy * moment.z - cx * x - cy * y);
        let norm = line.xy().norm();
        let is_seen = norm > MIN_NORMAL * self.pinhole.fx * direction.norm();
        is_seen.then(|| Projected { translation, moment, direction, line: line / norm, norm })
    }

    fn distances(&self, line: &Vector3<f64>) -> Vector2<f64> {
        let distance = |end: &Vector2<f64>| line.x * end.x + line.y * end.y + line.z;
        Vector2::new(distance(&self.start_px), distance(&self.end_px))
    }
}

impl Factor for LineReprojectionFactor {
    type Residual = Vector2<f64>;
    type Variables = (Pose, OrthonormalLine);

    #[inline]
    fn residual(&self, (camera_from_world, line): (&Pose, &OrthonormalLine)) -> Option<Vector2<f64>> {
        let projected = self.project(camera_from_world, line)?;
        Some(self.distances(&projected.line) * self.inverse_sigma)
    }

    #[inline(always)]
    fn linearize(&self, (camera_from_world, line): (&Pose, &OrthonormalLine)) -> Option<Linearized<Self>> {
        let projected = self.project(camera_from_world, line)?;
        let distances = self.distances(&projected.line);
        // With d = l·p / ‖l₁₂‖: ∂d/∂l = (p − d l₁₂/‖l₁₂‖, 1) / ‖l₁₂‖, and the line is stored divided by its
        // norm. By the moment it is Kᵀ of that. Written out row by row, without the zeros of its matrices.
        let Pinhole { fx, fy, cx, cy } = self.pinhole;
        let scale = self.inverse_sigma / projected.norm;
        let rotation = camera_from_world.rotation_matrix();
        let row = |end: &Vector2<f64>, distance: f64| {
            let across = end - projected.line.xy() * distance;
            let by_moment = Vector3::new(fy * (across.x - cx), fx * (across.y - cy), fx * fy) * scale;
            // A left perturbation turns the moment and adds translation × direction.
            let (turn, shift) = (projected.moment.cross(&by_moment), projected.direction.cross(&by_moment));
            // The moment in the camera is R n + t × R v.
            let by_direction = by_moment.cross(&projected.translation);
            let by_line = line.derivative(&rotation.tr_mul(&by_moment), &rotation.tr_mul(&by_direction));
            (turn, shift, by_line)
        };
        let (turn, shift, by_line) = row(&self.start_px, distances.x);
        let (end_turn, end_shift, end_by_line) = row(&self.end_px, distances.y);
        #[rustfmt::skip]
        let d_residual_d_pose = Matrix2x6::new(
            turn.x, turn.y, turn.z, shift.x, shift.y, shift.z,
            end_turn.x, end_turn.y, end_turn.z, end_shift.x, end_shift.y, end_shift.z,
        );
        let d_residual_d_line = Matrix2x4::from_rows(&[by_line.transpose(), end_by_line.transpose()]);
        Some((distances * self.inverse_sigma, (d_residual_d_pose, d_residual_d_line)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Line3;
    use geometry::nalgebra::Vector6;

    const PINHOLE: Pinhole = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };

    fn pose(s: f64) -> Pose {
        Pose::exp(&Vector6::new(0.3 * s.sin(), 0.3 * s.cos(), 0.1 * s, 0.2, -0.3 * s.sin(), 0.4))
    }

    /// A segment's factor and its line about the factor's origin, for ends given in the camera.
    fn factor(pose: &Pose, ends: [Vector3<f64>; 2]) -> (LineReprojectionFactor, OrthonormalLine) {
        let world_from_camera = pose.inverse();
        let origin = world_from_camera.transform(&Vector3::new(0.1, -0.2, 0.3));
        let [a, b] = ends.map(|end| world_from_camera.transform(&end) - origin);
        let factor = LineReprojectionFactor {
            pinhole: PINHOLE,
            start_px: PINHOLE.project(&ends[0]),
            end_px: PINHOLE.project(&ends[1]),
            inverse_sigma: 0.7,
            origin,
        };
        (factor, OrthonormalLine::from_line(&Line3::from_points(&a, &b).unwrap()).unwrap())
    }

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let pose = pose(s);
            let ends =
                [Vector3::new(s.cos(), 0.5 * s.sin(), 3.0), Vector3::new(-0.4, 0.8 * s.cos(), 2.5 + s.sin())];
            let (mut factor, line) = factor(&pose, ends);
            factor.start_px += Vector2::new(3.0, -2.0);
            factor.end_px += Vector2::new(-1.0, 4.0);
            optim::testing::assert_jacobians_match(&factor, &(pose, line), 1e-6, 1e-5);
        }
    }

    #[test]
    fn the_ends_of_a_seen_line_lie_on_its_projection() {
        for seed in 0..8 {
            let s = f64::from(seed);
            let ends = [Vector3::new(s.cos(), 0.5, 3.0), Vector3::new(-0.4, 0.8 * s.cos(), 2.5)];
            let (factor, line) = factor(&pose(s), ends);
            assert!(factor.residual((&pose(s), &line)).unwrap().norm() < 1e-9);
            let moved = LineReprojectionFactor { end_px: factor.end_px + Vector2::new(20.0, 30.0), ..factor };
            let residual = moved.residual((&pose(s), &line)).unwrap();
            assert!(residual.x.abs() < 1e-9 && residual.y.abs() > 1.0, "{residual}");
        }
    }

    #[test]
    fn a_line_through_the_camera_has_no_residual() {
        let ends = [Vector3::new(0.1, 0.2, 1.0), Vector3::new(0.3, 0.6, 3.0)];
        let (factor, line) = factor(&Pose::identity(), ends);
        assert!(factor.residual((&Pose::identity(), &line)).is_none());
    }
}
