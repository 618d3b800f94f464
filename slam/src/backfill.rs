//! Poses for frames that came before there was a map, or while the camera was lost.
//!
//! Their features are kept for a while. Once the camera is followed again, the recording is followed backwards from
//! there, one kept frame per new frame, so that no frame takes much longer than another.

use crate::config::SlamConfig;
use crate::initialisation::View;
use crate::map::{FrameRecord, FrameState, Map};
use crate::report::TrackingOutcome;
use crate::tracking::Tracker;
use crate::tracking::frame::TrackedFrame;
use std::collections::VecDeque;

/// Key frames a map should have before it is good enough to place older frames in.
const MIN_KEYFRAMES: usize = 5;
/// Frames in a row that may fail before the rest is given up.
const MAX_FAILURES: usize = 5;

/// Frames without a pose that may still get one.
pub(crate) struct Backfill {
    config: SlamConfig,
    /// Frames since the camera was last followed, oldest first.
    waiting: VecDeque<View>,
    /// The way back from a frame that was placed, and the frames to visit, oldest first.
    backward: Option<(Tracker, VecDeque<View>)>,
    /// Where the way back begins, until the map is good enough.
    start: Option<TrackedFrame>,
    n_failures: usize,
}

impl Backfill {
    pub fn new(config: SlamConfig) -> Self {
        Self { config, waiting: VecDeque::new(), backward: None, start: None, n_failures: 0 }
    }

    /// Keeps a frame that got no pose; the oldest goes when there are too many.
    pub fn keep(&mut self, view: View) {
        if self.waiting.len() >= self.config.initialisation.max_backfill_views {
            self.waiting.pop_front();
        }
        self.waiting.push_back(view);
    }

    /// Notes that a frame was placed: the frames kept until now can be reached from it.
    pub fn placed(&mut self, frame: &TrackedFrame) {
        if !self.waiting.is_empty() {
            self.start = Some(frame.clone());
        }
    }

    /// Forgets everything: what was placed is no longer in the map.
    pub fn clear(&mut self) {
        self.waiting.clear();
        self.backward = None;
        self.start = None;
    }

    /// Whether there is nothing left to do.
    pub fn is_done(&self) -> bool {
        self.start.is_none() && self.backward.is_none()
    }

    /// Tries to place one kept frame, unless the map is too young and `force` is not set.
    pub fn step(&mut self, map: &Map, force: bool) -> Option<FrameRecord> {
        if self.backward.is_none() && (force || map.n_keyframes() >= MIN_KEYFRAMES) {
            let start = self.start.take()?;
            let mut tracker = Tracker::follower(self.config.clone());
            tracker.start(start, map);
            self.backward = Some((tracker, std::mem::take(&mut self.waiting)));
            self.n_failures = 0;
        }
        let (tracker, views) = self.backward.as_mut()?;
        let Some(view) = views.pop_back() else {
            self.backward = None;
            return None;
        };
        tracker.adopt(map);
        let resume = tracker.last_frame().cloned();
        let tracked = tracker.track(view.sequence, view.timestamp_ns, view.features, map);
        match (tracked.outcome, tracked.frame) {
            (TrackingOutcome::Tracked, Some(frame)) => {
                self.n_failures = 0;
                Some(FrameRecord {
                    sequence: frame.sequence,
                    timestamp_ns: frame.timestamp_ns,
                    state: FrameState::Tracked,
                    pose: frame.pose_in(map),
                    backfilled: true,
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
