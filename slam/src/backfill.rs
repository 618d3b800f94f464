//! Poses for frames that came before there was a good map: while there was none, while the camera was lost, and while
//! the map was young and its geometry still rough.
//!
//! Their features are kept for a while. Once the map is good enough, the recording is followed backwards from the
//! present frame, one kept frame per new frame, so that no frame takes much longer than another.

use crate::config::SlamConfig;
use crate::initialisation::View;
use crate::map::{FrameRecord, FrameState, Map};
use crate::mapping::median_depth;
use crate::report::TrackingOutcome;
use crate::tracking::Tracker;
use crate::tracking::frame::TrackedFrame;
use std::collections::VecDeque;

/// A second pose replaces the first only if it is borne by at least this share of the first one's inliers.
const MIN_INLIER_SHARE: f64 = 0.8;
/// Frames in a row that may fail before the rest is given up.
const MAX_FAILURES: usize = 5;

/// Frames that may still get a pose, or a better one.
pub(crate) struct Backfill {
    config: SlamConfig,
    /// Frames since the camera was last followed, oldest first.
    waiting: VecDeque<Waiting>,
    /// The way back from a frame that was placed, and the frames to visit, oldest first.
    backward: Option<(Tracker, VecDeque<Waiting>)>,
    /// Where the way back begins, until the map is good enough.
    start: Option<TrackedFrame>,
    n_failures: usize,
    is_mature: bool,
}

/// A kept frame.
struct Waiting {
    view: View,
    /// Landmarks that agreed with the pose it was answered with, if it had one.
    n_inliers: Option<usize>,
}

impl Backfill {
    pub fn new(config: SlamConfig) -> Self {
        Self {
            config,
            waiting: VecDeque::new(),
            backward: None,
            start: None,
            n_failures: 0,
            is_mature: false,
        }
    }

    /// Keeps a frame that got no pose, or got one while the map was young; the oldest goes when there are too many.
    pub fn keep(&mut self, view: &View, n_inliers: Option<usize>) {
        if n_inliers.is_some() && self.is_mature {
            return;
        }
        if self.waiting.len() >= self.config.initialisation.max_backfill_views {
            self.waiting.pop_front();
        }
        self.waiting.push_back(Waiting { view: view.clone(), n_inliers });
    }

    /// Notes that a frame was placed: the frames kept until now can be reached from it.
    pub fn placed(&mut self, frame: &TrackedFrame) {
        if !self.waiting.is_empty() {
            self.start = Some(frame.clone());
        }
    }

    /// What was placed is no longer in the map: kept frames may be placed anew.
    pub fn forget_poses(&mut self) {
        self.waiting.iter_mut().for_each(|waiting| waiting.n_inliers = None);
        self.backward = None;
        self.start = None;
        self.is_mature = false;
    }

    /// A new submap begins: frames without a pose may still be reached from it, and it is young again.
    pub fn begin_submap(&mut self) {
        self.waiting.retain(|waiting| waiting.n_inliers.is_none());
        self.backward = None;
        self.start = None;
        self.is_mature = false;
    }

    /// Whether there is nothing left to do.
    pub fn is_done(&self) -> bool {
        self.start.is_none() && self.backward.is_none()
    }

    /// Tries to place one kept frame, unless the map is too young and `force` is not set.
    pub fn step(&mut self, map: &Map, force: bool) -> Option<FrameRecord> {
        if self.backward.is_none() {
            let start = self.start.as_ref()?.clone();
            let is_full = self.waiting.len() >= self.config.initialisation.max_backfill_views;
            self.is_mature |= is_mature(map, &start, self.config.initialisation.mature_baseline_share);
            if !(self.is_mature || is_full || force) {
                return None;
            }
            self.start = None;
            let mut tracker = Tracker::follower(self.config.clone());
            tracker.start(start, map);
            self.backward = Some((tracker, std::mem::take(&mut self.waiting)));
            self.n_failures = 0;
        }
        let (tracker, views) = self.backward.as_mut()?;
        let Some(Waiting { view, n_inliers }) = views.pop_back() else {
            self.backward = None;
            return None;
        };
        tracker.adopt(map);
        let resume = tracker.last_frame().cloned();
        let tracked = tracker.track(view.sequence, view.timestamp_ns, view.features, map);
        match (tracked.outcome, tracked.frame) {
            (TrackingOutcome::Tracked, Some(frame)) => {
                self.n_failures = 0;
                let n_required = MIN_INLIER_SHARE * n_inliers.unwrap_or(0) as f64;
                if (tracked.inliers.total() as f64) < n_required {
                    return None;
                }
                Some(FrameRecord {
                    sequence: frame.sequence,
                    timestamp_ns: frame.timestamp_ns,
                    state: FrameState::Tracked,
                    pose: frame.pose_in(map),
                    backfilled: n_inliers.is_none(),
                })
            }
            _ => {
                self.n_failures += 1;
                match resume.filter(|_| self.n_failures < MAX_FAILURES) {
                    Some(frame) => tracker.start(frame, map),
                    None => self.backward = None,
                }
                None
            }
        }
    }
}

/// Whether the key frames of the frame's submap are spread widely enough for its depths to be known well.
fn is_mature(map: &Map, frame: &TrackedFrame, min_baseline_share: f64) -> bool {
    let in_submap = || map.keyframes().filter(|keyframe| keyframe.submap == frame.submap);
    let Some(origin) = in_submap().next() else { return false };
    let Some(median_depth) = map.keyframe(frame.reference).and_then(|reference| median_depth(map, reference))
    else {
        return false;
    };
    let origin = origin.camera_from_world.centre();
    in_submap()
        .any(|other| (other.camera_from_world.centre() - origin).norm() >= min_baseline_share * median_depth)
}
