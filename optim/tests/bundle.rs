//! Bundle adjustment of synthetic worlds.

mod common;

use std::cell::Cell;

use common::*;
use geometry::{Direction, Pose};
use nalgebra::{DMatrix, DVector, SMatrix, Vector2, Vector3};
use optim::{
    INVALID_CHI2, Kernel, LinearSolver, Problem, SolveReport, SolverOptions, StopReason, VariableId,
};

const SIZE: WorldSize = WorldSize { n_cameras: 8, n_points: 150, n_observations: 700 };

fn never() -> bool {
    false
}

fn thorough() -> SolverOptions {
    SolverOptions { max_iterations: 60, min_relative_decrease: 1e-14, min_step: 1e-12, ..Default::default() }
}

/// Largest distance between camera centers of a solution and of the truth.
fn worst_center(bundle: &Bundle, truth: &World) -> f64 {
    let distances = bundle
        .poses
        .iter()
        .zip(&truth.poses)
        .map(|(id, pose)| (bundle.problem.value(*id).center() - pose.center()).norm());
    distances.fold(0.0, f64::max)
}

#[test]
fn exact_observations_give_back_the_world() {
    let world = World::new(SIZE, 0.0, 1);
    let mut bundle = Bundle::new(&world.disturbed(0.01, 0.05, 0.1, 2), Kernel::None);
    let report = bundle.problem.solve(&thorough(), never);
    assert!(report.last.robust < 1e-12, "{report:?}");
    assert!(worst_center(&bundle, &world) < 1e-7, "{}", worst_center(&bundle, &world));
}

#[test]
fn noisy_observations_give_a_chi2_of_one_per_degree_of_freedom() {
    let world = World::new(WorldSize { n_cameras: 10, n_points: 400, n_observations: 2_400 }, 1.0, 3);
    let mut bundle = Bundle::new(&world.disturbed(0.01, 0.05, 0.1, 4), Kernel::None);
    let report = bundle.problem.solve(&SolverOptions::default(), never);
    let chi2_per_dof = report.chi2_per_dof().expect("more residuals than unknowns");
    assert!((chi2_per_dof - 1.0).abs() < 0.1, "{chi2_per_dof}, {report:?}");
    assert!(report.stop.is_converged(), "{report:?}");
}

#[test]
fn the_step_is_that_of_the_whole_system_solved_densely() {
    let world = World::new(WorldSize { n_cameras: 4, n_points: 20, n_observations: 70 }, 1.0, 5)
        .disturbed(0.01, 0.05, 0.1, 6);
    let mut bundle = Bundle::new(&world, Kernel::huber_95(2));
    // Ties of two poses and a point, so that the reduced system has blocks of its own.
    let ties = (2..20).map(|i| {
        let ids = (bundle.points[i], bundle.poses[i % 4], bundle.poses[(i + 1) % 4]);
        (ids, PointOffset { offset: Vector3::new(0.3, 0.0, 0.1), sigma: 0.1 })
    });
    bundle.problem.add_factors(Kernel::None, ties.collect::<Vec<_>>());
    let lambda = 1e-3;
    let (mut hessian, gradient) = bundle.problem.dense_normal_equations();
    for i in 0..hessian.nrows() {
        hessian[(i, i)] += lambda * hessian[(i, i)].max(1e-6);
    }
    let expected: DVector<f64> = -hessian.lu().solve(&gradient).expect("the damped system is regular");
    for linear_solver in [LinearSolver::Dense, LinearSolver::Sparse] {
        let values: Vec<Pose> = bundle.poses.iter().map(|id| *bundle.problem.value(*id)).collect();
        let points: Vec<Vector3<f64>> = bundle.points.iter().map(|id| *bundle.problem.value(*id)).collect();
        let options =
            SolverOptions { max_iterations: 1, initial_lambda: lambda, linear_solver, ..Default::default() };
        let report = bundle.problem.solve(&options, never);
        assert_eq!(report.n_accepted, 1, "{report:?}");
        let poses = bundle.poses.iter().zip(&values).skip(2);
        let mut got: Vec<f64> = poses
            .flat_map(|(id, before)| {
                before.local(bundle.problem.value(*id)).iter().copied().collect::<Vec<_>>()
            })
            .collect();
        for (id, before) in bundle.points.iter().zip(&points) {
            got.extend((bundle.problem.value(*id) - before).iter());
        }
        let error = (DVector::from_vec(got) - &expected).amax();
        assert!(error < 1e-9 * expected.amax(), "{linear_solver:?}: {error}");
        bundle.poses.iter().zip(&values).for_each(|(id, value)| bundle.problem.set_value(*id, *value));
        bundle.points.iter().zip(&points).for_each(|(id, value)| bundle.problem.set_value(*id, *value));
    }
}

