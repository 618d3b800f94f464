//! Levenberg-Marquardt.

use crate::cost::Cost;
use crate::problem::Problem;
use crate::reduced::LinearSolver;
use crate::schur::Damping;
use crate::variables::Side;

/// When and how [`Problem::solve`] iterates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Most iterations, accepted and rejected ones together, so that this bounds the time. Default 20.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the cost by less than this share. Default 1e-6.
    pub min_relative_decrease: f64,
    /// Stop when no entry of the step exceeds this, in tangent units. Default 1e-8.
    pub min_step: f64,
    /// Damping at the start, relative to the diagonal of the Hessian. Default 1e-4; a pose graph far from its
    /// minimum likes more, a nearly converged problem less.
    pub initial_lambda: f64,
    /// Diagonal entries below this are damped as if they were this large. Default 1e-6.
    pub min_diagonal: f64,
    /// How the reduced system is factorized. Default [`LinearSolver::Auto`].
    pub linear_solver: LinearSolver,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self {
            max_iterations: 20,
            min_relative_decrease: 1e-6,
            min_step: 1e-8,
            initial_lambda: 1e-4,
            min_diagonal: 1e-6,
            linear_solver: LinearSolver::Auto,
        }
    }
}

/// Why [`Problem::solve`] stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// The cost no longer falls noticeably.
    CostConverged,
    /// The step no longer moves anything noticeably.
    StepConverged,
    /// The allowed iterations are used up.
    IterationLimit,
    /// The caller asked to stop; the values are those of the last accepted step.
    Aborted,
    /// Every step, however short, raises the cost: the minimum within rounding, or wrong derivatives.
    NoDescent,
    /// The cost or its derivatives are not finite at the start; nothing was moved.
    NonFinite,
    /// There is no free variable or no enabled factor.
    NothingToSolve,
}

impl StopReason {
    /// Whether the values are at a minimum as far as the solver can tell.
    #[must_use]
    pub fn is_converged(self) -> bool {
        matches!(self, Self::CostConverged | Self::StepConverged | Self::NoDescent)
    }
}

/// What [`Problem::solve`] came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveReport {
    /// Cost before the first step.
    pub initial: Cost,
    /// Cost of the values as they are now; never above `initial.robust`.
    pub last: Cost,
    /// Linear systems solved.
    pub n_iterations: usize,
    /// Steps that lowered the cost and were taken.
    pub n_accepted: usize,
    /// Steps that did not, among them those that could not be computed or led to non-finite costs.
    pub n_rejected: usize,
    /// Rejected steps whose system, step or cost was not finite or not positive definite.
    pub n_broken: usize,
    /// Landmarks held in the last step because their observations do not determine them.
    pub n_held: usize,
    /// Free dimensions of all variables together.
    pub n_free_dims: usize,
    /// Damping after the last step; a start for the next round.
    pub lambda: f64,
    /// Why it stopped.
    pub stop: StopReason,
}

impl SolveReport {
    /// `χ² / (residuals − free dimensions)` at the end: about 1 when the noise is what the factors say.
    /// `None` when there are not more residuals than dimensions.
    #[must_use]
    pub fn chi2_per_dof(&self) -> Option<f64> {
        let dof = self.last.n_residuals.checked_sub(self.n_free_dims).filter(|&dof| dof > 0)?;
        Some(self.last.chi2 / dof as f64)
    }
}

/// Damping beyond which a step is too short to matter.
const MAX_LAMBDA: f64 = 1e16;
/// Damping below which it no longer changes anything in double precision.
const MIN_LAMBDA: f64 = 1e-15;

/// The damping and how it answers to success and failure [Nielsen 1999].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lambda {
    pub value: f64,
    growth: f64,
}

impl Lambda {
    pub(crate) fn new(value: f64) -> Self {
        Self { value: value.clamp(MIN_LAMBDA, MAX_LAMBDA), growth: 2.0 }
    }

