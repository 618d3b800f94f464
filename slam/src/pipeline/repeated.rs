//! Images that are sent again: a camera had no new one yet, or a video shows more frames than its camera
//! took.
//!
//! Taken for the view of a camera that stands still, a repeated image would have the camera stop and leap:
//! the pose that is expected next, and with a rolling shutter every velocity, would be wrong. So it is
//! answered with what the image came to when it was new, and otherwise passed over. [method: Repeated images]

use super::Pipeline;
use crate::clock::Stopwatch;
use crate::features::View;
use crate::frame_result::FrameResult;
use crate::report::{LostReason, TrackingOutcome};
use crate::tracking::frame::{Inliers, TrackedFrame};

/// Repetitions in a row that are passed over: a camera of ten frames a second, in a video of thirty, shows
/// each image three times. What shows the same for longer stands still.
const MAX_IN_ROW: usize = 3;

/// What the last image came to, should it come again.
#[derive(Default)]
pub(super) struct LastImage {
    result: Option<(TrackingOutcome, Inliers)>,
    /// How often it came again.
    n_repeated: usize,
}

impl LastImage {
    /// Takes note of a new image.
    pub fn note(&mut self, result: &FrameResult) {
        *self = Self { result: Some((result.outcome, result.inliers)), n_repeated: 0 };
    }

    fn repeat(&mut self) -> Option<(TrackingOutcome, Inliers)> {
        self.n_repeated += 1;
        self.result.filter(|_| self.n_repeated <= MAX_IN_ROW)
    }
}

impl Pipeline {
    /// What a frame comes to whose image is the last one again; `None` if it is to be looked at all the same.
    pub(super) fn repeat(
        &mut self,
        (sequence, timestamp_ns): (u64, i64),
        stopwatch: &mut Stopwatch,
    ) -> Option<(View, FrameResult)> {
        let features = self.last_view.as_ref()?.features.clone();
        let (outcome, inliers) = self.last_image.repeat()?;
        if self.lossless {
            self.mapping.wait();
        }
        stopwatch.lap("wait_for_mapping");
        self.sync_map();
        stopwatch.lap("map_sync");
        let view = View { sequence, timestamp_ns, features };
        let frame = self.same_frame(&view);
        let outcome = match outcome {
            // What it was placed in has gone meanwhile.
            TrackingOutcome::Tracked | TrackingOutcome::Weak { .. } if frame.is_none() => {
                TrackingOutcome::Lost(LostReason::NotRelocalized { n_candidates: 0 })
            }
            outcome => outcome,
        };
        let result = FrameResult { frame, inliers, ..FrameResult::nowhere(outcome) };
        self.trajectory.repeat(self.record_of(&view, &result), self.submaps.is_young(&self.map));
        self.flush_full();
        if result.frame.is_some() {
            self.trajectory.backfill(self.backfill.step(&self.map, false));
        }
        stopwatch.lap("backfill");
        Some((view, result))
    }

    /// The frame that the last view was placed as, for a view of the same image.
    fn same_frame(&self, view: &View) -> Option<TrackedFrame> {
        let last_sequence = self.last_view.as_ref()?.sequence;
        let last = self.tracker.last_frame().filter(|frame| frame.sequence == last_sequence)?;
        let (sequence, timestamp_ns) = (view.sequence, view.timestamp_ns);
        Some(TrackedFrame { sequence, timestamp_ns, ..last.clone() })
    }
}
