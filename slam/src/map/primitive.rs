//! Global primitives: directions of the world that keyframes share without seeing the same place.

use super::ids::{KeyframeId, PrimitiveId, SubmapId};
use geometry::Direction;
use geometry::nalgebra::{Matrix3, Vector3};

/// A vanishing point found in a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct VanishingObservation {
    /// The direction of the parallel lines in the camera's frame; unit, without a sign.
    pub direction: Vector3<f64>,
    /// Covariance of the direction, of rank two across it, radians squared.
    pub covariance: Matrix3<f64>,
    /// The supporting segments: indices into the keyframe's
    /// [`lines`](crate::features::FrameFeatures::lines).
    pub segments: Vec<u32>,
    /// The global primitive it belongs to, once known.
    pub primitive: Option<PrimitiveId>,
}

/// One sighting of a primitive: which vanishing point of which keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PrimitiveObservation {
    /// The keyframe that sees lines of this direction.
    pub keyframe: KeyframeId,
    /// Index into the keyframe's [`vanishing`](super::Keyframe::vanishing).
    pub vanishing_idx: u32,
}

/// A direction of the world shared by keyframes, whether or not they overlap. [method: Global primitives]
#[derive(Clone, Debug, PartialEq)]
pub struct GlobalPrimitive {
    /// Identity within the session.
    pub id: PrimitiveId,
    /// The submap whose frame of reference the direction is in.
    pub submap: SubmapId,
    /// The direction in the world.
    pub direction: Direction,
    /// Covariance of the direction, of rank two across it, radians squared.
    pub covariance: Matrix3<f64>,
    /// The keyframe that made the primitive.
    pub created_by: KeyframeId,
    /// Observations in the order of the keyframes' ids, one per keyframe.
    pub observations: Vec<PrimitiveObservation>,
}

impl GlobalPrimitive {
    /// The vanishing point with which a keyframe sees this primitive.
    pub fn observation_in(&self, keyframe: KeyframeId) -> Option<u32> {
        let found = self.observations.binary_search_by_key(&keyframe, |observation| observation.keyframe);
        found.ok().map(|position| self.observations[position].vanishing_idx)
    }

    /// Whether every number in it is finite.
    pub fn is_finite(&self) -> bool {
        self.direction.as_vector().iter().chain(self.covariance.iter()).all(|value| value.is_finite())
    }
}