#[test]
fn dense_and_sparse_agree() {
    let world = World::new(WorldSize { n_cameras: 30, n_points: 300, n_observations: 1_500 }, 1.0, 7)
        .disturbed(0.01, 0.05, 0.1, 8);
    let solved = [LinearSolver::Dense, LinearSolver::Sparse].map(|linear_solver| {
        let mut bundle = Bundle::new(&world, Kernel::huber_95(2));
        bundle.problem.solve(&SolverOptions { linear_solver, ..thorough() }, never);
        bundle
    });
    let [dense, sparse] = &solved;
    for (a, b) in dense.poses.iter().zip(&sparse.poses) {
        let difference = dense.problem.value(*a).local(sparse.problem.value(*b));
        assert!(difference.norm() < 1e-6, "{difference}");
    }
}

/// Points, lines and two directions seen by some cameras, nothing fixed; with the true angle between the two.
fn mixed_problem() -> (Problem, [VariableId<Direction>; 2], f64) {
    let mut rng = rng(9);
    let world = World::new(WorldSize { n_cameras: 5, n_points: 40, n_observations: 180 }, 1.0, 10);
    let mut bundle = Bundle::new(&world, Kernel::None);
    bundle.poses.iter().for_each(|id| bundle.problem.set_fixed(*id, false));
    let problem = &mut bundle.problem;
    let along = [Vector3::new(1.0, 0.1, 0.2), Vector3::new(0.1, -1.0, 0.3)];
    let directions = along.map(|d| problem.add_variable(Direction::new(d).expect("not zero")));
    let (mut seen, mut pointed, mut parallel) = (Vec::new(), Vec::new(), Vec::new());
    for line_idx in 0..10 {
        let start = normal3(&mut rng) * 0.5 + Vector3::new(0.6, 0.0, 5.0);
        let ends = [start, start + along[line_idx % 2]];
        let line = problem.add_landmark(line_through(ends));
        for (id, pose) in bundle.poses.iter().zip(&world.poses) {
            let endpoints = observe_segment(pose, ends, 1.0, &mut rng);
            let normal = endpoints[0].cross(&endpoints[1]).normalize();
            seen.push(((*id, line), LineReprojection { endpoints, sigma_px: 1.0 }));
            pointed.push(((*id, directions[line_idx % 2]), SegmentDirection { normal, sigma_rad: 0.01 }));
        }
        parallel.push(((line, directions[line_idx % 2]), LineDirection { sigma_rad: 0.02 }));
    }
    problem.add_factors(Kernel::huber_95(2), seen);
    problem.add_factors(Kernel::cauchy_95(), pointed);
    problem.add_factors(Kernel::cauchy_95(), parallel);
    let angle = along[0].angle(&along[1]);
    (bundle.problem, directions, angle.min(std::f64::consts::PI - angle))
}

#[test]
fn monocular_gauge_freedom_is_seven() {
    let (mut problem, ..) = mixed_problem();
    let (hessian, _) = problem.dense_normal_equations();
    let scale = hessian.diagonal().map(|entry| 1.0 / entry.sqrt());
    let scaled =
        DMatrix::from_fn(hessian.nrows(), hessian.ncols(), |i, j| hessian[(i, j)] * scale[i] * scale[j]);
    let mut eigenvalues: Vec<f64> = scaled.symmetric_eigenvalues().iter().copied().collect();
    eigenvalues.sort_by(f64::total_cmp);
    assert!(eigenvalues[6] < 1e-12, "{:?}", &eigenvalues[..9]);
    assert!(eigenvalues[7] > 1e-8, "{:?}", &eigenvalues[..9]);
}

#[test]
fn points_lines_and_directions_are_solved_together() {
    let (mut problem, [a, b], true_angle) = mixed_problem();
    let report = problem.solve(&SolverOptions { max_iterations: 50, ..Default::default() }, never);
    assert!(report.stop.is_converged() && report.last.robust < 0.8 * report.initial.robust, "{report:?}");
    let angle = problem.value(a).angle(problem.value(b));
    assert!((angle - true_angle).abs() < 0.03, "{angle} instead of {true_angle}");
}

