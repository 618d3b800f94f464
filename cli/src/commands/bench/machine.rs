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
}

impl Machine {
    /// This one.
    pub fn this() -> Self {
        let cpu = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| value_of(&text, "model name"));
        Self {
            cpu: cpu.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// Peak of this process's resident memory.
pub fn peak_memory_mib() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kib: f64 = value_of(&status, "VmHWM")?.strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
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
}
