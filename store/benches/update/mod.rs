//! The update that is stored again and again.

use slam::map::{MapChanges, MapParts, SubmapId};
use slam::{Keyframe, MapUpdate};
use std::time::Duration;
use testkit::world::*;

/// The map before.
pub const START: Size = Size { n_keyframes: 60, n_keypoints: 1000, n_points: 5000 };
const N_NEW_POINTS: u64 = 300;
const N_MOVED_POINTS: usize = 2000;
const N_MOVED_KEYFRAMES: usize = 20;
/// How far bundle adjustment moves a point, map units; points are seen from 1 to 3.
const STEP: f64 = 0.005;

/// Rows that an update writes.
pub fn n_rows() -> u64 {
    N_MOVED_POINTS as u64 + N_NEW_POINTS + N_MOVED_KEYFRAMES as u64 + 7
}

/// The map with one more keyframe, after bundle adjustment moved what is near it.
pub fn next_update(parts: &mut MapParts, round: u64) -> MapUpdate {
    let mut numbers = Numbers(1000 + round);
    let id = kf(parts.last_ids.keyframe + 1);
    let last = parts.keyframes.last().unwrap();
    let keyframe = Keyframe::from_parts(
        id,
        SubmapId(0),
        last.sequence + 10,
        last.timestamp_ns + 500_000_000,
        numbers.pose(),
        last.features.clone(),
        Some(last.id),
    );
    parts.keyframes.push(keyframe);
    parts.last_ids.keyframe += 1;
    let mut changes = MapChanges::default();
    // The newest keyframes, where there is room for more points.
    let near = parts.keyframes.len() - 5;
    for _ in 0..N_NEW_POINTS {
        parts.last_ids.point += 1;
        let point = point(&mut numbers, &mut parts.keyframes[near..], pt(parts.last_ids.point));
        changes.points.insert(point.id);
        parts.points.push(point);
    }
    let n_points = parts.points.len();
    for point in &mut parts.points[n_points - N_MOVED_POINTS - N_NEW_POINTS as usize..] {
        point.position += numbers.vector(STEP);
        changes.points.insert(point.id);
    }
    let n_keyframes = parts.keyframes.len();
    for keyframe in &mut parts.keyframes[n_keyframes - N_MOVED_KEYFRAMES - 1..] {
        keyframe.camera_from_world.translation += numbers.vector(STEP);
        changes.keyframes.insert(keyframe.id);
    }
    let frames = (0..5).map(|i| frame(100 + 5 * round + i, id)).collect();
    MapUpdate { map: map(parts), changes, frames }
}

/// CPU time of all threads so far, which tells more than wall time on a shared machine; zero where Linux's
/// `/proc` is missing.
pub fn cpu_time() -> Duration {
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else { return Duration::ZERO };
    let nanoseconds = threads.flatten().filter_map(|thread| {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    Duration::from_nanos(nanoseconds.sum())
}

/// In milliseconds.
pub fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}
