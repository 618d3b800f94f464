//! Map lines.

use super::ids::{KeyframeId, LineId, PrimitiveId, SubmapId};
use super::point::Observation;
use geometry::Line3;
use geometry::nalgebra::Vector3;
use vision::Descriptor;

/// A straight edge of the scene, seen by two keyframes or more.
#[derive(Clone, Debug, PartialEq)]
pub struct LineLandmark {
    /// Identity within the session.
    pub id: LineId,
    /// The submap whose frame of reference the line is in.
    pub submap: SubmapId,
    /// The infinite line in the world, in Plücker coordinates, map units.
    pub line: Line3,
    /// The ends of the part that was seen, on the line; map units, world. The line's direction leads from the
    /// first to the second, and the brighter side is to the right of that way in the images that see it.
    pub endpoints: [Vector3<f64>; 2],
    /// The descriptor that is closest to all the observed ones.
    pub descriptor: Descriptor,
    /// The keyframe that made the line.
    pub created_by: KeyframeId,
    /// Observations in the order of the keyframes' ids, one per keyframe; `feature_idx` counts the keyframe's
    /// [`lines`](crate::features::FrameFeatures::lines).
    pub observations: Vec<Observation>,
    /// Frames in which the line should have been visible.
    pub n_visible: u32,
    /// Frames in which the line was found.
    pub n_found: u32,
    /// The global primitive whose direction the line has, once known.
    pub primitive: Option<PrimitiveId>,
}

impl LineLandmark {
    /// The segment with which a keyframe sees this line.
    pub fn observation_in(&self, keyframe: KeyframeId) -> Option<u32> {
        let found = self.observations.binary_search_by_key(&keyframe, |observation| observation.keyframe);
        found.ok().map(|position| self.observations[position].feature_idx)
    }

    /// Share of the frames that should have seen the line which did.
    pub fn found_ratio(&self) -> f64 {
        f64::from(self.n_found) / f64::from(self.n_visible.max(1))
    }

    /// The point half way between the ends, map units.
    pub fn midpoint(&self) -> Vector3<f64> {
        (self.endpoints[0] + self.endpoints[1]) / 2.0
    }

    /// Distance of the ends, map units.
    pub fn length(&self) -> f64 {
        (self.endpoints[1] - self.endpoints[0]).norm()
    }

    /// Whether every number in it is finite.
    pub fn is_finite(&self) -> bool {
        self.line.is_finite() && self.endpoints.iter().all(|end| end.iter().all(|value| value.is_finite()))
    }
}
