//! Bundle adjustment of the two views a map begins with.

use super::factors::PointReprojectionFactor;
use geometry::Pose;
use geometry::nalgebra::Vector3;
use optim::{Kernel, Problem, SolverOptions, chi2_95};

/// Iterations; two views converge quickly.
const MAX_ITERATIONS: usize = 20;

/// Refines the second pose and the points; the first pose stays. Returns, per point, its refined position if both
/// views agree with it. `None` if nothing sensible is left.
pub(crate) fn refine(
    first_from_world: Pose,
    second_from_world: Pose,
    points: &[(Vector3<f64>, [PointReprojectionFactor; 2])],
) -> (Pose, Vec<Option<Vector3<f64>>>) {
    let mut problem = Problem::new();
    let first = problem.add_variable(first_from_world);
    let second = problem.add_variable(second_from_world);
    problem.set_fixed(first, true);
    let variables: Vec<_> = points.iter().map(|(position, _)| problem.add_landmark(*position)).collect();
    let factors = points
        .iter()
        .zip(&variables)
        .flat_map(|((_, [in_first, in_second]), point)| [((first, *point), *in_first), ((second, *point), *in_second)]);
    let group = problem.add_factors(Kernel::huber_95(2), factors.collect::<Vec<_>>());
    // The scale is free: damping keeps it where it is, and the caller chooses the unit afterwards.
    problem.solve(&SolverOptions { max_iterations: MAX_ITERATIONS, ..SolverOptions::default() }, || false);
    let agrees = |factor_idx| problem.chi2(group, factor_idx).is_some_and(|chi2| chi2 <= chi2_95(2));
    let refined = variables
        .iter()
        .enumerate()
        .map(|(idx, variable)| (agrees(2 * idx) && agrees(2 * idx + 1)).then(|| *problem.value(*variable)))
        .collect();
    (*problem.value(second), refined)
}