    /// `gain` is the actual over the predicted decrease of the cost.
    pub(crate) fn accept(&mut self, gain: f64) {
        let shrink = (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
        self.value = (self.value * shrink).max(MIN_LAMBDA);
        self.growth = 2.0;
    }

    pub(crate) fn reject(&mut self) {
        self.value *= self.growth;
        self.growth *= 2.0;
    }

    pub(crate) fn is_exhausted(&self) -> bool {
        self.value > MAX_LAMBDA
    }
}

impl Problem {
    /// Minimizes the cost by Levenberg-Marquardt from the current values, which are only ever replaced by
    /// better ones. `abort` is asked before every iteration.
    ///
    /// ```
    /// # use optim::{Problem, SolverOptions};
    /// # let mut problem = Problem::new();
    /// # use std::sync::atomic::{AtomicBool, Ordering};
    /// let stop = AtomicBool::new(false);
    /// let report = problem.solve(&SolverOptions::default(), || stop.load(Ordering::Relaxed));
    /// assert!(report.last.robust <= report.initial.robust);
    /// ```
    pub fn solve(&mut self, options: &SolverOptions, abort: impl Fn() -> bool) -> SolveReport {
        self.ensure_system(options.linear_solver);
        self.reset_trial();
        let (initial, gradient) = self.linearize();
        let mut lambda = Lambda::new(options.initial_lambda);
        let mut report = SolveReport {
            initial,
            last: initial,
            n_iterations: 0,
            n_accepted: 0,
            n_rejected: 0,
            n_broken: 0,
            n_held: 0,
            n_free_dims: self.n_free_dims(),
            lambda: lambda.value,
            stop: StopReason::IterationLimit,
        };
        report.stop = if report.n_free_dims == 0 || initial.n_residuals + initial.n_invalid == 0 {
            StopReason::NothingToSolve
        } else if !(initial.robust.is_finite() && gradient.is_finite()) {
            StopReason::NonFinite
        } else {
            self.iterate(options, &abort, &mut lambda, &mut report)
        };
        report.lambda = lambda.value;
        report
    }

    fn iterate(
        &mut self,
        options: &SolverOptions,
        abort: &impl Fn() -> bool,
        lambda: &mut Lambda,
        report: &mut SolveReport,
    ) -> StopReason {
        let mut stale = false;
        while report.n_iterations < options.max_iterations {
            if abort() {
                return StopReason::Aborted;
            }
            if stale {
                if !self.linearize().1.is_finite() {
                    return StopReason::NonFinite;
                }
                stale = false;
            }
            report.n_iterations += 1;
            match self.attempt(options, lambda, report) {
                Attempt::Accepted { stop: Some(stop), .. } | Attempt::Rejected { stop: Some(stop) } => {
                    return stop;
                }
                Attempt::Accepted { stop: None, is_linearized } => stale = !is_linearized,
                Attempt::Rejected { stop: None } => {}
            }
        }
        StopReason::IterationLimit
    }

    /// One damped step: computed, judged by its gain ratio, taken or not.
    fn attempt(&mut self, options: &SolverOptions, lambda: &mut Lambda, report: &mut SolveReport) -> Attempt {
        let damping = Damping { lambda: lambda.value, floor: options.min_diagonal };
        let mut broken = true;
        if let Some(step) = self.try_step(damping) {
            report.n_held = step.n_held;
            if step.max_entry <= options.min_step {
                return Attempt::Rejected { stop: Some(StopReason::StepConverged) };
            }
            // Most steps are taken, and the next iteration begins with derivatives there: they come with the
            // residuals. Not where this iteration is likely to be the last.
            let negligible = options.min_relative_decrease * report.last.robust;
            let goes_on = report.n_iterations < options.max_iterations && step.predicted > negligible;
            let (trial, gradient) =
                if goes_on { self.linearize_trial() } else { (self.cost_at(Side::Trial), 0.0) };
            let decrease = report.last.robust - trial.robust;
            broken = !(decrease.is_finite() && gradient.is_finite());
            if !broken && decrease > 0.0 && step.predicted > 0.0 {
                if goes_on {
                    self.accept_linearized_trial();
                } else {
                    self.accept_trial();
                }
                let relative = decrease / report.last.robust;
                report.last = trial;
                report.n_accepted += 1;
                lambda.accept(decrease / step.predicted);
                let stop = (relative < options.min_relative_decrease).then_some(StopReason::CostConverged);
                return Attempt::Accepted { stop, is_linearized: goes_on };
            }
            if !broken && step.predicted.abs() < negligible && decrease.abs() < negligible {
                report.n_rejected += 1;
                return Attempt::Rejected { stop: Some(StopReason::CostConverged) };
            }
        }
        report.n_rejected += 1;
        report.n_broken += usize::from(broken);
        lambda.reject();
        Attempt::Rejected { stop: lambda.is_exhausted().then_some(StopReason::NoDescent) }
    }
}

enum Attempt {
    /// `is_linearized` if the normal equations are those of the values taken.
    Accepted {
        stop: Option<StopReason>,
        is_linearized: bool,
    },
    Rejected {
        stop: Option<StopReason>,
    },
}
