//! Time of one Levenberg-Marquardt iteration, linearization and cost included, and of a frame's pose.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Bundle, PointReprojection, World, WorldSize, jolted, rng};
use criterion::{BatchSize, BenchmarkId, Criterion, criterion_group, criterion_main};
use optim::{HoldSecond, Kernel, SingleOptions, SolverOptions, UnaryGroup, optimize_single};

fn bundle_iterations(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("bundle_5_iterations");
    group.sample_size(10);
    for (n_cameras, n_points, n_observations) in
        [(20, 2_600, 14_000), (16, 18_700, 82_000), (200, 32_000, 156_000)]
    {
        let world = World::new(WorldSize { n_cameras, n_points, n_observations }, 1.0, 1)
            .disturbed(0.01, 0.05, 0.1, 2);
        let options = SolverOptions {
            max_iterations: 5,
            min_relative_decrease: 0.0,
            min_step: 0.0,
            ..Default::default()
        };
        let fresh = || {
            let mut bundle = Bundle::new(&world, Kernel::huber_95(2));
            bundle.problem.solve(&SolverOptions { max_iterations: 0, ..options }, || false);
            bundle
        };
        group.bench_function(BenchmarkId::from_parameter(format!("{n_cameras}x{n_points}")), |bencher| {
            bencher.iter_batched_ref(
                fresh,
                |bundle| bundle.problem.solve(&options, || false),
                BatchSize::LargeInput,
            );
        });
    }
}

fn single_pose(criterion: &mut Criterion) {
    let world = World::new(WorldSize { n_cameras: 2, n_points: 500, n_observations: 1_000 }, 1.0, 3);
    let seen = world.observations.iter().filter(|(camera, ..)| *camera == 1);
    let factors: Vec<_> = seen
        .map(|&(_, point, pixel)| HoldSecond {
            factor: PointReprojection { pixel, sigma_px: 1.0 },
            second: world.points[point],
        })
        .collect();
    let start = jolted(&world.poses[1], 0.02, 0.05, &mut rng(4));
    criterion.bench_function("single_pose_500", |bencher| {
        bencher.iter_batched_ref(
            || UnaryGroup::new(Kernel::huber_95(2), 5.991, factors.clone()),
            |group| optimize_single(&start, &mut [group], &SingleOptions::default()).n_inliers,
            BatchSize::SmallInput,
        );
    });
}

criterion_group!(benches, bundle_iterations, single_pose);
criterion_main!(benches);
