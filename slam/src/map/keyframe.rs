//! Keyframes: the frames a map is made of.

use super::ids::{CameraId, KeyframeId, LineId, PointId, SubmapId};
use super::primitive::VanishingObservation;
use crate::features::FrameFeatures;
use geometry::Pose;
use std::sync::Arc;

/// The camera that took something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapCamera {
    /// Which of the map's cameras.
    pub id: CameraId,
    /// Whether it has the calibration of the map's own camera, so that what the map finds out about that
    /// holds for it too. Another calibration is used as it was given.
    pub is_refined: bool,
}

impl Default for MapCamera {
    /// The map's own.
    fn default() -> Self {
        Self { id: CameraId::default(), is_refined: true }
    }
}

/// A frame kept in the map, with what was measured in it and which landmarks it sees.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Identity within the session.
    pub id: KeyframeId,
    /// The submap whose frame of reference the pose is in.
    pub submap: SubmapId,
    /// The camera that took it. Numbers and times of frames are each camera's own.
    pub camera: MapCamera,
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// Pose; lengths in map units.
    pub camera_from_world: Pose,
    /// Local scale: map units per unit in which the offsets of the frames that hang on this keyframe are
    /// given. One, until a correction changes the scale of the map around the keyframe; handed on to the
    /// keyframes made beside it.
    pub local_scale: f64,
    /// What the front end measured; never changes.
    pub features: Arc<FrameFeatures>,
    /// The landmark each keypoint observes, one entry per keypoint.
    pub points: Vec<Option<PointId>>,
    /// The landmark each segment observes, one entry per segment.
    pub lines: Vec<Option<LineId>>,
    /// The vanishing points found in the keyframe; which there are never changes, only what they belong to.
    pub vanishing: Vec<VanishingObservation>,
    /// The keyframe this one hangs on in the spanning tree; `None` for the first of a submap.
    pub parent: Option<KeyframeId>,
    /// Keyframes that share at least [`crate::MappingConfig::min_covisible_points`] points and lines with
    /// this one, with how many, most first. Derived from the observations.
    pub(crate) covisible: Vec<(KeyframeId, u32)>,
}

impl Keyframe {
    /// A keyframe of stored parts, taken by the map's own camera, that sees no landmark yet: fill `points`,
    /// `lines` and `vanishing` afterwards.
    pub fn from_parts(
        id: KeyframeId,
        submap: SubmapId,
        sequence: u64,
        timestamp_ns: i64,
        camera_from_world: Pose,
        features: Arc<FrameFeatures>,
        parent: Option<KeyframeId>,
    ) -> Self {
        let points = vec![None; features.len()];
        let lines = vec![None; features.lines.len()];
        Self {
            id,
            submap,
            camera: MapCamera::default(),
            sequence,
            timestamp_ns,
            camera_from_world,
            local_scale: 1.0,
            features,
            points,
            lines,
            vanishing: Vec::new(),
            parent,
            covisible: Vec::new(),
        }
    }

    /// Keyframes that share points and lines with this one and how many they share, most first.
    pub fn covisible(&self) -> &[(KeyframeId, u32)] {
        &self.covisible
    }

    /// The observed landmarks with the keypoints that see them.
    pub fn observed_points(&self) -> impl Iterator<Item = (usize, PointId)> + '_ {
        self.points.iter().enumerate().filter_map(|(keypoint_idx, point)| Some((keypoint_idx, (*point)?)))
    }

    /// The observed lines with the segments that see them.
    pub fn observed_lines(&self) -> impl Iterator<Item = (usize, LineId)> + '_ {
        self.lines.iter().enumerate().filter_map(|(line_idx, line)| Some((line_idx, (*line)?)))
    }

    /// How many keypoints see a landmark.
    pub fn n_points(&self) -> usize {
        self.points.iter().flatten().count()
    }
}

/// Where a removed keyframe was, so that frames that refer to it keep their place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemovedKeyframe {
    /// The removed keyframe.
    pub id: KeyframeId,
    /// The keyframe its pose now hangs on, which may have been removed later itself.
    pub anchor: KeyframeId,
    /// The removed keyframe's pose relative to the anchor's at the time of removal, in the anchor's own
    /// unit. Only keyframes of (nearly) the same unit hang on one another this way.
    pub camera_from_anchor: Pose,
}
