//! One variable against many unary factors: the pose of a frame against a fixed map, for every frame
//! (motion-only bundle adjustment).
//!
//! The same mathematics as [`crate::Problem`], without a graph: each iteration is one pass over the factors
//! into one small matrix on the stack. Between rounds every observation is judged anew:
//!
//! ```text
//!   round 1  robust kernel   all factors   ┐                  ┌ inliers: ‖r‖² ≤ max_chi2
//!   round 2  robust kernel   inliers       │ Levenberg-       │ outliers: the rest, and those that
//!   round 3  least squares   inliers       │ Marquardt  ──►   │ cannot be evaluated; they may
//!   round 4  least squares   inliers       ┘ value            └ come back in any later round
//! ```
//!
//! The kernel finds the basin while wrong matches are still among the inliers; without it the last rounds are
//! those of plain least squares, whose information matrix is that of the answer.

use nalgebra::{SMatrix, SVector};

use crate::arithmetic::{Arithmetic, vectorized};
use crate::cost::{Cost, INVALID_CHI2};
use crate::factor::{Factor, Residual};
use crate::kernel::Kernel;
use crate::manifold::Manifold;
use crate::solver::{Lambda, StopReason};

/// Unary factors of one type with their kernel and the verdict on each.
///
/// A factor of pose and landmark becomes a unary one by [`crate::HoldSecond`].
#[derive(Clone, Debug)]
pub struct UnaryGroup<F> {
    kernel: Kernel,
    max_chi2: f64,
    factors: Vec<F>,
    inliers: Vec<bool>,
}

impl<F: Factor> UnaryGroup<F> {
    /// Factors under `kernel`, all inliers at first; between rounds those with `‖r‖² ≤ max_chi2` are.
    #[must_use]
    pub fn new(kernel: Kernel, max_chi2: f64, factors: Vec<F>) -> Self {
        Self { kernel, max_chi2, inliers: vec![true; factors.len()], factors }
    }

    /// The factors, in the order given.
    #[must_use]
    pub fn factors(&self) -> &[F] {
        &self.factors
    }

    /// The verdict on each factor.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        &self.inliers
    }

    /// Presets the verdict on a factor, which then holds for the first round.
    pub fn set_inlier(&mut self, index: usize, inlier: bool) {
        self.inliers[index] = inlier;
    }

    /// Number of factors judged inliers.
    #[must_use]
    pub fn n_inliers(&self) -> usize {
        self.inliers.iter().filter(|inlier| **inlier).count()
    }
}

/// The normal equations `H δ = −g` of one variable, and the cost at the value they were built at.
#[derive(Clone, Copy)]
pub(crate) struct SmallSystem<const N: usize> {
    /// Only the lower triangle is filled: it is all that Cholesky reads.
    hessian: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: Cost,
}

impl<const N: usize> SmallSystem<N> {
    fn zero() -> Self {
        Self { hessian: SMatrix::zeros(), gradient: SVector::zeros(), cost: Cost::default() }
    }

    fn is_finite(&self) -> bool {
        self.cost.robust.is_finite()
            && self.gradient.iter().all(|entry| entry.is_finite())
            && self.hessian.iter().all(|entry| entry.is_finite())
    }

    /// Adds `w Jᵀ r` and `w Jᵀ J`.
    #[inline(always)]
    fn add_factor<M: Arithmetic, const R: usize>(
        &mut self,
        residual: &SVector<f64, R>,
        jacobian: &SMatrix<f64, R, N>,
        weight: f64,
    ) {
        let weighted = jacobian * weight;
        for column in 0..N {
            for row in 0..R {
                self.gradient[column] =
                    M::multiply_add(weighted[(row, column)], residual[row], self.gradient[column]);
            }
            for other in column..N {
                for row in 0..R {
                    let entry = &mut self.hessian[(other, column)];
                    *entry = M::multiply_add(weighted[(row, other)], jacobian[(row, column)], *entry);
                }
            }
        }
    }

    /// The damped step and the decrease it promises; `None` when the damped matrix is not positive definite.
    fn step(&self, lambda: f64, min_diagonal: f64) -> Option<(SVector<f64, N>, f64)> {
        // (H + λ D) δ = −g, with Marquardt's D: the diagonal of H, kept off zero.
        let mut damped = self.hessian;
        let damping = SVector::<f64, N>::from_fn(|i, _| lambda * self.hessian[(i, i)].max(min_diagonal));
        for i in 0..N {
            damped[(i, i)] += damping[i];
        }
        let step = -damped.cholesky()?.solve(&self.gradient);
        // The quadratic model falls by −gᵀδ − ½ δᵀHδ; with Hδ = −g − λDδ that is ½ δᵀ(λDδ − g).
        let predicted = 0.5 * step.dot(&(damping.component_mul(&step) - self.gradient));
        (step.iter().all(|entry| entry.is_finite()) && predicted.is_finite()).then_some((step, predicted))
    }
}

