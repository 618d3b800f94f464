//! How long a typical keyframe takes to store: one new keyframe of 1000 keypoints, 300 new points, 2000
//! points and 20 keyframes moved by bundle adjustment, 5 frames of trajectory. `cargo bench -p store`.

mod update;

use futures_util::TryStreamExt;
use slam::SlamConfig;
use std::time::{Duration, Instant};
use store::{Durability, PointQuery, Store, StoreOptions, TrajectoryFilter, TrajectoryKind};
use testkit::stored::*;
use testkit::world::*;
use update::{START, cpu_time, ms, n_rows, next_update};

const N_UPDATES: u64 = 40;

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
        let n_rows = n_rows();
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
