//! The pose of one frame against a fixed map.

mod common;

use common::*;
use geometry::Pose;
use nalgebra::{Vector2, Vector3};
use optim::{
    HoldSecond, Kernel, Problem, SingleOptions, SolverOptions, StopReason, UnaryGroup, optimize_single,
};

type Observation = HoldSecond<PointReprojection, Vector3<f64>>;

/// Observations of a frame with noise of one pixel, every `outlier_every`-th of them off by 40 pixels.
fn frame(n: usize, outlier_every: usize, seed: u64) -> (Pose, Vec<Observation>) {
    let world = World::new(WorldSize { n_cameras: 2, n_points: n, n_observations: 2 * n }, 1.0, seed);
    let seen = world.observations.iter().filter(|(camera, ..)| *camera == 1).enumerate();
    let observations = seen.map(|(i, &(_, point, pixel))| {
        let shift = if i % outlier_every == 0 { Vector2::new(40.0, -25.0) } else { Vector2::zeros() };
        HoldSecond {
            factor: PointReprojection { pixel: pixel + shift, sigma_px: 1.0 },
            second: world.points[point],
        }
    });
    (world.poses[1], observations.collect())
}

#[test]
fn outliers_are_told_apart() {
    let (truth, observations) = frame(300, 4, 1);
    let mut group = UnaryGroup::new(Kernel::huber_95(2), 5.991, observations);
    let start = jolted(&truth, 0.03, 0.1, &mut rng(2));
    let report = optimize_single(&start, &mut [&mut group], &SingleOptions::default());
    assert!(truth.local(&report.value).norm() < 0.01, "{}", truth.local(&report.value));
    for (i, inlier) in group.inliers().iter().enumerate() {
        assert!(!(i % 4 == 0 && *inlier), "observation {i} is an outlier");
    }
    assert_eq!(report.n_inliers, group.n_inliers());
    assert!(report.n_inliers > 225 * 9 / 10, "{} inliers", report.n_inliers);
}

#[test]
fn it_agrees_with_the_graph() {
    let (truth, observations) = frame(80, 1_000, 3);
    let start = jolted(&truth, 0.03, 0.1, &mut rng(4));
    let mut problem = Problem::new();
    let pose = problem.add_variable(start);
    problem.add_factors(Kernel::huber_95(2), observations.iter().map(|factor| ((pose,), factor.clone())));
    problem.solve(&SolverOptions { min_relative_decrease: 1e-14, ..Default::default() }, || false);
    let mut group = UnaryGroup::new(Kernel::huber_95(2), f64::INFINITY, observations);
    let options =
        SingleOptions { n_rounds: 1, min_relative_decrease: 1e-14, max_iterations: 20, ..Default::default() };
    let report = optimize_single(&start, &mut [&mut group], &options);
    assert!(problem.value(pose).local(&report.value).norm() < 1e-7);
    let covariance = problem.marginal_covariance(pose).expect("the pose is determined");
    let product = covariance * report.information;
    assert!((product - nalgebra::DMatrix::identity(6, 6)).amax() < 1e-4);
}

#[test]
fn nothing_to_see_leaves_the_pose() {
    let start = jolted(&Pose::identity(), 0.1, 0.1, &mut rng(5));
    let mut group = UnaryGroup::<Observation>::new(Kernel::None, 5.991, Vec::new());
    let report = optimize_single(&start, &mut [&mut group], &SingleOptions::default());
    assert_eq!((report.stop, report.n_inliers, report.value), (StopReason::NothingToSolve, 0, start));
}

#[test]
fn a_number_that_is_not_finite_leaves_the_pose() {
    let (_, mut observations) = frame(50, 1_000, 6);
    observations[7].factor.pixel.y = f64::NAN;
    let start = Pose::identity();
    let mut group = UnaryGroup::new(Kernel::None, 5.991, observations);
    let report = optimize_single(&start, &mut [&mut group], &SingleOptions::default());
    assert_eq!((report.stop, report.value), (StopReason::NonFinite, start));
}
