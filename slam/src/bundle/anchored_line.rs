//! Lines in orthonormal representation about a local origin, as the optimizer holds them.

use super::factors::LineReprojectionFactor;
use crate::features::LineFeature;
use crate::map::{LineLandmark, LinePlace};
use geometry::nalgebra::Vector3;
use geometry::{Direction, Line3, OrthonormalLine, Pinhole, Pose};

/// A line in its four parameters about a point near it, where they are well conditioned
/// [method: Orthonormal representation].
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnchoredLine {
    /// World, map units: as far from the line's middle as the line is long.
    pub origin: Vector3<f64>,
    pub line: OrthonormalLine,
}

impl AnchoredLine {
    /// `None` for a line without length.
    pub fn new(place: &LinePlace) -> Option<Self> {
        let [a, b] = place.endpoints;
        let across = Direction::new(b - a)?.basis().column(0).into_owned();
        let origin = (a + b) / 2.0 + across * (b - a).norm();
        let about_origin = place.line.transformed(&Pose::new(Pose::identity().rotation, -origin));
        Some(Self { origin, line: OrthonormalLine::from_line(&about_origin)? })
    }

    pub fn of(landmark: &LineLandmark) -> Option<Self> {
        Self::new(&LinePlace { line: landmark.line, endpoints: landmark.endpoints })
    }

    /// The line in the world for new values of the parameters. `None` if it went to infinity.
    pub fn line_in_world(&self, line: &OrthonormalLine) -> Option<Line3> {
        let in_world = line.to_line()?.transformed(&Pose::new(Pose::identity().rotation, self.origin));
        in_world.is_finite().then_some(in_world)
    }

    /// The term that a segment contributes.
    pub fn factor(&self, pinhole: Pinhole, segment: &LineFeature) -> LineReprojectionFactor {
        LineReprojectionFactor {
            pinhole,
            start_px: segment.start,
            end_px: segment.end,
            inverse_sigma: 1.0 / segment.sigma_px,
            origin: self.origin,
        }
    }
}
