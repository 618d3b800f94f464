//! What a frame came to, before it is put into words.

use crate::clock::FrameTimes;
use crate::features::View;
use crate::map::{CameraId, FrameRecord, Map, SubmapId};
use crate::report::{FrameReport, MapEvent, TrackingOutcome};
use crate::tracking::Tracked;
use crate::tracking::frame::{Inliers, TrackedFrame};
use vision::lines::LineTrackingStatistics;

/// The result of tracking or initialising with one frame.
pub(crate) struct FrameResult {
    pub outcome: TrackingOutcome,
    /// The frame, where it has a pose.
    pub frame: Option<TrackedFrame>,
    pub inliers: Inliers,
    pub relocalized: bool,
    /// Places that were tried, if the camera had to be looked for.
    pub n_candidates: Option<usize>,
    pub is_keyframe: bool,
}

impl FrameResult {
    /// A frame without a pose.
    pub fn nowhere(outcome: TrackingOutcome) -> Self {
        let inliers = Inliers::default();
        Self { outcome, frame: None, inliers, relocalized: false, n_candidates: None, is_keyframe: false }
    }

    /// The second of the two frames that a map was begun with.
    pub fn begun(second: TrackedFrame, n_points: usize) -> Self {
        Self {
            frame: Some(second),
            inliers: Inliers { n_points, n_lines: 0 },
            is_keyframe: true,
            ..Self::nowhere(TrackingOutcome::Tracked)
        }
    }

    /// The frame's entry in the trajectory.
    pub fn record(&self, camera: CameraId, view: &View, map: &Map) -> FrameRecord {
        FrameRecord {
            camera,
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            state: self.outcome.state(),
            pose: self.frame.as_ref().and_then(|frame| frame.pose_in(map)),
            backfilled: false,
            reason: self.outcome.reason(),
        }
    }

    /// The frame's report; `submap` is the one to be begun or followed where the frame has no pose.
    pub fn into_report(
        self,
        view: &View,
        submap: SubmapId,
        line_tracking: LineTrackingStatistics,
        map_events: Vec<MapEvent>,
        times: FrameTimes,
    ) -> FrameReport {
        FrameReport {
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            world_from_camera: self.frame.as_ref().map(|frame| frame.camera_from_world.inverse()),
            submap: self.frame.as_ref().map_or(submap, |frame| frame.submap),
            outcome: self.outcome,
            n_keypoints: view.features.len(),
            n_segments: view.features.lines.len(),
            line_tracking,
            n_inlier_points: self.inliers.n_points,
            n_inlier_lines: self.inliers.n_lines,
            is_keyframe: self.is_keyframe,
            relocalized: self.relocalized,
            n_relocalization_candidates: self.n_candidates,
            map_events,
            stages: times.stages,
            wall_ns: times.wall_ns,
            cpu_ns: times.cpu_ns,
        }
    }
}

impl From<Tracked> for FrameResult {
    fn from(tracked: Tracked) -> Self {
        let Tracked { outcome, frame, inliers, relocalized, n_candidates } = tracked;
        Self { outcome, frame, inliers, relocalized, n_candidates, is_keyframe: false }
    }
}
