//! Time as the engine sees it: handed in from outside, so that the engine itself reads no clock.

/// A source of times for the stage timings in the reports.
pub trait Clock: Send + Sync {
    /// Wall time since some fixed moment, nanoseconds; never goes back.
    fn wall_ns(&self) -> u64;
    /// CPU time of the calling thread, nanoseconds.
    fn thread_cpu_ns(&self) -> u64;
}

/// A clock that stands still: timings are all zero.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoClock;

impl Clock for NoClock {
    fn wall_ns(&self) -> u64 {
        0
    }
    fn thread_cpu_ns(&self) -> u64 {
        0
    }
}
