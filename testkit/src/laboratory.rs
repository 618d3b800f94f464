//! What the programs share.

use geometry::Pose;
use slam::Clock;
use std::fmt::Write as _;
use std::time::Instant;

/// Wall time from the moment of its making, and the CPU time of the thread that asks.
pub struct WallClock(Instant);

impl WallClock {
    /// Begins to count.
    #[must_use]
    pub fn start() -> Self {
        Self(Instant::now())
    }
}

impl Clock for WallClock {
    fn wall_ns(&self) -> u64 {
        self.0.elapsed().as_nanos() as u64
    }

    fn thread_cpu_ns(&self) -> u64 {
        // schedstat: time on the CPU, time waiting, time slices; nanoseconds.
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
        text.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(0)
    }
}

/// The words of the command line.
pub struct Arguments(Vec<String>);

impl Arguments {
    /// Those of this program.
    #[must_use]
    pub fn read() -> Self {
        Self(std::env::args().skip(1).collect())
    }

    /// All of them.
    pub fn words(&self) -> &[String] {
        &self.0
    }

    /// Whether a word is among them.
    pub fn flag(&self, name: &str) -> bool {
        self.0.iter().any(|argument| argument == name)
    }

    /// The word behind a word.
    pub fn value(&self, name: &str) -> Option<&String> {
        self.0.iter().position(|argument| argument == name).and_then(|at| self.0.get(at + 1))
    }
}

/// Appends one line of a TUM trajectory.
pub fn write_pose(text: &mut String, timestamp_ns: i64, world_from_camera: &Pose) {
    let (t, q) = (world_from_camera.translation, world_from_camera.rotation.coords);
    let (seconds, nanos) = (timestamp_ns / 1_000_000_000, timestamp_ns % 1_000_000_000);
    let _ = writeln!(text, "{seconds}.{nanos:09} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
}

/// Median, 95th percentile and maximum; sorts the values.
pub fn summary(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied().unwrap_or(0.0);
    format!("median {:.2} p95 {:.2} max {:.2}", at(0.5), at(0.95), at(1.0 - 1e-9))
}
