//! How long a typical keyframe takes to store: one new keyframe of 1000 keypoints, 300 new points, 2000
//! points and 20 keyframes moved by bundle adjustment, 5 frames of trajectory. `cargo bench -p store`.

use futures_util::TryStreamExt;
use slam::map::{MapChanges, MapParts, SubmapId};
use slam::{Keyframe, MapUpdate, SlamConfig};
use std::time::{Duration, Instant};
use store::{Durability, PointQuery, Store, StoreOptions, TrajectoryFilter, TrajectoryKind};
use testkit::stored::*;
use testkit::world::*;

const START: Size = Size { n_keyframes: 60, n_keypoints: 1000, n_points: 5000 };
const N_UPDATES: u64 = 40;
const N_NEW_POINTS: u64 = 300;
const N_MOVED_POINTS: usize = 2000;
const N_MOVED_KEYFRAMES: usize = 20;
/// How far bundle adjustment moves a point, map units; points are seen from 1 to 3.
const STEP: f64 = 0.005;

#[tokio::main(flavor = "current_thread")]
async fn main() {
    for durability in [Durability::PowerLoss, Durability::ProcessEnd] {
        let folder = tempfile::tempdir().unwrap();
        let options = StoreOptions { durability, ..StoreOptions::default() };
        let store = Store::open(folder.path().join("maps.db"), options).await.unwrap();
        store.create_session(&new_session("s")).await.unwrap();
        let mut parts = parts(1, START);
        let begin = Instant::now();
        store.save_update("s", &first_update(&parts), TRACKED, &[]).await.unwrap();
        println!("{durability:?}: whole map of {} points: {:.1} ms", START.n_points, ms(begin.elapsed()));

        let mut times = Vec::new();
        let mut cpu = Duration::ZERO;
        for round in 0..N_UPDATES {
            let update = next_update(&mut parts, round);
            let (begin, cpu_before) = (Instant::now(), cpu_time());
            store.save_update("s", &update, TRACKED, &[]).await.unwrap();
            times.push(begin.elapsed());
            cpu += cpu_time().saturating_sub(cpu_before);
        }
        times.sort_unstable();
        let n_rows = N_MOVED_POINTS as u64 + N_NEW_POINTS + N_MOVED_KEYFRAMES as u64 + 7;
        let median = times[times.len() / 2];
        println!(
            "{durability:?}: keyframe update of {n_rows} rows: median {:.2} ms ({:.2} us a row), slowest {:.2} ms; \
             CPU {:.2} ms each",
            ms(median),
            1e3 * ms(median) / n_rows as f64,
            ms(times[times.len() - 1]),
            ms(cpu) / N_UPDATES as f64,
        );
        read_back(&store).await;
    }
}

/// The map with one more keyframe, after bundle adjustment moved what is near it.
fn next_update(parts: &mut MapParts, round: u64) -> MapUpdate {
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

async fn read_back(store: &Store) {
    let begin = Instant::now();
    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap().resume.map;
    let (n_keyframes, n_points) = (loaded.keyframes.len(), loaded.points.len());
    println!("  load {n_keyframes} keyframes and {n_points} points: {:.1} ms", ms(begin.elapsed()));
    let begin = Instant::now();
    let near = PointQuery { near: Some((nalgebra::Vector3::zeros(), 1.0)), ..PointQuery::default() };
    let found: Vec<_> = store.points("s", near).await.unwrap().try_collect().await.unwrap();
    println!("  {} points in a ball: {:.2} ms", found.len(), ms(begin.elapsed()));
    let begin = Instant::now();
    let poses = store.trajectory("s", TrajectoryKind::Frames, TrajectoryFilter::default()).await.unwrap();
    let poses: Vec<_> = poses.try_collect().await.unwrap();
    println!("  {} poses of the trajectory: {:.2} ms", poses.len(), ms(begin.elapsed()));
}

/// CPU time of all threads so far, which tells more than wall time on a shared machine; zero where Linux's
/// `/proc` is missing.
fn cpu_time() -> Duration {
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else { return Duration::ZERO };
    let nanoseconds = threads.flatten().filter_map(|thread| {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    Duration::from_nanos(nanoseconds.sum())
}

fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}
