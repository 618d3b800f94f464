//! Time as the engine sees it: handed in from outside, so that the engine itself reads no clock.

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

    /// A stage that ran beside the present one and was timed by itself.
    pub fn add(&mut self, name: &'static str, wall_ns: u64) {
        self.stages.push(StageTime { name, wall_ns });
    }

    /// Leaves out of the next lap the time that has passed since the last.
    pub fn restart_lap(&mut self) {
        self.lap_start_ns = self.clock.wall_ns();
    }

    /// The clock of the measurements.
    pub fn clock(&self) -> &std::sync::Arc<dyn Clock> {
        &self.clock
    }

    pub fn finish(self) -> FrameTimes {
        FrameTimes {
            wall_ns: self.clock.wall_ns().saturating_sub(self.start_wall_ns),
            cpu_ns: self.clock.thread_cpu_ns().saturating_sub(self.start_cpu_ns),
            stages: self.stages,
        }
    }
}
