//! Map points.

use super::ids::{KeyframeId, PointId, SubmapId};
use geometry::nalgebra::Vector3;
use vision::Descriptor;

/// One sighting of a landmark: which keypoint of which keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Observation {
    /// The keyframe that sees the landmark.
    pub keyframe: KeyframeId,
    /// Index into the keyframe's keypoints.
    pub feature_idx: u32,
}

/// A point of the scene, seen by two keyframes or more.
#[derive(Clone, Debug, PartialEq)]
pub struct PointLandmark {
    /// Identity within the session.
    pub id: PointId,
    /// The submap whose frame of reference the position is in.
    pub submap: SubmapId,
    /// Position in the world, map units.
    pub position: Vector3<f64>,
    /// The descriptor that is closest to all the observed ones.
    pub descriptor: Descriptor,
    /// Mean unit direction from the observing cameras to the point.
    pub mean_view_direction: Vector3<f64>,
    /// Distances between which the extractor's pyramid can see the point, map units.
    pub distance_range: (f64, f64),
    /// The keyframe that made the point.
    pub created_by: KeyframeId,
    /// Observations in the order of the keyframes' ids, one per keyframe.
    pub observations: Vec<Observation>,
    /// Frames in which the point should have been visible, and in which it was found.
    pub n_visible: u32,
    /// Frames in which the point was found.
    pub n_found: u32,
}

impl PointLandmark {
    /// The keypoint with which a keyframe sees this point.
    pub fn observation_in(&self, keyframe: KeyframeId) -> Option<u32> {
        let found = self.observations.binary_search_by_key(&keyframe, |observation| observation.keyframe);
        found.ok().map(|position| self.observations[position].feature_idx)
    }

    /// Share of the frames that should have seen the point which did.
    pub fn found_ratio(&self) -> f64 {
        f64::from(self.n_found) / f64::from(self.n_visible.max(1))
    }
}
