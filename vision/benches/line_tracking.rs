//! Time of describing and tracking 150 line segments in images of 640 x 480, on one thread.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use nalgebra::Vector2;
use vision::GrayImage;
use vision::lines::{LineDescriber, LineTracker, LineTrackerConfig, Segment};

/// Side of the squares of a board that hold one rectangle each, pixels.
const CELL: f32 = 80.0;

/// Corners of the rectangle in a square, clockwise on the screen, and its brightness above the ground's.
fn rectangle(column: i32, row: i32) -> ([Vector2<f32>; 4], f32) {
    let hash = (column.wrapping_mul(0x2545_F491) ^ row.wrapping_mul(0x1B87_3593)).unsigned_abs();
    let share = |shift: u32| (hash >> shift & 0xFF) as f32 / 255.0;
    let middle = Vector2::new((column as f32 + 0.5) * CELL, (row as f32 + 0.5) * CELL);
    let (sin, cos) = (1.5 * share(3)).sin_cos();
    let (a, b) = (18.0 + 14.0 * share(7), 12.0 + 10.0 * share(11));
    let (a, b) = (Vector2::new(cos, sin) * a, Vector2::new(-sin, cos) * b);
    let contrast = if hash & 1 == 0 { 60.0 } else { -60.0 };
    ([-a - b, a - b, a + b, b - a].map(|corner| middle + corner), contrast)
}

/// The board, moved, with the sides of all rectangles that lie inside the image.
fn board(by: Vector2<f32>) -> (GrayImage, Vec<Segment>) {
    let inside = |corners: &[Vector2<f32>; 4], p: Vector2<f32>| {
        (0..4).all(|i| (corners[(i + 1) % 4] - corners[i]).perp(&(p - corners[i])) >= 0.0)
    };
    let image = GrayImage::from_fn(640, 480, |x, y| {
        let mut sum = 0.0;
        for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
            let p = Vector2::new(x as f32 + dx, y as f32 + dy) - by;
            let (corners, contrast) = rectangle((p.x / CELL).floor() as i32, (p.y / CELL).floor() as i32);
            let ground = 120.0 + 8.0 * (p.x / 13.0).sin() * (p.y / 17.0).cos();
            sum += ground + if inside(&corners, p) { contrast } else { 0.0 };
        }
        (0.25 * sum + (x.wrapping_mul(31) ^ y.wrapping_mul(17)) as f32 % 4.0) as u8
    });
    let mut segments = Vec::new();
    for (column, row) in (-1..9).flat_map(|column| (-1..7).map(move |row| (column, row))) {
        let (corners, contrast) = rectangle(column, row);
        for side in 0..4 {
            let (from, to) = (corners[side] + by, corners[(side + 1) % 4] + by);
            let (start, end) = if contrast > 0.0 { (from, to) } else { (to, from) };
            let is_inside = |p: Vector2<f32>| p.x > 8.0 && p.y > 8.0 && p.x < 631.0 && p.y < 471.0;
            if is_inside(start) && is_inside(end) {
                segments.push(Segment { start, end, sigma_px: 0.3, gradient: 30.0 });
            }
        }
    }
    segments.truncate(150);
    (image, segments)
}

fn line_tracking(c: &mut Criterion) {
    let (first, first_segments) = board(Vector2::zeros());
    let (second, second_segments) = board(Vector2::new(3.3, -2.1));
    assert_eq!(first_segments.len(), 150);
    let mut describer = LineDescriber::new();
    c.bench_function("describe 150 segments in 640x480", |b| {
        b.iter(|| black_box(describer.describe(black_box(&first), &first_segments)));
    });
    let mut tracker =
        LineTracker::new(LineTrackerConfig::default()).expect("the default configuration is valid");
    tracker.track(&first, first_segments, None);
    let statistics = tracker.clone().track(&second, second_segments.clone(), None).statistics;
    println!("{statistics:?}");
    c.bench_function("track 150 segments in 640x480", |b| {
        b.iter_batched_ref(
            || (tracker.clone(), second_segments.clone()),
            |(tracker, segments)| black_box(tracker.track(&second, std::mem::take(segments), None)),
            BatchSize::LargeInput,
        );
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2))
        .warm_up_time(std::time::Duration::from_millis(500));
    targets = line_tracking
}
criterion_main!(benches);
