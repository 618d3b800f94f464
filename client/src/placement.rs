//! Where in a session the frames of a recording go.

use std::ops::Range;

use crate::source::{FrameError, FrameSource};

/// Nanoseconds between the last frame of a session and the first of another recording that is put behind it,
/// if their own times do not say; also given to each frame of the session whose time is not known. One
/// second: tracking starts anew in any case, and cameras are faster.
const GAP_NS: i64 = 1_000_000_000;

/// Maps frames of a source to sequence numbers and times of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// The first frame of the source that has a place.
    pub first_idx: usize,
    /// Its sequence number.
    pub first_sequence: u64,
    /// What is added to the times of the source, nanoseconds.
    pub shift_ns: i64,
}

/// What a session has already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionEnd {
    /// The sequence number the server expects next.
    pub next_sequence: u64,
    /// The last frame of the session: its sequence number and time in nanoseconds.
    pub last_frame: Option<(u64, i64)>,
}

impl Placement {
    /// Frame `i` of the source becomes frame `i` of the session, at its own time.
    pub const AS_RECORDED: Self = Self { first_idx: 0, first_sequence: 0, shift_ns: 0 };

    /// Places frames of a source in a session that may have frames already.
    ///
    /// A session that holds a frame of this number at this time is of the same recording: frames keep
    /// their numbers, so that the session goes on where it ended. Otherwise, or if the recording is to be
    /// streamed `again`, frames are put behind those that are there, their times shifted if they would not
    /// increase. What a camera takes now is always put behind.
    ///
    /// # Errors
    /// If the times of the source cannot be read.
    pub fn in_session(
        end: SessionEnd,
        source: &dyn FrameSource,
        range: &Range<usize>,
        again: bool,
    ) -> Result<Self, FrameError> {
        if end.next_sequence == 0 || (!again && is_same_recording(end, source)?) {
            return Ok(Self::AS_RECORDED);
        }
        let first_ns = if range.is_empty() { None } else { source.timestamp_ns(range.start)? };
        let first_ns = first_ns.unwrap_or_default();
        let earliest_ns = end.last_frame.map_or(first_ns, |(sequence, timestamp_ns)| {
            let n_gaps = i64::try_from(end.next_sequence.saturating_sub(sequence)).unwrap_or(i64::MAX);
            timestamp_ns.saturating_add(GAP_NS.saturating_mul(n_gaps))
        });
        let shift_ns = earliest_ns.saturating_sub(first_ns).max(0);
        Ok(Self { first_idx: range.start, first_sequence: end.next_sequence, shift_ns })
    }

    /// The sequence number of a frame of the source.
    pub fn sequence(&self, frame_idx: usize) -> u64 {
        self.first_sequence + frame_idx.saturating_sub(self.first_idx) as u64
    }

    /// The frame of the source with that sequence number, or the first frame after it.
    pub fn frame_idx(&self, sequence: u64) -> usize {
        self.first_idx
            + usize::try_from(sequence.saturating_sub(self.first_sequence)).unwrap_or(usize::MAX / 2)
    }
}

/// Whether a session holds the beginning of this recording, as far as its last frame tells.
fn is_same_recording(end: SessionEnd, source: &dyn FrameSource) -> Result<bool, FrameError> {
    if source.is_live() {
        return Ok(false);
    }
    let Some((sequence, timestamp_ns)) = end.last_frame else { return Ok(true) };
    let Ok(frame_idx) = usize::try_from(sequence) else { return Ok(false) };
    Ok(source.timestamp_ns(frame_idx)? == Some(timestamp_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SourceFrame;
    use proto::v1;

    /// Frames at these times.
    struct Times(Vec<i64>);

    impl FrameSource for Times {
        fn n_frames(&self) -> Option<usize> {
            Some(self.0.len())
        }

        fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
            let frame = |time: &i64| SourceFrame { timestamp_ns: *time, image: v1::Image::default() };
            Ok(self.0.get(frame_idx).map(frame))
        }
    }

    fn end(next_sequence: u64, last_frame: Option<(u64, i64)>) -> SessionEnd {
        SessionEnd { next_sequence, last_frame }
    }

    #[test]
    fn the_same_recording_keeps_its_numbers() {
        let source = Times(vec![10, 20, 30, 40]);
        let place = |end| Placement::in_session(end, &source, &(0..4), false).unwrap();
        assert_eq!(place(end(0, None)), Placement::AS_RECORDED);
        assert_eq!(place(end(2, Some((1, 20)))), Placement::AS_RECORDED);
        assert_eq!(place(end(4, Some((3, 40)))), Placement::AS_RECORDED);
        // The last frames may be without a known time.
        assert_eq!(place(end(4, Some((1, 20)))), Placement::AS_RECORDED);
    }

    #[test]
    fn another_recording_goes_behind_what_is_there() {
        let later = Times(vec![2 * GAP_NS, 3 * GAP_NS, 4 * GAP_NS]);
        let placement = Placement::in_session(end(7, Some((6, 60))), &later, &(1..3), false).unwrap();
        assert_eq!(placement, Placement { first_idx: 1, first_sequence: 7, shift_ns: 0 });
        assert_eq!((placement.sequence(1), placement.sequence(2)), (7, 8));
        assert_eq!((placement.frame_idx(8), placement.frame_idx(3)), (2, 1));

        let earlier = Times(vec![0, 10, 20]);
        let placement = Placement::in_session(end(7, Some((6, 60))), &earlier, &(0..3), false).unwrap();
        assert_eq!(placement.shift_ns, 60 + GAP_NS);
        // Two frames after the last known one may have been up to as many seconds later.
        let placement = Placement::in_session(end(9, Some((6, 60))), &earlier, &(1..3), false).unwrap();
        assert_eq!(placement.shift_ns, 50 + 3 * GAP_NS);
    }

    #[test]
    fn the_same_recording_again_goes_behind_itself() {
        let source = Times(vec![10, 20, 30]);
        let placement = Placement::in_session(end(3, Some((2, 30))), &source, &(0..3), true).unwrap();
        assert_eq!(placement, Placement { first_idx: 0, first_sequence: 3, shift_ns: 20 + GAP_NS });
    }
}
