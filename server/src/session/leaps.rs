//! Frames whose number or time cannot be meant, and times after a clock was set.
//!
//! A number or time far ahead would be the last one that a session takes. The engine's times only go on;
//! where a client begins a new segment, they go on behind the last ones, whatever its clock says.

use super::decoder::{NEW_SEGMENT, rejection_of};
use super::frame::Rejection;
use crate::config::SessionConfig;
use crate::error::ApiError;
use slam::FrameError;

/// What passes for the engine between two segments, nanoseconds: an hour, after which nothing in it holds the
/// camera to be near where it was (`ContinuityConfig::max_elapsed_ns` is ten seconds).
const BETWEEN_SEGMENTS_NS: i64 = 3_600_000_000_000;

/// How far frames may leap.
#[derive(Clone, Copy, Debug)]
pub struct Leaps {
    max_sequence: u64,
    max_time_ns: i64,
}

impl Leaps {
    /// As configured.
    pub fn of(config: &SessionConfig) -> Self {
        let max_time_ns = (config.max_time_leap_s * 1e9) as i64;
        Self { max_sequence: config.max_sequence_leap, max_time_ns }
    }

    /// Checks the number of a new frame.
    ///
    /// # Errors
    /// If it is too far beyond the one that is expected.
    fn check_sequence(&self, last_frame: Option<(u64, i64)>, sequence: u64) -> Result<(), Rejection> {
        let expected = last_frame.map_or(0, |(last, _)| last.saturating_add(1));
        let leap = sequence.saturating_sub(expected);
        if leap <= self.max_sequence {
            return Ok(());
        }
        let reason = format!(
            "sequence {sequence} is {leap} beyond {expected}, which is expected, and {} is the most \
             (sessions.max_sequence_leap): count on from next_sequence",
            self.max_sequence
        );
        Err(Rejection { sequence, field: "sequence", reason, code: "SEQUENCE_LEAP" })
    }

    /// Checks the time of a new frame.
    ///
    /// # Errors
    /// If it is not after that of the frame before, or too far.
    fn check_time(
        &self,
        last_frame: Option<(u64, i64)>,
        sequence: u64,
        timestamp_ns: i64,
    ) -> Result<(), Rejection> {
        let Some((_, last_timestamp_ns)) = last_frame else { return Ok(()) };
        if timestamp_ns <= last_timestamp_ns {
            let error = FrameError::TimestampNotIncreasing { timestamp_ns, last_timestamp_ns };
            return Err(rejection_of(&error, sequence));
        }
        let leap_ns = timestamp_ns.saturating_sub(last_timestamp_ns);
        if leap_ns <= self.max_time_ns {
            return Ok(());
        }
        let reason = format!(
            "timestamp_ns {timestamp_ns} is {:.0} s after the last frame's {last_timestamp_ns}, and {:.0} s is the most \
             (sessions.max_time_leap_s); if the clock was set, {NEW_SEGMENT}",
            leap_ns as f64 * 1e-9,
            self.max_time_ns as f64 * 1e-9
        );
        Err(Rejection { sequence, field: "timestamp_ns", reason, code: "TIMESTAMP_LEAP" })
    }
}

/// The engine's times of a session's frames, which only go on, whatever the client's clock does.
#[derive(Debug)]
pub struct EngineTimes {
    leaps: Leaps,
    /// By how much they are ahead of the client's, nanoseconds.
    ahead_ns: i64,
    /// The next new frame begins a segment.
    begins_segment: bool,
}

impl EngineTimes {
    /// `ahead_ns` is by how much they are ahead in the segment that was begun last, nanoseconds.
    pub fn new(leaps: Leaps, ahead_ns: i64) -> Self {
        Self { leaps, ahead_ns, begins_segment: false }
    }

    /// A stream begins, and with its first new frame a segment or not.
    pub fn begin_stream(&mut self, begins_segment: bool) {
        self.begins_segment = begins_segment;
    }

    /// That of a new frame. `begin` stores that it begins a segment, where one is to begin.
    ///
    /// # Errors
    /// If the frame's number or time cannot be meant, there is no such time, or `begin` failed.
    pub fn of(
        &mut self,
        last_frame: Option<(u64, i64)>,
        sequence: u64,
        timestamp_ns: i64,
        begin: impl FnOnce(i64) -> Result<(), ApiError>,
    ) -> Result<i64, Rejection> {
        self.leaps.check_sequence(last_frame, sequence)?;
        match last_frame.filter(|_| self.begins_segment) {
            None => self.leaps.check_time(last_frame, sequence, timestamp_ns)?,
            Some((_, last_timestamp_ns)) => {
                let ahead_ns = self.ahead_of_segment(last_timestamp_ns, timestamp_ns);
                let ahead_ns = ahead_ns.ok_or_else(|| out_of_range(sequence, timestamp_ns))?;
                begin(ahead_ns).map_err(|error| not_begun(sequence, &error))?;
                (self.ahead_ns, self.begins_segment) = (ahead_ns, false);
            }
        }
        timestamp_ns.checked_add(self.ahead_ns).ok_or_else(|| out_of_range(sequence, timestamp_ns))
    }