#[test]
fn a_world_ten_times_as_large_has_the_same_residuals() {
    let start = World::new(SIZE, 1.0, 11).disturbed(0.01, 0.05, 0.1, 12);
    let chi2 = [start.clone(), start.scaled(10.0)].map(|world| {
        let mut bundle = Bundle::new(&world, Kernel::huber_95(2));
        let report = bundle.problem.solve(&thorough(), never);
        assert!(report.stop.is_converged(), "{report:?}");
        (0..world.observations.len()).map(|i| bundle.problem.chi2(bundle.group, i)).collect::<Vec<_>>()
    });
    for (small, large) in chi2[0].iter().zip(&chi2[1]) {
        let (small, large) = (small.expect("in view"), large.expect("in view"));
        assert!((small - large).abs() < 1e-5 * (1.0 + small), "{small} and {large}");
        assert_eq!(small > 5.991, large > 5.991);
    }
}

/// A world in which every tenth observation is off by 30 to 80 pixels.
fn with_outliers(seed: u64) -> (World, World, Vec<bool>) {
    let truth = World::new(SIZE, 1.0, seed);
    let mut start = truth.disturbed(0.005, 0.02, 0.05, seed + 1);
    let outlier: Vec<bool> = (0..start.observations.len()).map(|i| i % 10 == 3).collect();
    for (i, (.., pixel)) in start.observations.iter_mut().enumerate().filter(|(i, _)| outlier[*i]) {
        let angle = i as f64;
        *pixel += Vector2::new(angle.cos(), angle.sin()) * (30.0 + (i % 50) as f64);
    }
    (truth, start, outlier)
}

#[test]
fn kernels_resist_a_tenth_of_outliers() {
    let (truth, start, _) = with_outliers(13);
    let error = |kernel| {
        let mut bundle = Bundle::new(&start, kernel);
        bundle.problem.solve(&SolverOptions { max_iterations: 60, ..Default::default() }, never);
        worst_center(&bundle, &truth)
    };
    let (plain, huber, cauchy) =
        (error(Kernel::None), error(Kernel::huber_95(2)), error(Kernel::cauchy_95()));
    assert!(huber < 0.3 * plain, "Huber {huber}, plain {plain}");
    assert!(cauchy < 0.2 * plain, "Cauchy {cauchy}, plain {plain}");
}

#[test]
fn dropping_outliers_between_rounds_leaves_the_clean_problem() {
    let (_, start, outlier) = with_outliers(14);
    let mut bundle = Bundle::new(&start, Kernel::cauchy_95());
    bundle.problem.solve(&SolverOptions { max_iterations: 30, ..Default::default() }, never);
    let n_kept = bundle.problem.enable_inliers(bundle.group, 25.0);
    assert_eq!(n_kept, outlier.iter().filter(|out| !**out).count());
    bundle.problem.set_kernel(bundle.group, Kernel::None);
    let report = bundle.problem.solve(&thorough(), never);
    assert_eq!(report.last.n_residuals, 2 * n_kept);
    assert!((report.chi2_per_dof().expect("overdetermined") - 1.0).abs() < 0.15, "{report:?}");
    let mut clean = Bundle::new(&start, Kernel::None);
    for (i, out) in outlier.iter().enumerate() {
        assert_eq!(bundle.problem.is_enabled(bundle.group, i), !out, "observation {i}");
        clean.problem.set_enabled(clean.group, i, !out);
    }
    clean.problem.solve(&thorough(), never);
    for (a, b) in bundle.poses.iter().zip(&clean.poses) {
        assert!(bundle.problem.value(*a).local(clean.problem.value(*b)).norm() < 1e-6);
    }
}

#[test]
fn disabled_factors_have_no_influence() {
    let (_, start, outlier) = with_outliers(15);
    let mut without = start.clone();
    let mut keep = outlier.iter().map(|out| !out);
    without.observations.retain(|_| keep.next().unwrap_or(true));
    let mut disabled = Bundle::new(&start, Kernel::huber_95(2));
    for (i, _) in outlier.iter().enumerate().filter(|(_, out)| **out) {
        disabled.problem.set_enabled(disabled.group, i, false);
    }
    let mut absent = Bundle::new(&without, Kernel::huber_95(2));
    let reports = [&mut disabled, &mut absent].map(|bundle| bundle.problem.solve(&thorough(), never));
    assert_eq!(reports[0].initial, reports[1].initial);
    for (a, b) in disabled.poses.iter().zip(&absent.poses) {
        assert!(disabled.problem.value(*a).local(absent.problem.value(*b)).norm() < 1e-7);
    }
}

