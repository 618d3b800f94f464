//! Time as the engine sees it: handed in from outside, so that the engine itself reads no clock.

use crate::beside::beside;
use crate::report::StageTime;

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

/// Times the stages of one frame.
pub(crate) struct Stopwatch {
    clock: std::sync::Arc<dyn Clock>,
    start_wall_ns: u64,
    start_cpu_ns: u64,
    lap_start_ns: u64,
    stages: Vec<StageTime>,
}

/// What a [`Stopwatch`] measured.
pub(crate) struct FrameTimes {
    pub stages: Vec<StageTime>,
    pub wall_ns: u64,
    pub cpu_ns: u64,
}

impl Stopwatch {
    pub fn start(clock: std::sync::Arc<dyn Clock>) -> Self {
        let (start_wall_ns, start_cpu_ns) = (clock.wall_ns(), clock.thread_cpu_ns());
        Self {
            clock,
            start_wall_ns,
            start_cpu_ns,
            lap_start_ns: start_wall_ns,
            stages: Vec::with_capacity(8),
        }
    }

    /// Ends the stage that ran since the start or the lap before.
    pub fn lap(&mut self, name: &'static str) {
        let now = self.clock.wall_ns();
        self.stages.push(StageTime { name, wall_ns: now.saturating_sub(self.lap_start_ns) });
        self.lap_start_ns = now;
    }

    /// A stage of its own.
    pub fn time<T>(&mut self, name: &'static str, stage: impl FnOnce() -> T) -> T {
        let result = stage();
        self.lap(name);
        result
    }

    /// Two stages beside each other, the second on a thread of its own if there can be one. Each is given the time it took.
    pub fn time_both<A, B: Send>(
        &mut self,
        (first_name, first): (&'static str, impl FnOnce() -> A),
        (second_name, second): (&'static str, impl FnOnce() -> B + Send),
    ) -> (A, B) {
        let clock = self.clock.clone();
        let timed_second = move || {
            let start_ns = clock.wall_ns();
            let result = second();
            (result, clock.wall_ns().saturating_sub(start_ns))
        };
        let (first, (second, wall_ns)) = beside(second_name, || self.time(first_name, first), timed_second);
        self.stages.push(StageTime { name: second_name, wall_ns });
        self.lap_start_ns = self.clock.wall_ns();
        (first, second)
    }

    pub fn finish(self) -> FrameTimes {
        FrameTimes {
            wall_ns: self.clock.wall_ns().saturating_sub(self.start_wall_ns),
            cpu_ns: self.clock.thread_cpu_ns().saturating_sub(self.start_cpu_ns),
            stages: self.stages,
        }
    }
}
