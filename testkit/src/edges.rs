//! Lines held against the edges of their world.

use geometry::nalgebra::Vector3;
use synthetic::World;

/// How far a line is from an edge of the world.
#[derive(Clone, Copy, Debug)]
pub struct LineError {
    /// Between the directions, 0 to 90 degrees.
    pub angle_deg: f64,
    /// Of the line's middle from the nearest point of the edge, world units.
    pub distance: f64,
}

/// The error of a line, given by its ends in the true world, against the nearest edge that runs within 10
/// degrees of it; `None` if there is no such edge.
pub fn line_error(ends: &[Vector3<f64>; 2], world: &World) -> Option<LineError> {
    const MAX_ANGLE_DEG: f64 = 10.0;
    let direction = (ends[1] - ends[0]).normalize();
    let middle = (ends[0] + ends[1]) / 2.0;
    let errors = world.segments().iter().map(|edge| {
        let vector = edge.end - edge.start;
        let along = vector.normalize();
        let angle_deg = along.cross(&direction).norm().atan2(along.dot(&direction).abs()).to_degrees();
        let nearest = edge.start + along * (middle - edge.start).dot(&along).clamp(0.0, vector.norm());
        LineError { angle_deg, distance: (middle - nearest).norm() }
    });
    errors.filter(|error| error.angle_deg < MAX_ANGLE_DEG).min_by(|a, b| a.distance.total_cmp(&b.distance))
}