/// What a group gives to the normal equations; nobody outside the crate can name it.
#[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
pub trait Accumulate<T, const N: usize> {
    /// Adds the inliers at `value`, under the group's kernel or, if not `robust`, under none.
    fn accumulate(&self, value: &T, robust: bool, system: &mut SmallSystem<N>);
}

/// A group of unary factors of `T`, whatever the factor's type; implemented by [`UnaryGroup`].
pub trait UnaryTerms<T, const N: usize>: Accumulate<T, N> {
    /// Judges every factor at `value`; returns the number of inliers, and whether any is judged otherwise
    /// than before.
    fn classify(&mut self, value: &T) -> (usize, bool);
}

#[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
impl<F, T, const R: usize, const N: usize> Accumulate<T, N> for UnaryGroup<F>
where
    F: Factor<Residual = SVector<f64, R>, Variables = (T,)>,
    T: Manifold<Tangent = SVector<f64, N>>,
{
    fn accumulate(&self, value: &T, robust: bool, system: &mut SmallSystem<N>) {
        let sum = vectorized!(M => self.sum::<M, T, R, N>(value, robust));
        system.hessian += sum.hessian;
        system.gradient += sum.gradient;
        system.cost.add(sum.cost);
    }
}

impl<F: Factor> UnaryGroup<F> {
    /// See [`Accumulate::accumulate`].
    #[inline(always)]
    fn sum<M: Arithmetic, T, const R: usize, const N: usize>(&self, value: &T, robust: bool) -> SmallSystem<N>
    where
        F: Factor<Residual = SVector<f64, R>, Variables = (T,)>,
        T: Manifold<Tangent = SVector<f64, N>>,
    {
        let kernel = if robust { self.kernel } else { Kernel::None };
        let mut sum = SmallSystem::<N>::zero();
        let mut n_valid = 0;
        for (factor, _) in self.factors.iter().zip(&self.inliers).filter(|(_, inlier)| **inlier) {
            let Some((residual, (jacobian,))) = factor.linearize((value,)) else {
                sum.cost.n_invalid += 1;
                continue;
            };
            let chi2 = residual.squared_norm();
            sum.add_factor::<M, R>(&residual, &jacobian, kernel.weight(chi2));
            sum.cost.chi2 += chi2;
            sum.cost.robust += 0.5 * kernel.loss(chi2);
            n_valid += 1;
        }
        sum.cost.n_residuals = n_valid * R;
        // At a constant cost, so that no step gains by pushing observations out of their domain.
        sum.cost.robust += 0.5 * sum.cost.n_invalid as f64 * kernel.loss(INVALID_CHI2);
        sum
    }
}

impl<F, T, const R: usize, const N: usize> UnaryTerms<T, N> for UnaryGroup<F>
where
    F: Factor<Residual = SVector<f64, R>, Variables = (T,)>,
    T: Manifold<Tangent = SVector<f64, N>>,
{
    fn classify(&mut self, value: &T) -> (usize, bool) {
        let mut changed = false;
        for (factor, inlier) in self.factors.iter().zip(&mut self.inliers) {
            let residual = factor.residual((value,));
            let now = residual.is_some_and(|residual| residual.squared_norm() <= self.max_chi2);
            changed |= now != *inlier;
            *inlier = now;
        }
        (self.n_inliers(), changed)
    }
}

/// How [`optimize_single`] iterates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingleOptions {
    /// Rounds of solving and judging, at most. Default 4, as is customary for tracking.
    pub n_rounds: usize,
    /// The first so many rounds use the groups' kernels, the rest plain least squares. Default 2.
    pub n_robust_rounds: usize,
    /// Most iterations per round. Default 10.
    pub max_iterations: usize,
    /// Stop a round when a step lowers the cost by less than this share. Default 1e-6.
    pub min_relative_decrease: f64,
    /// Stop when there are fewer inliers than this after a round. Default 3, the least that fix a pose.
    pub min_inliers: usize,
    /// Damping at the start of a round, relative to the diagonal of the Hessian. Default 1e-4.
    pub initial_lambda: f64,
    /// Diagonal entries below this are damped as if they were this large. Default 1e-6.
    pub min_diagonal: f64,
}

impl Default for SingleOptions {
    fn default() -> Self {
        Self {
            n_rounds: 4,
            n_robust_rounds: 2,
            max_iterations: 10,
            min_relative_decrease: 1e-6,
            min_inliers: 3,
            initial_lambda: 1e-4,
            min_diagonal: 1e-6,
        }
    }
}

/// What [`optimize_single`] came to.
#[derive(Clone, Copy, Debug)]
pub struct SingleReport<T, const N: usize> {
    /// The best value found.
    pub value: T,
    /// Inliers at that value, over all groups.
    pub n_inliers: usize,
    /// Cost of the factors that took part in the last round.
    pub cost: Cost,
    /// `Σ w Jᵀ J` of the last round at its end, the inverse of the covariance of `value` in its tangent
    /// space.
    pub information: SMatrix<f64, N, N>,
    /// Linear systems solved, over all rounds.
    pub n_iterations: usize,
    /// How the last round ended.
    pub stop: StopReason,
}

