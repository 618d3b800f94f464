//! The machine's clocks: nothing else of this crate asks for the time of day.

use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Wall time from the monotonic clock, CPU time from the calling thread's.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    start: Instant,
}

impl SystemClock {
    /// A clock that starts now.
    pub fn new() -> Self {
        Self { start: Instant::now() }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl slam::Clock for SystemClock {
    fn wall_ns(&self) -> u64 {
        self.start.elapsed().as_nanos() as u64
    }

    fn thread_cpu_ns(&self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `time` is a valid timespec that the call writes to and does not keep.
        let outcome = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
        if outcome != 0 {
            return 0;
        }
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }
}

/// Wall-clock time, nanoseconds since 1970; 0 on a machine whose clock stands before that.
pub fn since_1970_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use slam::Clock;

    #[test]
    fn thread_cpu_time_counts_work_and_not_sleep() {
        let clock = SystemClock::new();
        let before = (clock.wall_ns(), clock.thread_cpu_ns());
        std::thread::sleep(std::time::Duration::from_millis(50));
        let after = (clock.wall_ns(), clock.thread_cpu_ns());
        assert!(after.0 - before.0 >= 50_000_000);
        assert!(after.1 - before.1 < 25_000_000, "sleeping used {} ns of CPU", after.1 - before.1);
    }
}
