//! What figures were measured on.

use std::fs;

use serde::Serialize;

/// A machine, as far as times depend on it.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Model of its processor.
    pub cpu: String,
    /// Threads it runs at a time.
    pub cores: usize,
    /// Time of the [reference job](super::reference) before and after the measurements, milliseconds.
    pub reference_ms: [f64; 2],
}

impl Machine {
    /// This one, with what the reference job took before and after.
    pub fn this(reference_ms: [f64; 2]) -> Self {
        let cpu = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| value_of(&text, "model name"));
        Self {
            cpu: cpu.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            reference_ms,
        }
    }
}

/// Peak of this process's resident memory.
pub fn peak_memory_mib() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kib: f64 = value_of(&status, "VmHWM")?.strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

/// Clock ticks of `/proc` in a second, which Linux has fixed for its interfaces.
const TICKS_PER_SECOND: f64 = 100.0;

/// Processor time that this process has used on all its threads, milliseconds; `None` where the system does
/// not tell.
pub fn process_cpu_ms() -> Option<f64> {
    process_cpu_ms_of(&fs::read_to_string("/proc/self/stat").ok()?)
}

/// User and system time are fields 14 and 15; the second is the program's name in parentheses, which may hold
/// blanks.
fn process_cpu_ms_of(stat: &str) -> Option<f64> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut times = fields.split_ascii_whitespace().skip(11);
    let mut ticks = || times.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) * 1000.0 / TICKS_PER_SECOND)
}

/// The value in the first line `key : value`.
fn value_of(text: &str, key: &str) -> Option<String> {
    let pairs = text.lines().filter_map(|line| line.split_once(':'));
    pairs
        .map(|(k, value)| (k.trim(), value.trim()))
        .find(|(k, _)| *k == key)
        .map(|(_, value)| value.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_their_key() {
        let text = "Name:\tx\nVmHWM:\t  2048 kB\nmodel name\t: Fast CPU @ 3GHz\n";
        assert_eq!(value_of(text, "VmHWM").as_deref(), Some("2048 kB"));
        assert_eq!(value_of(text, "model name").as_deref(), Some("Fast CPU @ 3GHz"));
        assert_eq!(value_of(text, "absent"), None);
    }

    #[test]
    fn times_stand_behind_a_name_with_blanks() {
        let stat = "7 (a (b) c) S 1 1 1 0 -1 4194560 900 0 0 0 120 34 0 0 20 0 4 0 1 2 3";
        assert_eq!(process_cpu_ms_of(stat), Some(1540.0));
        assert_eq!(process_cpu_ms_of("7 (a) S 1"), None);
    }
}