    /// By how much they are ahead in a segment that begins with a frame of this time; `None` if there are no
    /// times left.
    fn ahead_of_segment(&self, last_timestamp_ns: i64, timestamp_ns: i64) -> Option<i64> {
        let last_ns = last_timestamp_ns.checked_add(self.ahead_ns)?;
        last_ns.checked_add(BETWEEN_SEGMENTS_NS)?.checked_sub(timestamp_ns)
    }
}

fn out_of_range(sequence: u64, timestamp_ns: i64) -> Rejection {
    let reason =
        format!("timestamp_ns {timestamp_ns} is too far from the session's other times, or from zero");
    Rejection { sequence, field: "timestamp_ns", reason, code: "TIMESTAMP_OUT_OF_RANGE" }
}

/// A segment that could not be stored.
fn not_begun(sequence: u64, error: &ApiError) -> Rejection {
    let reason = format!("a new segment cannot be begun now: {error}");
    Rejection { sequence, field: "timestamp_ns", reason, code: "SEGMENT_NOT_BEGUN" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaps_that_cannot_be_meant_are_refused_and_say_how_to_go_on() {
        let leaps = Leaps::of(&SessionConfig::default());
        let last = Some((7, 1_000));
        assert!(leaps.check_sequence(last, 1_000_000_008).is_ok() && leaps.check_sequence(None, 5).is_ok());
        for (last, sequence) in [(last, 1_000_000_009), (None, i64::MAX as u64), (last, i64::MAX as u64)] {
            let refused = leaps.check_sequence(last, sequence).unwrap_err();
            assert!(
                refused.code == "SEQUENCE_LEAP" && refused.reason.contains("next_sequence"),
                "{refused:?}"
            );
        }
        assert!(leaps.check_time(last, 8, 1_000 + 31_622_400_000_000_000).is_ok());
        assert!(leaps.check_time(None, 0, i64::MIN).is_ok(), "of the first frame any time will do");
        for timestamp_ns in [i64::MAX, 1_001 + 31_622_400_000_000_000] {
            let refused = leaps.check_time(last, 8, timestamp_ns).unwrap_err();
            assert!(
                refused.code == "TIMESTAMP_LEAP" && refused.reason.contains("new_segment"),
                "{refused:?}"
            );
        }
        let refused = leaps.check_time(Some((7, 10_000_000_000)), 8, 5).unwrap_err();
        assert!(
            refused.code == "TIMESTAMP_NOT_INCREASING" && refused.reason.contains("new_segment"),
            "{refused:?}"
        );
    }

    #[test]
    fn the_engines_times_go_on_whatever_the_clock_says() {
        let begun = |last, ahead_ns, timestamp_ns| {
            let mut times = EngineTimes::new(Leaps::of(&SessionConfig::default()), ahead_ns);
            times.begin_stream(true);
            let mut stored = None;
            let engine_ns = times.of(Some(last), 8, timestamp_ns, |ahead_ns| {
                stored = Some(ahead_ns);
                Ok(())
            });
            engine_ns.map(|engine_ns| (engine_ns, stored, times.ahead_ns))
        };
        for timestamp_ns in [-1_000_000, 0, 49_000, i64::MAX / 2] {
            let (engine_ns, stored, ahead_ns) = begun((7, 50_000), 200, timestamp_ns).unwrap();
            assert_eq!(engine_ns, 50_200 + BETWEEN_SEGMENTS_NS);
            assert_eq!((stored, timestamp_ns + ahead_ns), (Some(ahead_ns), engine_ns));
        }
        assert!(begun((7, i64::MAX), 0, 0).is_err());
        assert!(begun((7, 50_000), 200, i64::MIN).is_err());
        let mut times = EngineTimes::new(Leaps::of(&SessionConfig::default()), 1);
        assert!(times.of(None, 0, i64::MAX, |_| Ok(())).is_err());
        times.begin_stream(true);
        let not_stored = times.of(Some((7, 5)), 8, 3, |_| Err(ApiError::internal("no disk")));
        assert_eq!(not_stored.unwrap_err().code, "SEGMENT_NOT_BEGUN");
        assert_eq!(times.ahead_ns, 1, "nothing was begun");
    }
}