/// Optimizes one variable over groups of unary factors, judging outliers between rounds.
///
/// ```
/// use nalgebra::{Matrix1, Vector1};
/// use optim::{Factor, Kernel, Linearized, SingleOptions, UnaryGroup, optimize_single};
///
/// struct Reading(f64);
/// impl Factor for Reading {
///     type Residual = Vector1<f64>;
///     type Variables = (Vector1<f64>,);
///     fn residual(&self, (x,): (&Vector1<f64>,)) -> Option<Vector1<f64>> {
///         Some(x - Vector1::new(self.0))
///     }
///     fn linearize(&self, (x,): (&Vector1<f64>,)) -> Option<Linearized<Self>> {
///         Some((self.residual((x,))?, (Matrix1::identity(),)))
///     }
/// }
///
/// let readings = [0.9, 1.0, 1.1, 50.0].map(Reading).into();
/// let mut group = UnaryGroup::new(Kernel::huber_95(1), 3.841, readings);
/// let report = optimize_single(&Vector1::new(0.0), &mut [&mut group], &SingleOptions::default());
/// assert!((report.value.x - 1.0).abs() < 1e-3);
/// assert_eq!(group.inliers(), [true, true, true, false]);
/// ```
pub fn optimize_single<T, const N: usize>(
    initial: &T,
    groups: &mut [&mut dyn UnaryTerms<T, N>],
    options: &SingleOptions,
) -> SingleReport<T, N>
where
    T: Manifold<Tangent = SVector<f64, N>>,
{
    let mut report = SingleReport {
        value: initial.clone(),
        n_inliers: 0,
        cost: Cost::default(),
        information: SMatrix::zeros(),
        n_iterations: 0,
        stop: StopReason::NothingToSolve,
    };
    for round in 0..options.n_rounds {
        let robust = round < options.n_robust_rounds;
        report.stop = run_round(groups, robust, options, &mut report);
        let mut changed = false;
        report.n_inliers = 0;
        for group in groups.iter_mut() {
            let (n_inliers, group_changed) = group.classify(&report.value);
            report.n_inliers += n_inliers;
            changed |= group_changed;
        }
        // A further round would begin where this one ended, with the same factors under the same kernels.
        let settled = !robust && !changed;
        let hopeless = matches!(report.stop, StopReason::NonFinite | StopReason::NothingToSolve);
        if hopeless || settled || report.n_inliers < options.min_inliers {
            break;
        }
    }
    report
}

/// Levenberg-Marquardt with the present inliers.
fn run_round<T, const N: usize>(
    groups: &[&mut dyn UnaryTerms<T, N>],
    robust: bool,
    options: &SingleOptions,
    report: &mut SingleReport<T, N>,
) -> StopReason
where
    T: Manifold<Tangent = SVector<f64, N>>,
{
    let system_at = |value: &T| {
        let mut system = SmallSystem::zero();
        groups.iter().for_each(|group| group.accumulate(value, robust, &mut system));
        system
    };
    let mut system = system_at(&report.value);
    if !system.is_finite() {
        return StopReason::NonFinite;
    }
    if system.cost.n_residuals == 0 {
        return StopReason::NothingToSolve;
    }
    let stop = descend(system_at, &mut system, options, report);
    report.cost = system.cost;
    report.information = system.hessian;
    report.information.fill_upper_triangle_with_lower_triangle();
    stop
}

/// Takes steps from `report.value`, at which `system` is, for as long as they pay; leaves both at the best
/// value.
fn descend<T, const N: usize>(
    system_at: impl Fn(&T) -> SmallSystem<N>,
    system: &mut SmallSystem<N>,
    options: &SingleOptions,
    report: &mut SingleReport<T, N>,
) -> StopReason
where
    T: Manifold<Tangent = SVector<f64, N>>,
{
    let mut lambda = Lambda::new(options.initial_lambda);
    for _ in 0..options.max_iterations {
        report.n_iterations += 1;
        let Some((step, predicted)) = system.step(lambda.value, options.min_diagonal) else {
            // More damping makes any matrix positive definite.
            lambda.reject();
            continue;
        };
        let negligible = options.min_relative_decrease * system.cost.robust;
        if predicted <= negligible {
            return StopReason::CostConverged;
        }
        let value = report.value.retract(&step);
        // Derivatives at once with the cost, in one pass: nearly every step is accepted and then needs them.
        let trial = system_at(&value);
        let decrease = system.cost.robust - trial.cost.robust;
        if decrease > 0.0 && trial.is_finite() {
            report.value = value;
            *system = trial;
            lambda.accept(decrease / predicted);
            if decrease < negligible {
                return StopReason::CostConverged;
            }
        } else {
            lambda.reject();
        }
    }
    StopReason::IterationLimit
}
