//! Bundle adjustment of the two views a map begins with.

use super::factors::{BaselineLengthFactor, PointReprojectionFactor};
use geometry::nalgebra::{DMatrix, Matrix3, Matrix6, Vector3};
use geometry::{Pose, so3};
use optim::{Kernel, Problem, SolverOptions, chi2_95};

/// Iterations; two views converge quickly.
const MAX_ITERATIONS: usize = 20;
/// Standard deviation of the baseline's length as a share of it: tight enough to settle the free scale.
const BASELINE_SIGMA: f64 = 1e-3;

/// The refined motion, and how well the matches determine it.
#[derive(Clone, Debug)]
pub(crate) struct RefinedPair {
    pub second_from_first: Pose,
    /// Per point its refined position in the first camera's frame, if both views agree with it.
    pub points: Vec<Option<Vector3<f64>>>,
    /// Standard deviation of the direction of the baseline, degrees; infinite if undetermined.
    pub direction_sigma_deg: f64,
}

/// Refines the second pose and the points, with the first camera at the origin and the baseline's length
/// kept.
pub(crate) fn refine(
    second_from_first: Pose,
    points: &[(Vector3<f64>, [PointReprojectionFactor; 2])],
) -> RefinedPair {
    let mut problem = Problem::new();
    let first = problem.add_variable(Pose::identity());
    let second = problem.add_variable(second_from_first);
    problem.set_fixed(first, true);
    let variables: Vec<_> = points.iter().map(|(position, _)| problem.add_landmark(*position)).collect();
    let factors = points.iter().zip(&variables).flat_map(|((_, [in_first, in_second]), point)| {
        [((first, *point), *in_first), ((second, *point), *in_second)]
    });
    let group = problem.add_factors(Kernel::huber_95(2), factors.collect::<Vec<_>>());
    let length = second_from_first.translation.norm();
    let baseline = BaselineLengthFactor { length, inverse_sigma: 1.0 / (BASELINE_SIGMA * length) };
    problem.add_factors(Kernel::None, [((second,), baseline)]);
    let options = SolverOptions { max_iterations: MAX_ITERATIONS, ..SolverOptions::default() };
    problem.solve(&options, || false);
    // Wrong matches would inflate the noise that is measured next.
    problem.enable_inliers(group, chi2_95(2));
    let report = problem.solve(&options, || false);

    let agrees = |factor_idx| problem.chi2(group, factor_idx).is_some_and(|chi2| chi2 <= chi2_95(2));
    let refined = variables
        .iter()
        .enumerate()
        .map(|(idx, variable)| (agrees(2 * idx) && agrees(2 * idx + 1)).then(|| *problem.value(*variable)))
        .collect();
    let second_from_first = *problem.value(second);
    // The covariance is that of the assumed noise; what the residuals show is the image's own.
    let noise = report.chi2_per_dof().unwrap_or(1.0).sqrt();
    let direction_sigma_deg = problem
        .marginal_covariance(second)
        .map_or(f64::INFINITY, |covariance| noise * direction_sigma_deg(&second_from_first, &covariance));
    RefinedPair { second_from_first, points: refined, direction_sigma_deg }
}

/// The largest standard deviation of the baseline's direction, from the covariance of the pose.
fn direction_sigma_deg(pose: &Pose, covariance: &DMatrix<f64>) -> f64 {
    let covariance = Matrix6::from_fn(|row, column| covariance[(row, column)]);
    // t' = t + rotation x t + translation, to first order.
    let mut d_t_d_pose = geometry::nalgebra::Matrix3x6::zeros();
    d_t_d_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&-so3::skew(&pose.translation));
    d_t_d_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    let length = pose.translation.norm();
    let direction = pose.translation / length;
    let across = Matrix3::identity() - direction * direction.transpose();
    let spread = across * (d_t_d_pose * covariance * d_t_d_pose.transpose()) * across;
    (spread.symmetric_eigenvalues().max().max(0.0).sqrt() / length).to_degrees()
}