#[test]
fn fixed_variables_do_not_move() {
    let start = World::new(SIZE, 1.0, 16).disturbed(0.01, 0.05, 0.1, 17);
    let mut bundle = Bundle::new(&start, Kernel::huber_95(2));
    bundle.problem.set_fixed(bundle.poses[5], true);
    bundle.problem.set_fixed(bundle.points[11], true);
    let report = bundle.problem.solve(&SolverOptions::default(), never);
    assert!(report.n_accepted > 0);
    for i in [0, 1, 5] {
        assert_eq!(*bundle.problem.value(bundle.poses[i]), start.poses[i]);
    }
    assert_eq!(*bundle.problem.value(bundle.points[11]), start.points[11]);
    assert_ne!(*bundle.problem.value(bundle.poses[4]), start.poses[4]);
    bundle.problem.set_fixed(bundle.poses[5], false);
    bundle.problem.solve(&SolverOptions::default(), never);
    assert_ne!(*bundle.problem.value(bundle.poses[5]), start.poses[5]);
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let start = World::new(SIZE, 1.0, 18).disturbed(0.01, 0.05, 0.1, 19);
    let runs = [(); 2].map(|()| {
        let mut bundle = Bundle::new(&start, Kernel::cauchy_95());
        let report = bundle.problem.solve(&SolverOptions::default(), never);
        (bundle.bits(), report)
    });
    assert_eq!(runs[0], runs[1]);
}

#[test]
fn aborting_keeps_the_last_accepted_values() {
    let start = World::new(SIZE, 1.0, 20).disturbed(0.01, 0.05, 0.1, 21);
    let mut stopped = Bundle::new(&start, Kernel::huber_95(2));
    let asked = Cell::new(0);
    let report = stopped.problem.solve(&SolverOptions::default(), || {
        asked.set(asked.get() + 1);
        asked.get() > 2
    });
    assert_eq!((report.stop, report.n_iterations), (StopReason::Aborted, 2));
    let mut limited = Bundle::new(&start, Kernel::huber_95(2));
    let report = limited.problem.solve(&SolverOptions { max_iterations: 2, ..Default::default() }, never);
    assert_eq!(report.stop, StopReason::IterationLimit);
    assert_eq!(stopped.bits(), limited.bits());
    assert_eq!(stopped.problem.cost(), report.last);
}

#[test]
fn a_point_behind_a_camera_counts_as_an_outlier_and_pulls_at_nothing() {
    let mut start = World::new(SIZE, 1.0, 22);
    start.points[3].z = -5.0;
    let n_invalid = start.observations.iter().filter(|(_, point, _)| *point == 3).count();
    let mut bundle = Bundle::new(&start, Kernel::None);
    let cost = bundle.problem.cost();
    assert_eq!(cost.n_invalid, n_invalid);
    assert!((cost.robust - 0.5 * (cost.chi2 + n_invalid as f64 * INVALID_CHI2)).abs() < 1e-6 * cost.robust);
    let report = bundle.problem.solve(&SolverOptions::default(), never);
    assert!(report.last.robust.is_finite() && report.last.robust < report.initial.robust, "{report:?}");
    assert_eq!(report.last.n_invalid, n_invalid);
    assert_eq!(*bundle.problem.value(bundle.points[3]), start.points[3]);
}

#[test]
fn a_number_that_is_not_finite_stops_before_anything_moves() {
    let mut start = World::new(SIZE, 1.0, 23).disturbed(0.01, 0.05, 0.1, 24);
    start.observations[17].2.x = f64::NAN;
    let mut bundle = Bundle::new(&start, Kernel::huber_95(2));
    let before = bundle.bits();
    let report = bundle.problem.solve(&SolverOptions::default(), never);
    assert_eq!((report.stop, report.n_iterations), (StopReason::NonFinite, 0));
    assert_eq!(bundle.bits(), before);
    bundle.problem.set_enabled(bundle.group, 17, false);
    assert!(bundle.problem.solve(&SolverOptions::default(), never).stop.is_converged());
}

/// Solves a problem in which one landmark has but one observation.
fn with_a_lonely_point(initial_lambda: f64) -> (SolveReport, Vector3<f64>) {
    let mut world = World::new(SIZE, 1.0, 25).disturbed(0.01, 0.05, 0.1, 26);
    world.points.push(Vector3::new(0.2, 0.1, 5.0));
    world.observations.push((3, world.points.len() - 1, Vector2::new(-40.0, 5.0)));
    let mut bundle = Bundle::new(&world, Kernel::None);
    let report = bundle.problem.solve(&SolverOptions { initial_lambda, ..Default::default() }, never);
    (report, *bundle.problem.value(*bundle.points.last().expect("just added")))
}

