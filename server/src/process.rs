//! What the process takes of its machine, for `/metrics`. What cannot be told here is left out.

use crate::clock::since_1970_ns;
use std::path::Path;
use std::time::Duration;

/// When this was asked first, seconds since 1970: the process asks when it begins.
pub fn started_at_s() -> f64 {
    static STARTED: std::sync::OnceLock<f64> = std::sync::OnceLock::new();
    *STARTED.get_or_init(|| since_1970_ns() as f64 * 1e-9)
}

/// Notes it, with the files of the database.
pub fn measure(database: &Path) {
    metrics::gauge!("monoslam_build_info", "version" => env!("CARGO_PKG_VERSION")).set(1.0);
    metrics::gauge!("process_start_time_seconds").set(started_at_s());
    metrics::counter!("process_cpu_seconds_total").absolute(cpu_time().as_secs());
    if let Some(n_bytes) = resident_bytes() {
        metrics::gauge!("process_resident_memory_bytes").set(n_bytes as f64);
    }
    if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
        metrics::gauge!("process_open_fds").set(files.count() as f64);
    }
    if let Some(n_files) = max_files() {
        metrics::gauge!("process_max_fds").set(n_files as f64);
    }
    let log = database.with_extension("sqlite-wal");
    let n_bytes: u64 =
        [database, &log].iter().filter_map(|file| file.metadata().ok()).map(|file| file.len()).sum();
    metrics::gauge!("monoslam_database_bytes").set(n_bytes as f64);
    if let Some(n_bytes) = database.parent().and_then(free_bytes) {
        metrics::gauge!("monoslam_disk_free_bytes").set(n_bytes as f64);
    }
}

fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let n_pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    // SAFETY: asks for a constant.
    let page_bytes = u64::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).ok()?;
    Some(n_pages * page_bytes)
}

fn cpu_time() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid timespec that the call writes to and does not keep.
    let outcome = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    if outcome == 0 { Duration::new(time.tv_sec as u64, time.tv_nsec as u32) } else { Duration::ZERO }
}

fn max_files() -> Option<u64> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `limit` is valid, and the call writes to it alone.
    let outcome = unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) };
    (outcome == 0).then_some(limit.rlim_cur)
}

/// What is free in the file system of a folder.
fn free_bytes(folder: &Path) -> Option<u64> {
    use std::os::unix::ffi::OsStrExt;
    let path = std::ffi::CString::new(folder.as_os_str().as_bytes()).ok()?;
    // SAFETY: all zero is a valid value of this struct of numbers.
    let mut found: libc::statvfs = unsafe { std::mem::zeroed() };
    // SAFETY: the path ends with a zero, and the call writes to `found` alone.
    let outcome = unsafe { libc::statvfs(path.as_ptr(), &mut found) };
    // Their widths differ between systems.
    #[allow(clippy::unnecessary_cast)]
    (outcome == 0).then(|| found.f_bavail as u64 * found.f_frsize as u64)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn figures_are_of_this_process() {
        let resident = resident_bytes().unwrap();
        assert!((1 << 20..1 << 36).contains(&resident), "{resident}");
        assert!(max_files().unwrap() >= 64);
        assert!(free_bytes(Path::new("/")).is_some() && free_bytes(Path::new("/nonexistent")).is_none());
        let before = cpu_time();
        let begun = std::time::Instant::now();
        while begun.elapsed() < Duration::from_millis(20) {
            std::hint::black_box(0);
        }
        assert!(cpu_time() > before);
    }
}
