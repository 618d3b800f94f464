//! Time of vanishing points on one thread: found anew, and followed.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Rotation3, Vector2, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vision::vanishing::{SegmentPlane, VanishingConfig, VanishingEstimator};

/// 40 segments along each of three orthogonal directions, which are returned as well, and 30 others; 1 pixel
/// of noise at a focal length of 458 pixels.
fn scene() -> (Vec<Vector3<f64>>, Vec<SegmentPlane>) {
    let sigma = 1.0 / 458.0;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let rotation = Rotation3::from_euler_angles(0.4, -0.5, 0.2);
    let directions: Vec<_> = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| rotation * axis).to_vec();
    let segments = (0..150)
        .filter_map(|i| {
            let middle = Vector2::new(rng.random_range(-0.8..0.8), rng.random_range(-0.5..0.5));
            let step = match directions.get(i / 40) {
                Some(direction) => direction.xy() - middle * direction.z,
                None => Vector2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)),
            };
            let half = step.normalize() * rng.random_range(0.045..0.165);
            let mut noisy = |point: Vector2<f64>| {
                point + Vector2::new(rng.random_range(-1.7..1.7), rng.random_range(-1.7..1.7)) * sigma
            };
            SegmentPlane::from_normalized(&noisy(middle - half), &noisy(middle + half), sigma)
        })
        .collect();
    (directions, segments)
}

fn vanishing_points(c: &mut Criterion) {
    let (directions, segments) = scene();
    let mut estimator =
        VanishingEstimator::new(VanishingConfig::default(), 1).expect("the default configuration is valid");
    c.bench_function("vanishing points of 150 segments, 500 hypotheses", |b| {
        b.iter(|| black_box(estimator.cluster(black_box(&segments), &[])));
    });
    c.bench_function("follow 3 vanishing points in 150 segments", |b| {
        b.iter(|| black_box(estimator.refit(black_box(&segments), &directions)));
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30);
    targets = vanishing_points
}
criterion_main!(benches);
