//! Processor milliseconds per Levenberg-Marquardt iteration on synthetic bundle adjustments of three sizes,
//! and for the pose of a single frame. Run with `cargo run --release -p optim --example bundle_speed`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::sync::LazyLock;
use std::time::Instant;

use common::{Bundle, PointReprojection, World, WorldSize, jolted, rng};
use optim::{HoldSecond, Kernel, SingleOptions, SolverOptions, UnaryGroup, optimize_single};

/// Processor time of this process so far; falls back on the wall clock where the system does not tell.
fn cpu_ms() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let nanoseconds = std::fs::read_to_string("/proc/self/schedstat").ok();
    let nanoseconds = nanoseconds.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.elapsed().as_secs_f64() * 1e3, |nanoseconds| nanoseconds * 1e-6)
}

fn main() {
    for (n_cameras, n_points, n_observations) in
        [(20, 2_600, 14_000), (16, 18_700, 82_000), (200, 32_000, 156_000)]
    {
        let world = World::new(WorldSize { n_cameras, n_points, n_observations }, 1.0, 1);
        let start = world.disturbed(0.01, 0.05, 0.1, 2);
        // Never converged, so that each run makes the same number of iterations.
        let options = SolverOptions {
            max_iterations: 10,
            min_relative_decrease: 0.0,
            min_step: 0.0,
            ..Default::default()
        };
        let mut best_ms = f64::INFINITY;
        let mut build_ms = f64::INFINITY;
        let mut last = None;
        for _ in 0..5 {
            let before_ms = cpu_ms();
            let mut bundle = Bundle::new(&start, Kernel::huber_95(2));
            bundle.problem.solve(&SolverOptions { max_iterations: 0, ..options }, || false);
            build_ms = build_ms.min(cpu_ms() - before_ms);
            let before_ms = cpu_ms();
            let report = bundle.problem.solve(&options, || false);
            best_ms = best_ms.min((cpu_ms() - before_ms) / report.n_iterations as f64);
            last = Some(report);
        }
        let report = last.expect("at least one run was made");
        println!(
            "{n_cameras:4} cameras {n_points:6} points {:6} observations: {best_ms:7.2} ms per iteration, {build_ms:6.2} ms to \
             build; cost {:.3e} -> {:.3e}, {} accepted of {}, chi2 per dof {:.3}",
            world.observations.len(),
            report.initial.robust,
            report.last.robust,
            report.n_accepted,
            report.n_iterations,
            report.chi2_per_dof().unwrap_or(f64::NAN),
        );
    }
    for n in [100, 500, 1_000] {
        single_pose(n);
    }
}

/// Four rounds of pose optimization with a fifth of the observations wrong; too short for the processor
/// clock, so the best of many by the wall clock.
fn single_pose(n: usize) {
    let world = World::new(WorldSize { n_cameras: 2, n_points: n, n_observations: 2 * n }, 1.0, 3);
    let factors = || {
        let seen = world.observations.iter().filter(|(camera, ..)| *camera == 1).enumerate();
        seen.map(|(i, &(_, point, mut pixel))| {
            if i % 5 == 0 {
                pixel.x += 60.0;
            }
            HoldSecond { factor: PointReprojection { pixel, sigma_px: 1.0 }, second: world.points[point] }
        })
        .collect::<Vec<_>>()
    };
    let start = jolted(&world.poses[1], 0.02, 0.05, &mut rng(4));
    let options = SingleOptions::default();
    let mut best_us = f64::INFINITY;
    let mut last = None;
    for _ in 0..200 {
        let mut group = UnaryGroup::new(Kernel::huber_95(2), 5.991, factors());
        let clock = Instant::now();
        let report = optimize_single(&start, &mut [&mut group], &options);
        best_us = best_us.min(clock.elapsed().as_secs_f64() * 1e6);
        last = Some((report.n_iterations, report.n_inliers));
    }
    let (n_iterations, n_inliers) = last.expect("at least one run was made");
    println!(
        "one pose, {n:5} observations: {best_us:7.1} µs, {n_iterations} iterations, {n_inliers} inliers"
    );
}
