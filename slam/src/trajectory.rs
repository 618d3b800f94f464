//! The trajectory until it is stored: which frames' poses are waiting, and which may yet be taken back.

use crate::map::{CameraId, FramePose, FrameRecord, FrameState};
use std::collections::VecDeque;

/// Frames without a keyframe after which the trajectory so far is handed out to be stored.
const MAX_UNRECORDED_FRAMES: usize = 30;
/// Repetitions of images that are remembered; the oldest go when there are more. Frames are placed anew for
/// some five seconds.
const MAX_REPETITIONS: usize = 1000;

/// Poses of frames that are not stored yet.
#[derive(Debug, Default)]
pub(crate) struct TrajectoryLog {
    /// Frames not yet handed to mapping to be stored with the next keyframe.
    unrecorded: Vec<FrameRecord>,
    /// Frames of a map so young that it may yet be discarded.
    at_risk: Vec<FrameRecord>,
    /// The last frame with an image of its own.
    last: Option<FrameRecord>,
    repetitions: VecDeque<Repetition>,
}

/// A frame whose image was that of the frame before.
#[derive(Clone, Copy, Debug)]
struct Repetition {
    /// The sequence of the frame whose image it was.
    of: u64,
    sequence: u64,
    timestamp_ns: i64,
}

impl Repetition {
    /// It is where the image was taken.
    fn of(self, record: &FrameRecord) -> FrameRecord {
        let Self { sequence, timestamp_ns, .. } = self;
        FrameRecord { sequence, timestamp_ns, ..record.clone() }
    }
}

impl TrajectoryLog {
    /// Notes a frame. `is_young` says whether its submap may yet be discarded.
    pub fn note(&mut self, record: FrameRecord, is_young: bool) {
        self.last = Some(record.clone());
        self.push(record, is_young);
    }

    /// Notes a frame whose image is that of the last one noted: it is where that is, to the last bit, and
    /// stays with it.
    pub fn repeat(&mut self, record: FrameRecord, is_young: bool) {
        let last = self.last.as_ref().filter(|last| last.pose.is_some() == record.pose.is_some());
        let Some(last) = last else { return self.push(record, is_young) };
        let (sequence, timestamp_ns) = (record.sequence, record.timestamp_ns);
        let repetition = Repetition { of: last.sequence, sequence, timestamp_ns };
        if self.repetitions.len() >= MAX_REPETITIONS {
            self.repetitions.pop_front();
        }
        self.repetitions.push_back(repetition);
        let record = repetition.of(last);
        self.push(record, is_young);
    }

    fn push(&mut self, record: FrameRecord, is_young: bool) {
        if !is_young {
            self.at_risk.clear();
        } else if record.pose.is_some() {
            self.at_risk.push(record.clone());
        }
        self.unrecorded.push(record);
    }

    /// Notes the frame that a map begins with. Returns it with all that came before it.
    pub fn begin_map(&mut self, first: FrameRecord) -> Vec<FrameRecord> {
        self.at_risk = self.with_repetitions(first);
        self.unrecorded.extend(self.at_risk.iter().cloned());
        self.take()
    }

    /// Notes a better pose for a frame that was noted before.
    pub fn replace(&mut self, record: FrameRecord) {
        self.last = Some(record.clone());
        self.unrecorded.push(record);
    }

    /// Notes frames that were placed after the fact.
    pub fn backfill(&mut self, placed: impl IntoIterator<Item = FrameRecord>) {
        for record in placed {
            let records = self.with_repetitions(record);
            self.unrecorded.extend(records);
        }
    }

    /// The record of a frame that was placed anew, with those of the frames that repeat it.
    fn with_repetitions(&mut self, record: FrameRecord) -> Vec<FrameRecord> {
        if let Some(last) = self.last.as_mut().filter(|last| last.sequence == record.sequence) {
            last.clone_from(&record);
        }
        let again = self.repetitions.iter().filter(|repetition| repetition.of == record.sequence);
        let again: Vec<_> = again.map(|repetition| repetition.of(&record)).collect();
        std::iter::once(record).chain(again).collect()
    }

