//! The same update stored in PostgreSQL, in maps of 60, 1000 and 10 000 keyframes, and a hundredth of a
//! million points asked for. On a server that is started for it, without waiting for the disk. `cargo bench
//! -p store`.

mod update;

use futures_util::TryStreamExt;
use nalgebra::Vector3;
use sqlx::{AssertSqlSafe, PgPool};
use std::time::{Duration, Instant};
use store::{Bounds, PointQuery, Store, StoreOptions};
use testkit::stored::*;
use testkit::world::*;
use update::{START, cpu_time, ms, n_rows, next_update};

const N_UPDATES: u64 = 40;
/// Keyframes that the map has besides, and points of each.
const SIZES: [u64; 3] = [0, 1_000, 10_000];
const POINTS_PER_KEYFRAME: u64 = 100;
/// Ids of what is added.
const FIRST_ID: u64 = 1_000_000;

#[tokio::main(flavor = "current_thread")]
async fn main() {
    if !testkit::postgres::is_installed() {
        println!("PostgreSQL is not installed");
        return;
    }
    let url = testkit::postgres::shared_database();
    let store = Store::connect(&url, StoreOptions::default()).await.unwrap();
    let beside = PgPool::connect(&url).await.unwrap();
    store.create_session(&new_session("s")).await.unwrap();
    let mut parts = parts(1, START);
    store.save_update("s", &first_update(&parts), TRACKED, &[]).await.unwrap();
    let (mut round, mut n_before) = (0, 0);
    for n_keyframes in SIZES {
        fill(&beside, n_before..n_keyframes).await;
        n_before = n_keyframes;
        let (mut times, mut cpu) = (Vec::new(), Duration::ZERO);
        for _ in 0..N_UPDATES {
            let update = next_update(&mut parts, round);
            round += 1;
            let (begin, cpu_before) = (Instant::now(), cpu_time());
            store.save_update("s", &update, TRACKED, &[]).await.unwrap();
            times.push(begin.elapsed());
            cpu += cpu_time().saturating_sub(cpu_before);
        }
        times.sort_unstable();
        println!(
            "{} keyframes: update of {} rows: median {:.1} ms, slowest {:.1} ms; CPU {:.1} ms each",
            START.n_keyframes + n_keyframes,
            n_rows(),
            ms(times[times.len() / 2]),
            ms(times[times.len() - 1]),
            ms(cpu) / N_UPDATES as f64,
        );
    }
    ask(&store).await;
}

/// Adds keyframes and points, each like the first but for where it is: strips a unit wide and a hundred long.
async fn fill(database: &PgPool, numbers: std::ops::Range<u64>) {
    if numbers.is_empty() {
        return;
    }
    let (first, last) = (numbers.start, numbers.end - 1);
    let keyframes = format!(
        "INSERT INTO keyframes SELECT session, {FIRST_ID} + n, submap, {FIRST_ID} + n, {FIRST_ID} + n, qx, qy, qz, qw, tx, ty, \
         tz, NULL, n_keypoints, 0, n_segments, 0, unit FROM generate_series({first}, {last}) n, \
         (SELECT * FROM keyframes ORDER BY id LIMIT 1) one"
    );
    let (first, last) = (first * POINTS_PER_KEYFRAME, (last + 1) * POINTS_PER_KEYFRAME - 1);
    let points = format!(
        "INSERT INTO points SELECT session, {FIRST_ID} + n, submap, n / 10000 + random(), 100 * random(), 10 * random(), \
         descriptor, view_x, view_y, view_z, 1, 8, created_by, n_visible, n_found, n_observations, observations \
         FROM generate_series({first}, {last}) n, (SELECT * FROM points ORDER BY id LIMIT 1) one"
    );
    let cell = |axis| format!("floor({axis} * 2) / 2, floor({axis} * 2) / 2 + 0.5");
    let cells = format!(
        "INSERT INTO point_cells SELECT (session << 40) | id, session, session, {}, {}, {} FROM points \
         WHERE id BETWEEN {FIRST_ID} + {first} AND {FIRST_ID} + {last}",
        cell("x"),
        cell("y"),
        cell("z")
    );
    for sql in [keyframes, points, cells, "ANALYZE".to_owned()] {
        sqlx::query(AssertSqlSafe(sql)).execute(database).await.unwrap();
    }
}

/// Every point of a box of ten by ten strips' widths, which is a hundredth of the map.
async fn ask(store: &Store) {
    let bounds = Bounds { min: Vector3::new(40.0, 30.0, 0.0), max: Vector3::new(50.0, 40.0, 10.0) };
    let query = PointQuery { bounds: Some(bounds), ..PointQuery::default() };
    let mut times = Vec::new();
    let mut n_points = 0;
    for _ in 0..5 {
        let begin = Instant::now();
        let found: Vec<_> = store.placed_points("s", query).await.unwrap().try_collect().await.unwrap();
        times.push(begin.elapsed());
        n_points = found.len();
    }
    times.sort_unstable();
    println!(
        "{n_points} points of a million in a box: median {:.1} ms, slowest {:.1} ms",
        ms(times[2]),
        ms(times[4])
    );
}
