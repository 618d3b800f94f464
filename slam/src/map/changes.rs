//! What changed in a map since it was last handed out.

use super::{CameraId, KeyframeId, LineId, Map, PointId, PrimitiveId, SubmapId};
use geometry::Pose;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The ids whose rows differ from the last time the changes were taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapChanges {
    /// Keyframes that are new, moved, or see other landmarks than before.
    pub keyframes: BTreeSet<KeyframeId>,
    /// Keyframes that were removed; [`Map::removed_keyframe`] says what they hang on now.
    pub removed_keyframes: BTreeSet<KeyframeId>,
    /// Points that are new, moved, or have other observations than before.
    pub points: BTreeSet<PointId>,
    /// Points that were removed.
    pub removed_points: BTreeSet<PointId>,
    /// Lines that are new, moved, or have other observations than before.
    pub lines: BTreeSet<LineId>,
    /// Lines that were removed.
    pub removed_lines: BTreeSet<LineId>,
    /// Global primitives that are new, turned, or have other observations than before.
    pub primitives: BTreeSet<PrimitiveId>,
    /// Global primitives that were removed.
    pub removed_primitives: BTreeSet<PrimitiveId>,
    /// Those of the changed keyframes whose features lie elsewhere than before.
    pub moved_features: BTreeSet<KeyframeId>,
    /// Whether [`Map::correction`], [`Map::is_contradicted`] or [`Map::readout`] is another.
    pub correction: bool,
    /// Whether keyframes were made of images that are enlarged for their border
    /// (`SlamConfig::enlarge_for_border`).
    pub enlarged: bool,
}

impl MapChanges {
    /// Whether nothing changed.
    pub fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
            && self.removed_keyframes.is_empty()
            && self.points.is_empty()
            && self.removed_points.is_empty()
            && self.lines.is_empty()
            && self.removed_lines.is_empty()
            && self.primitives.is_empty()
            && self.removed_primitives.is_empty()
            && !self.correction
            && !self.enlarged
    }

    /// Adds what changed afterwards; what was removed afterwards no longer counts as changed.
    pub fn merge(&mut self, later: MapChanges) {
        self.keyframes.extend(later.keyframes);
        self.removed_keyframes.extend(later.removed_keyframes);
        self.points.extend(later.points);
        self.removed_points.extend(later.removed_points);
        self.keyframes.retain(|id| !self.removed_keyframes.contains(id));
        self.moved_features.extend(later.moved_features);
        self.points.retain(|id| !self.removed_points.contains(id));
        self.lines.extend(later.lines);
        self.removed_lines.extend(later.removed_lines);
        self.lines.retain(|id| !self.removed_lines.contains(id));
        self.primitives.extend(later.primitives);
        self.removed_primitives.extend(later.removed_primitives);
        self.primitives.retain(|id| !self.removed_primitives.contains(id));
        self.correction |= later.correction;
        self.enlarged |= later.enlarged;
    }
}

/// How tracking a frame ended, in one word, as kept with the trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameState {
    /// There was no map yet.
    Initialising,
    /// The pose is good.
    Tracked,
    /// The pose is poorly determined.
    Weak,
    /// There is no pose.
    Lost,
}

/// One frame's place in the trajectory, relative to a keyframe so that it moves when the map is corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRecord {
    /// The camera that took it.
    pub camera: CameraId,
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// How tracking ended.
    pub state: FrameState,
    /// The pose, where there is one.
    pub pose: Option<FramePose>,
    /// The pose was found after the frame was answered.
    pub backfilled: bool,
    /// Why the pose is not good, in a plain sentence; empty if it is.
    pub reason: String,
}

/// A pose relative to a keyframe. [`Map::locate`] tells where that is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePose {
    /// The submap the reference keyframe was in when the frame was placed; it may have been merged since.
    pub submap: SubmapId,
    /// The keyframe the pose is relative to; it may have been removed since.
    pub reference: KeyframeId,
    /// The frame's camera from the reference keyframe's camera; translation in the reference's own
    /// [local scale](super::Keyframe::local_scale).
    pub camera_from_reference: Pose,
}

/// A consistent state of the map, with what differs from the update before. Made to be stored in one
/// transaction.
#[derive(Clone, Debug)]
pub struct MapUpdate {
    /// The whole map; cheap to hold, shares everything unchanged with other updates.
    pub map: Arc<Map>,
    /// What differs from the update before this one.
    pub changes: MapChanges,
    /// Frames to add to the trajectory, or to replace in it where the sequence is already there.
    pub frames: Vec<FrameRecord>,
}

impl MapUpdate {
    /// Joins this update with the one that follows it.
    pub fn merge(&mut self, later: MapUpdate) {
        self.map = later.map;
        self.changes.merge(later.changes);
        self.frames.extend(later.frames);
    }
}
