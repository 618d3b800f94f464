//! Counts and times the answers of a stream as they come, in memory that does not grow with it.

use std::collections::VecDeque;

use proto::v1;

use crate::summary::{CameraFinding, Distribution, FrameAnswer, StageSummary, StreamSummary};

/// Answers that can still be replaced: after a broken connection, frames are sent again whose answers were
/// lost or whose session forgot them. Far more than are on their way or wait to be saved.
const N_RECENT: usize = 4096;

/// Values of a stream kept for its percentiles: exact for an hour at 18 frames a second, half a megabyte for
/// each stage that is timed.
const MAX_VALUES: usize = 1 << 16;

/// The answers to consecutive frames.
#[derive(Debug)]
pub(crate) struct Ledger {
    /// Answers to the frames from `recent_idx` on.
    recent: VecDeque<Option<FrameAnswer>>,
    recent_idx: usize,
    tally: Tally,
}

impl Ledger {
    /// For frames from this one on.
    pub(crate) fn new(first_idx: usize) -> Self {
        Self { recent: VecDeque::new(), recent_idx: first_idx, tally: Tally::default() }
    }

    /// Notes the answer to a frame. A repeat says less than the first answer did, so it only stands where
    /// that never arrived.
    pub(crate) fn note(&mut self, frame_idx: usize, answer: FrameAnswer) {
        let Some(place) = frame_idx.checked_sub(self.recent_idx) else { return };
        if place >= self.recent.len() {
            self.fill(frame_idx + 1);
        }
        let place = frame_idx - self.recent_idx;
        let slot = &mut self.recent[place];
        let is_repeat = matches!(&answer, FrameAnswer::Result(result) if result.repeated);
        if slot.is_none() || !is_repeat {
            *slot = Some(answer);
        }
    }

    /// The summary of the frames up to `end_idx`, which it does not include.
    pub(crate) fn finish(mut self, end_idx: usize) -> StreamSummary {
        self.fill(end_idx);
        self.recent.iter().for_each(|answer| self.tally.add(answer.as_ref()));
        self.tally.finish()
    }

    /// Makes places for the frames up to `end_idx`, and counts the answers that get too old for it.
    fn fill(&mut self, end_idx: usize) {
        while self.recent_idx + self.recent.len() < end_idx {
            if self.recent.len() == N_RECENT {
                let oldest = self.recent.pop_front().flatten();
                self.tally.add(oldest.as_ref());
                self.recent_idx += 1;
            }
            self.recent.push_back(None);
        }
    }
}

/// Counts and times.
#[derive(Debug, Default)]
struct Tally {
    summary: StreamSummary,
    n_with_pose: usize,
    wall_ms: Sample,
    tracking_cpu_ms: Sample,
    /// By stage, in the order in which they first ran.
    stages: Vec<(String, Sample)>,
    /// Time of the first and of the last frame with a result, nanoseconds, and its number.
    first: Option<(usize, i64)>,
    last: Option<(usize, i64)>,
}

impl Tally {
    fn add(&mut self, answer: Option<&FrameAnswer>) {
        self.summary.frames += 1;
        match answer {
            Some(FrameAnswer::Result(result)) => self.add_result(result),
            Some(FrameAnswer::Dropped) => self.summary.dropped += 1,
            Some(FrameAnswer::Rejected(_)) => self.summary.rejected += 1,
            None => {}
        }
    }

    fn add_result(&mut self, result: &v1::FrameResult) {
        let summary = &mut self.summary;
        if let Some(found) = result.corrections.iter().rev().find_map(|correction| correction.camera) {
            let v1::CameraCorrection { focal, centre_x: center_x, centre_y: center_y, adopted } = found;
            summary.camera = Some(CameraFinding { focal, center_x, center_y, adopted });
        }
        summary.repeated += usize::from(result.repeated);
        match result.state() {
            v1::TrackingState::Tracked => summary.tracked += 1,
            v1::TrackingState::Weak => summary.weak += 1,
            v1::TrackingState::Initialising => summary.initialising += 1,
            v1::TrackingState::Lost => summary.lost += 1,
            // A repeated frame whose answer the server no longer has.
            v1::TrackingState::Unspecified => {}
        }
        self.n_with_pose += usize::from(result.pose_world_from_camera.is_some());
        self.last = Some((summary.frames, result.timestamp_ns));
        self.first = self.first.or(self.last);
        if let Some(timings) = &result.timings {
            self.add_timings(timings);
        }
    }

    fn add_timings(&mut self, timings: &v1::FrameTimings) {
        self.wall_ms.add(timings.total_ms);
        self.tracking_cpu_ms.add(timings.tracking_cpu_ms);
        for stage in &timings.stages {
            match self.stages.iter_mut().find(|(name, _)| *name == stage.name) {
                Some((_, sample)) => sample.add(stage.ms),
                None => {
                    let mut sample = Sample::default();
                    sample.add(stage.ms);
                    self.stages.push((stage.name.clone(), sample));
                }
            }
        }
    }

