//! When each frame is due.

use std::time::Duration;

/// How fast frames are sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pacing {
    /// As fast as the server takes them.
    Unpaced,
    /// So many frames a second, at most.
    FramesPerSecond(f64),
    /// As fast as they were recorded.
    Recorded,
}

impl Pacing {
    /// How long after the first frame another is due, `n_before` frames and `recorded_ns` nanoseconds after
    /// it in the recording. Zero for a time that is no time.
    pub fn due(self, n_before: usize, recorded_ns: i64) -> Duration {
        match self {
            Self::Unpaced => Duration::ZERO,
            Self::FramesPerSecond(rate) => {
                Duration::try_from_secs_f64(n_before as f64 / rate).unwrap_or(Duration::ZERO)
            }
            Self::Recorded => Duration::from_nanos(recorded_ns.max(0).unsigned_abs()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_due_at_the_rate_or_when_they_were_taken() {
        assert_eq!(Pacing::Unpaced.due(100, 5_000_000_000), Duration::ZERO);
        assert_eq!(Pacing::FramesPerSecond(20.0).due(30, 7), Duration::from_millis(1500));
        assert_eq!(Pacing::FramesPerSecond(0.0).due(30, 7), Duration::ZERO);
        assert_eq!(Pacing::Recorded.due(3, 33_333_333), Duration::from_nanos(33_333_333));
        assert_eq!(Pacing::Recorded.due(3, -1), Duration::ZERO);
    }
}