#[test]
fn an_undetermined_landmark_is_damped_or_held() {
    let (damped, point) = with_a_lonely_point(1e-4);
    assert!(damped.stop.is_converged() && point.iter().all(|x| x.is_finite()), "{damped:?}");
    let (held, point) = with_a_lonely_point(1e-14);
    assert_eq!(held.n_held, 1, "{held:?}");
    assert!(held.stop.is_converged() && point.iter().all(|x| x.is_finite()), "{held:?}");
}

#[test]
fn variables_without_factors_stay() {
    let mut problem = Problem::new();
    let pose = problem.add_variable(Pose::identity());
    let lonely: VariableId<Pose> = problem.add_variable(Pose::identity());
    let point = problem.add_landmark(Vector3::new(0.1, 0.2, 4.0));
    let unseen = problem.add_landmark(Vector3::new(0.3, 0.4, 5.0));
    let factor = PointReprojection { pixel: Vector2::new(1.0, 2.0), sigma_px: 1.0 };
    problem.add_factors(Kernel::None, [((pose, point), factor)]);
    let report = problem.solve(&SolverOptions::default(), never);
    assert!(report.last.robust < 1e-6 && report.n_broken == 0, "{report:?}");
    assert_eq!(*problem.value(lonely), Pose::identity());
    assert_eq!(*problem.value(unseen), Vector3::new(0.3, 0.4, 5.0));
}

#[test]
fn an_empty_problem_says_so() {
    let mut problem = Problem::new();
    assert_eq!(problem.solve(&SolverOptions::default(), never).stop, StopReason::NothingToSolve);
    let pose = problem.add_variable(Pose::identity());
    assert_eq!(problem.solve(&SolverOptions::default(), never).stop, StopReason::NothingToSolve);
    assert!(problem.marginal_covariance(pose).is_none());
}

#[test]
fn the_marginal_covariance_is_a_block_of_the_inverse() {
    let world = World::new(WorldSize { n_cameras: 5, n_points: 40, n_observations: 180 }, 1.0, 27);
    let mut bundle = Bundle::new(&world, Kernel::None);
    let (hessian, _) = bundle.problem.dense_normal_equations();
    let inverse = hessian.try_inverse().expect("two fixed poses leave no gauge");
    let got = bundle.problem.marginal_covariance(bundle.poses[3]).expect("a free pose");
    // Poses 0 and 1 are fixed, so pose 3 is the second free one.
    let expected: SMatrix<f64, 6, 6> = inverse.fixed_view::<6, 6>(6, 6).into_owned();
    assert!((&got - expected).amax() < 1e-8 * expected.amax(), "{got} instead of {expected}");
    assert!(bundle.problem.marginal_covariance(bundle.poses[0]).is_none());
    assert!(bundle.problem.marginal_covariance(bundle.points[0]).is_none());
}

#[test]
#[should_panic(expected = "more than one landmark")]
fn two_landmarks_in_a_factor_are_refused() {
    let mut problem = Problem::new();
    let direction = problem.add_landmark(Direction::new(Vector3::x()).expect("not zero"));
    let line = problem.add_landmark(line_through([Vector3::x(), Vector3::y()]));
    problem.add_factors(Kernel::None, [((line, direction), LineDirection { sigma_rad: 0.1 })]);
}

#[test]
fn clustered_residuals_tell_a_covariance_of_their_own() {
    let world = World::new(WorldSize { n_cameras: 5, n_points: 120, n_observations: 500 }, 1.0, 31);
    let mut bundle = Bundle::new(&world, Kernel::None);
    bundle.problem.solve(&SolverOptions::default(), never);
    let n = bundle.problem.factors(bundle.group).len();
    let each: Vec<usize> = (0..n).collect();
    let found = bundle.problem.clustered_covariance(bundle.poses[3], bundle.group, &each).unwrap();
    let expected = bundle.problem.marginal_covariance(bundle.poses[3]).unwrap();
    assert!((&found.expected - &expected).amax() < 1e-12 * expected.amax());
    // Independent errors of the size that was stated: both ways agree but for chance and what was fitted.
    let ratio = found.observed.trace() / expected.trace();
    assert!((0.3..1.5).contains(&ratio), "{ratio}");
    // All errors as one cluster: at the minimum they cancel.
    let one = vec![0; n];
    let found = bundle.problem.clustered_covariance(bundle.poses[3], bundle.group, &one).unwrap();
    assert!(found.observed.trace() < 1e-6 * expected.trace(), "{}", found.observed.trace());
    assert!(bundle.problem.clustered_covariance(bundle.poses[0], bundle.group, &each).is_none());
}
