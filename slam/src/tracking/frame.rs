//! A frame while it is being tracked.

use crate::features::FrameFeatures;
use crate::map::{FramePose, Keyframe, KeyframeId, Map, PointId, SubmapId};
use geometry::Pose;
use std::sync::Arc;

/// A frame with what is known of it so far.
#[derive(Clone, Debug)]
pub(crate) struct TrackedFrame {
    pub sequence: u64,
    pub timestamp_ns: i64,
    pub features: Arc<FrameFeatures>,
    /// The landmark each keypoint was matched to.
    pub points: Vec<Option<PointId>>,
    pub camera_from_world: Pose,
    /// The key frame that shares the most points with this one.
    pub reference: KeyframeId,
    pub submap: SubmapId,
}

impl TrackedFrame {
    /// The frame's place in the trajectory, relative to its reference key frame as it stands in `map`.
    pub fn pose_in(&self, map: &Map) -> Option<FramePose> {
        let reference_from_world = map.camera_from_world(self.reference)?;
        Some(FramePose {
            submap: self.submap,
            reference: self.reference,
            camera_from_reference: self.camera_from_world * reference_from_world.inverse(),
        })
    }

    /// Makes the frame a key frame with the given identity.
    pub fn to_keyframe(&self, id: KeyframeId, parent: Option<KeyframeId>) -> Keyframe {
        Keyframe {
            id,
            submap: self.submap,
            sequence: self.sequence,
            timestamp_ns: self.timestamp_ns,
            camera_from_world: self.camera_from_world,
            features: self.features.clone(),
            points: self.points.clone(),
            lines: vec![None; self.features.lines.len()],
            vanishing: Vec::new(),
            parent,
            covisible: Vec::new(),
        }
    }
}