    fn finish(self) -> StreamSummary {
        let Self { mut summary, first, last, .. } = self;
        summary.coverage = self.n_with_pose as f64 / summary.frames.max(1) as f64;
        summary.wall_ms = self.wall_ms.distribution();
        summary.tracking_cpu_ms = self.tracking_cpu_ms.distribution();
        let stage = |(name, sample): (String, Sample)| {
            Some(StageSummary { name, frames: sample.n_seen, ms: sample.distribution()? })
        };
        summary.stages = self.stages.into_iter().filter_map(stage).collect();
        if let Some(((first_idx, first_ns), (last_idx, last_ns))) = first.zip(last)
            && last_idx > first_idx
        {
            let between_s = last_ns.saturating_sub(first_ns) as f64 * 1e-9;
            summary.recorded_s = between_s * summary.frames as f64 / (last_idx - first_idx) as f64;
        }
        summary
    }
}

/// Values of which no more than [`MAX_VALUES`] are kept: from there on every second, then every fourth, and
/// so on, evenly over the whole stream.
#[derive(Debug)]
struct Sample {
    values: Vec<f64>,
    n_seen: usize,
    every: usize,
}

impl Default for Sample {
    fn default() -> Self {
        Self { values: Vec::new(), n_seen: 0, every: 1 }
    }
}

impl Sample {
    fn add(&mut self, value: f64) {
        if self.n_seen.is_multiple_of(self.every) {
            if self.values.len() == MAX_VALUES {
                let mut is_kept = false;
                self.values.retain(|_| {
                    is_kept = !is_kept;
                    is_kept
                });
                self.every *= 2;
            }
            // A full sample has an even number of values, so this one is of the coarser series too.
            self.values.push(value);
        }
        self.n_seen += 1;
    }

    fn distribution(&self) -> Option<Distribution> {
        Distribution::of(self.values.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tallied(answers: &[Option<FrameAnswer>]) -> StreamSummary {
        let mut ledger = Ledger::new(0);
        for (frame_idx, answer) in answers.iter().enumerate() {
            if let Some(answer) = answer {
                ledger.note(frame_idx, answer.clone());
            }
        }
        ledger.finish(answers.len())
    }

    fn answer(state: v1::TrackingState, total_ms: f64, stages: &[(&str, f64)]) -> Option<FrameAnswer> {
        let has_pose = matches!(state, v1::TrackingState::Tracked | v1::TrackingState::Weak);
        let stage = |(name, ms): &(&str, f64)| v1::StageTime { name: (*name).to_owned(), ms: *ms };
        let timings = v1::FrameTimings {
            stages: stages.iter().map(stage).collect(),
            total_ms,
            tracking_cpu_ms: total_ms / 2.0,
            queue_ms: 0.0,
        };
        Some(FrameAnswer::Result(Box::new(v1::FrameResult {
            state: state.into(),
            pose_world_from_camera: has_pose.then(v1::Pose::default),
            timings: Some(timings),
            ..Default::default()
        })))
    }

    #[test]
    fn every_frame_is_counted_once() {
        use v1::TrackingState::{Initialising, Lost, Tracked, Weak};
        let answers = [
            answer(Initialising, 1.0, &[("points", 1.0)]),
            answer(Tracked, 2.0, &[("points", 3.0), ("pose", 0.5)]),
            answer(Weak, 3.0, &[("points", 2.0)]),
            answer(Lost, 4.0, &[]),
            Some(FrameAnswer::Dropped),
            Some(FrameAnswer::Rejected("too small".into())),
            None,
            answer(Tracked, f64::NAN, &[]),
        ];
        let summary = tallied(&answers);
        assert_eq!((summary.frames, summary.tracked, summary.weak, summary.initialising), (8, 2, 1, 1));
        assert_eq!((summary.lost, summary.dropped, summary.rejected), (1, 1, 1));
        assert_eq!(summary.coverage, 3.0 / 8.0);
        assert_eq!(summary.wall_ms.unwrap().median, 2.5);
        assert_eq!(summary.tracking_cpu_ms.unwrap().median, 1.25);
        let stages: Vec<_> =
            summary.stages.iter().map(|s| (s.name.as_str(), s.frames, s.ms.median)).collect();
        assert_eq!(stages, [("points", 3, 2.0), ("pose", 1, 0.5)]);
    }

    #[test]
    fn a_long_stream_is_counted_without_being_kept() {
        let n_frames = 3 * MAX_VALUES;
        let mut ledger = Ledger::new(10);
        for i in 0..n_frames {
            let state = v1::TrackingState::Tracked;
            ledger.note(10 + i, answer(state, i as f64, &[("points", 1.0)]).unwrap());
            assert!(ledger.recent.len() <= N_RECENT && ledger.tally.wall_ms.values.len() <= MAX_VALUES);
        }
        // What is too old to be replaced is not counted twice.
        ledger.note(10, FrameAnswer::Dropped);
        let summary = ledger.finish(10 + n_frames);
        assert_eq!((summary.frames, summary.tracked, summary.dropped), (n_frames, n_frames, 0));
        assert_eq!(summary.stages[0].frames, n_frames);
        let median = summary.wall_ms.unwrap().median;
        assert!((median / n_frames as f64 - 0.5).abs() < 1e-3, "{median}");
    }

    #[test]
    fn a_repeat_does_not_replace_the_answer() {
        let mut ledger = Ledger::new(0);
        ledger.note(1, answer(v1::TrackingState::Tracked, 1.0, &[]).unwrap());
        let repeat = v1::FrameResult { repeated: true, ..Default::default() };
        ledger.note(0, FrameAnswer::Result(Box::new(repeat.clone())));
        ledger.note(1, FrameAnswer::Result(Box::new(repeat)));
        let summary = ledger.finish(3);
        assert_eq!((summary.frames, summary.tracked, summary.repeated), (3, 1, 1));
    }
}