    /// The submap is kept: what was placed in it stays.
    pub fn keep_submap(&mut self) {
        self.at_risk.clear();
    }

    /// The submap is discarded: what was placed in it has no pose.
    pub fn discard_submap(&mut self) {
        let unplaced = |record| FrameRecord {
            pose: None,
            state: FrameState::Initialising,
            reason: "the map that it was placed in was given up".to_owned(),
            ..record
        };
        self.unrecorded.extend(self.at_risk.drain(..).map(unplaced));
    }

    /// Whether so many frames wait that they should be stored without a keyframe.
    pub fn is_full(&self) -> bool {
        self.unrecorded.len() >= MAX_UNRECORDED_FRAMES
    }

    /// Hands out the frames that wait.
    pub fn take(&mut self) -> Vec<FrameRecord> {
        std::mem::take(&mut self.unrecorded)
    }
}

/// The record of the frame at which a map begins: its pose is that of its keyframe.
pub(crate) fn first_record(
    camera: CameraId,
    (sequence, timestamp_ns): (u64, i64),
    pose: FramePose,
) -> FrameRecord {
    let (state, reason) = (FrameState::Tracked, String::new());
    FrameRecord { camera, sequence, timestamp_ns, state, pose: Some(pose), backfilled: true, reason }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{KeyframeId, SubmapId};
    use geometry::Pose;

    fn record(sequence: u64, placed: bool) -> FrameRecord {
        let pose = FramePose {
            submap: SubmapId::default(),
            reference: KeyframeId::from_index(0),
            camera_from_reference: Pose::identity(),
        };
        let timestamp_ns = sequence as i64;
        FrameRecord {
            camera: CameraId::default(),
            sequence,
            timestamp_ns,
            state: FrameState::Tracked,
            pose: placed.then_some(pose),
            backfilled: false,
            reason: String::new(),
        }
    }

    fn placed(log: &mut TrajectoryLog) -> Vec<(u64, bool)> {
        log.take().iter().map(|record| (record.sequence, record.pose.is_some())).collect()
    }

    #[test]
    fn frames_of_a_discarded_submap_lose_their_poses() {
        let mut log = TrajectoryLog::default();
        log.note(record(0, true), true);
        log.note(record(1, false), true);
        assert_eq!(placed(&mut log), [(0, true), (1, false)]);
        log.note(record(2, true), true);
        log.discard_submap();
        assert_eq!(placed(&mut log), [(2, true), (0, false), (2, false)]);
    }

    #[test]
    fn frames_of_a_submap_that_grew_up_keep_their_poses() {
        let mut log = TrajectoryLog::default();
        log.note(record(0, true), true);
        log.note(record(1, true), false);
        log.discard_submap();
        assert_eq!(placed(&mut log), [(0, true), (1, true)]);
    }

    #[test]
    fn a_repeated_image_stays_where_it_was_taken() {
        let mut log = TrajectoryLog::default();
        log.note(record(0, false), true);
        log.repeat(record(1, false), true);
        log.note(record(2, true), true);
        log.repeat(record(3, true), true);
        assert_eq!(placed(&mut log), [(0, false), (1, false), (2, true), (3, true)]);
        log.backfill([record(0, true)]);
        assert_eq!(placed(&mut log), [(0, true), (1, true)]);
        log.discard_submap();
        assert_eq!(placed(&mut log), [(2, false), (3, false)]);
        assert!((0..3 * MAX_REPETITIONS as u64).all(|n| {
            log.repeat(record(4 + n, true), false);
            log.repetitions.len() <= MAX_REPETITIONS
        }));
    }

    #[test]
    fn a_log_fills_without_keyframes() {
        let mut log = TrajectoryLog::default();
        let n = (0..).take_while(|sequence| {
            log.note(record(*sequence, true), false);
            !log.is_full()
        });
        assert_eq!(n.count() + 1, MAX_UNRECORDED_FRAMES);
        assert_eq!(log.take().len(), MAX_UNRECORDED_FRAMES);
        assert!(!log.is_full());
    }
}
