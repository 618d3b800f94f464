//! The factor graph: variables, factors, and the linear system they make.

mod group;
mod structure;

use nalgebra::{DMatrix, DVector};

pub use group::GroupId;

use crate::cost::Cost;
use crate::factor::{Factor, VariableIds};
use crate::kernel::Kernel;
use crate::layout::Layout;
use crate::manifold::Manifold;
use crate::normal::NormalEquations;
use crate::reduced::{LinearSolver, ReducedSolver};
use crate::schur::{Damping, LandmarkSpan, Schur};
use crate::variables::{Role, Side, Stores, VariableId, VariableRef};
use group::{Group, TypedGroup};

/// A nonlinear least-squares problem `min ½ Σ ρ(‖r‖²)` over manifolds.
///
/// Variables are either *reduced* ([`Problem::add_variable`]: poses, similarities, directions) or *landmarks*
/// ([`Problem::add_landmark`]: points, lines). Landmarks are eliminated before the linear system is solved,
/// so a factor may touch any reduced variables but at most one landmark.
///
/// Results depend on the order in which variables and factors are added and on nothing else: add them in the
/// order of their ids. The linearization is quickest when factors come landmark by landmark.
#[derive(Default)]
pub struct Problem {
    stores: Stores,
    groups: Vec<Box<dyn Group>>,
    system: Option<LinearSystem>,
}

impl Problem {
    /// An empty problem.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a free variable that stays in the reduced system, at `value`.
    pub fn add_variable<T: Manifold>(&mut self, value: T) -> VariableId<T> {
        self.system = None;
        self.stores.add(value, Role::Reduced)
    }

    /// Adds a free variable to be eliminated, at `value`.
    pub fn add_landmark<T: Manifold>(&mut self, value: T) -> VariableId<T> {
        self.system = None;
        self.stores.add(value, Role::Landmark)
    }

    /// Fixes a variable at its value, or frees it again.
    pub fn set_fixed<T: Manifold>(&mut self, id: VariableId<T>, fixed: bool) {
        if self.stores.is_fixed(id) != fixed {
            self.system = None;
            self.stores.set_fixed(id, fixed);
        }
    }

    /// The current value of a variable.
    #[must_use]
    pub fn value<T: Manifold>(&self, id: VariableId<T>) -> &T {
        self.stores.get(id)
    }

    /// Moves a variable, fixed or free.
    pub fn set_value<T: Manifold>(&mut self, id: VariableId<T>, value: T) {
        self.stores.set(id, value);
    }

    /// Adds factors of one type under one kernel, each with the variables it touches.
    ///
    /// # Panics
    /// When a factor touches a variable twice or more than one landmark, or an id is not of this problem.
    pub fn add_factors<F: Factor>(
        &mut self,
        kernel: Kernel,
        factors: impl IntoIterator<Item = (VariableIds<F>, F)>,
    ) -> GroupId<F> {
        self.system = None;
        let group = TypedGroup::new(kernel, factors);
        for index in 0..group.len() {
            self.check(group.variables(index, &self.stores));
        }
        self.groups.push(Box::new(group));
        GroupId::new(self.groups.len() - 1)
    }

    /// The factors of a group, in the order in which they were given.
    #[must_use]
    pub fn factors<F: Factor>(&self, group: GroupId<F>) -> &[F] {
        &self.group(group).factors
    }

    /// Changes a group's kernel, say from robust to plain once the outliers are out.
    pub fn set_kernel<F: Factor>(&mut self, group: GroupId<F>, kernel: Kernel) {
        self.group_mut(group).kernel = kernel;
    }

    /// Puts another factor in the place of one, between the same variables.
    pub fn replace_factor<F: Factor>(&mut self, group: GroupId<F>, index: usize, factor: F) {
        self.group_mut(group).factors[index] = factor;
    }

    /// Leaves a factor out of the cost, or takes it back in. Costs nothing: the structure stays.
    pub fn set_enabled<F: Factor>(&mut self, group: GroupId<F>, index: usize, enabled: bool) {
        self.group_mut(group).enabled[index] = enabled;
    }

    /// [`set_enabled`](Self::set_enabled) for a whole group.
    pub fn set_group_enabled<F: Factor>(&mut self, group: GroupId<F>, enabled: bool) {
        self.group_mut(group).enabled.fill(enabled);
    }

    /// Whether a factor takes part.
    #[must_use]
    pub fn is_enabled<F: Factor>(&self, group: GroupId<F>, index: usize) -> bool {
        self.group(group).enabled[index]
    }

    /// `‖r‖²` of a factor at the current values, enabled or not, without kernel; `None` where it cannot be
    /// evaluated.
    #[must_use]
    pub fn chi2<F: Factor>(&self, group: GroupId<F>, index: usize) -> Option<f64> {
        self.group(group).chi2(&self.stores, index)
    }

    /// Enables exactly the factors of a group whose `‖r‖²` is at most `max_chi2`, and returns how many.
    pub fn enable_inliers<F: Factor>(&mut self, group: GroupId<F>, max_chi2: f64) -> usize {
        let n = self.group(group).factors.len();
        let mut n_enabled = 0;
        for index in 0..n {
            let inlier = self.chi2(group, index).is_some_and(|chi2| chi2 <= max_chi2);
            self.set_enabled(group, index, inlier);
            n_enabled += usize::from(inlier);
        }
        n_enabled
    }

    /// The cost of all enabled factors at the current values.
    #[must_use]
    pub fn cost(&self) -> Cost {
        self.cost_at(Side::Current)
    }

    /// The cost of a group's enabled factors at the current values.
    #[must_use]
    pub fn cost_of<F: Factor>(&self, group: GroupId<F>) -> Cost {
        Group::cost(self.group(group), &self.stores, Side::Current)
    }

    /// The covariance of a free reduced variable, in its tangent space, given that everything else is
    /// estimated too: the block of the inverse of the undamped reduced Hessian at the current values.
    ///
    /// `None` when the variable is fixed or a landmark, or when the problem leaves it undetermined (such as
    /// by an unfixed gauge).
    pub fn marginal_covariance<T: Manifold>(&mut self, id: VariableId<T>) -> Option<DMatrix<f64>> {
        let columns = self.covariance_columns(id)?;
        let first = self.stores.slots::<T>()[id.index()].gradient as usize;
        let covariance = DMatrix::from_fn(T::DIM, T::DIM, |row, axis| columns[axis][first + row]);
        covariance.iter().all(|entry| entry.is_finite()).then_some(covariance)
    }

    /// How uncertain a free reduced variable is, as the errors that were made say, and not as they were
    /// expected: the clustered ("sandwich") estimate of its covariance [Liang and Zeger, Longitudinal data
    /// analysis using generalized linear models, 1986], which holds also if the residuals of one cluster are
    /// not independent of each other. `cluster_of` names the cluster of each factor of the group, counted
    /// from 0.
    ///
    /// The values must be those of a minimum. `None` as in
    /// [`marginal_covariance`](Self::marginal_covariance).
    pub fn clustered_covariance<T: Manifold, F: Factor>(
        &mut self,
        id: VariableId<T>,
        group: GroupId<F>,
        cluster_of: &[usize],
    ) -> Option<ClusteredCovariance> {
        let columns = self.covariance_columns(id)?;
        let first = self.stores.slots::<T>()[id.index()].gradient as usize;
        let n_clusters = cluster_of.iter().max().map_or(0, |last| last + 1);
        let mut scores = DMatrix::zeros(n_clusters, T::DIM);
        let columns: Vec<Vec<f64>> = columns.iter().map(|column| self.with_landmarks(column)).collect();
        for (axis, column) in columns.iter().enumerate() {
            // The derivative of each factor's cost along the column, by central differences.
            let reach = SCORE_STEP / max_abs(column).max(f64::MIN_POSITIVE);
            let mut step = vec![0.0; column.len()];
            for sign in [1.0, -1.0] {
                step.iter_mut().zip(column).for_each(|(step, entry)| *step = sign * reach * entry);
                self.stores.iter_mut().for_each(|store| store.retract(&step));
                let group = self.group(group);
                for (index, cluster) in cluster_of.iter().enumerate() {
                    if let Some(loss) = group.loss_at(&self.stores, Side::Trial, index) {
                        scores[(*cluster, axis)] += sign * 0.5 * loss / (2.0 * reach);
                    }
                }
            }
        }
        let expected = DMatrix::from_fn(T::DIM, T::DIM, |row, axis| columns[axis][first + row]);
        let observed = scores.transpose() * &scores;
        let is_finite = |matrix: &DMatrix<f64>| matrix.iter().all(|entry| entry.is_finite());
        (is_finite(&expected) && is_finite(&observed)).then_some(ClusteredCovariance { expected, observed })
    }

    /// A step of the reduced variables with what it takes landmarks along by.
    fn with_landmarks(&mut self, reduced: &[f64]) -> Vec<f64> {
        let Some(system) = self.system.as_mut() else { return reduced.to_vec() };
        system.normal.gradient.fill(0.0);
        system.step[..reduced.len()].copy_from_slice(reduced);
        let (mut schur, layout, _) = system.split(Damping::NONE);
        for (store, span) in self.stores.iter().zip(&layout.spans) {
            let landmarks = LandmarkSpan { first: span.start, landmarks: &layout.landmarks[span.clone()] };
            store.back_substitute(&mut schur, landmarks);
        }
        system.step.clone()
    }

    /// The columns of the inverse of the undamped reduced Hessian that belong to a free reduced variable.
    fn covariance_columns<T: Manifold>(&mut self, id: VariableId<T>) -> Option<Vec<Vec<f64>>> {
        let variable = self.stores.variable_ref(id);
        let store = self.stores.store(variable.store as usize);
        if store.role(id.index()) != Role::Reduced || self.stores.is_fixed(id) {
            return None;
        }
        self.ensure_system(LinearSolver::Auto);
        self.linearize();
        self.factorize(Damping::NONE).ok()?;
        let first = self.stores.slots::<T>()[id.index()].gradient as usize;
        let system = self.system.as_mut()?;
        let column_of = |axis: usize| {
            let mut column = vec![0.0; system.layout.n_reduced_dims];
            column[first + axis] = 1.0;
            system.solver.solve(&mut column);
            column
        };
        Some((0..T::DIM).map(column_of).collect())
    }

    /// The whole undamped Hessian `Σ w Jᵀ J` and gradient `Σ w Jᵀ r` of the free variables at the current
    /// values: reduced ones first, then landmarks, each in the order in which its type appeared and then of
    /// its id. For small problems, to be examined.
    pub fn dense_normal_equations(&mut self) -> (DMatrix<f64>, DVector<f64>) {
        self.ensure_system(LinearSolver::Auto);
        self.linearize();
        let LinearSystem { layout, normal, .. } = self.system.as_ref().expect("ensured above");
        let mut hessian = DMatrix::zeros(layout.n_gradient, layout.n_gradient);
        let mut put = |row: usize, column: usize, rows: usize, columns: usize, offset: usize| {
            for c in 0..columns {
                for r in 0..rows {
                    let value = normal.blocks[offset + c * rows + r];
                    hessian[(row + r, column + c)] = value;
                    hessian[(column + c, row + r)] = value;
                }
            }
        };
        for (index, column) in layout.reduced.iter().enumerate() {
            put(column.gradient, column.gradient, column.dim, column.dim, column.diagonal);
            for at in layout.below(index) {
                let row = layout.reduced[layout.rows[at] as usize];
                put(row.gradient, column.gradient, row.dim, column.dim, layout.offsets[at] as usize);
            }
        }
        for (store, span) in self.stores.iter().zip(&layout.spans) {
            for landmark in &layout.landmarks[span.clone()] {
                put(landmark.gradient, landmark.gradient, store.dim(), store.dim(), landmark.diagonal);
                for member in &layout.members[landmark.members.clone()] {
                    let row = layout.reduced[member.reduced as usize];
                    put(row.gradient, landmark.gradient, row.dim, store.dim(), member.cross as usize);
                }
            }
        }
        (hessian, DVector::from_column_slice(&normal.gradient))
    }

    fn check(&self, variables: [Option<VariableRef>; 3]) {
        let used = variables.iter().flatten().enumerate();
        let mut n_landmarks = 0;
        for (position, variable) in used {
            let role = self.stores.store(variable.store as usize).role(variable.index as usize);
            n_landmarks += usize::from(role == Role::Landmark);
            let earlier = variables[..position].iter().flatten();
            assert!(!earlier.into_iter().any(|other| other == variable), "a factor touches a variable twice");
        }
        assert!(n_landmarks <= 1, "a factor touches more than one landmark");
    }

    fn group<F: Factor>(&self, group: GroupId<F>) -> &TypedGroup<F> {
        self.groups[group.index()].as_any().downcast_ref().expect("the group is of this problem")
    }

    fn group_mut<F: Factor>(&mut self, group: GroupId<F>) -> &mut TypedGroup<F> {
        self.groups[group.index()].as_any_mut().downcast_mut().expect("the group is of this problem")
    }
}

/// Largest entry of the step over which costs are differentiated, tangent units.
const SCORE_STEP: f64 = 1e-4;

/// Two estimates of a variable's covariance, in its tangent space.
#[derive(Clone, Debug, PartialEq)]
pub struct ClusteredCovariance {
    /// If residuals are as uncertain as they were said to be, and independent:
    /// [`Problem::marginal_covariance`].
    pub expected: DMatrix<f64>,
    /// By the residuals of the group as they are, correlated within clusters.
    pub observed: DMatrix<f64>,
}

/// The solver's side of a problem: layout and memory of the linear system.
struct LinearSystem {
    layout: Layout,
    /// At the accepted values.
    normal: NormalEquations,
    /// At the values under trial, once a step has been tried that was likely to be taken.
    of_trial: NormalEquations,
    choice: LinearSolver,
    solver: ReducedSolver,
    reduced: Vec<f64>,
    step: Vec<f64>,
    scratch: Vec<f64>,
    held: Vec<bool>,
}

/// What a step under trial promises.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepInfo {
    /// Decrease of the cost that the quadratic model predicts.
    pub predicted: f64,
    /// Largest entry of the step, in tangent units.
    pub max_entry: f64,
    /// Landmarks held because their block is singular.
    pub n_held: usize,
}

impl Problem {
    /// Lays out the linear system unless that was done since the problem last changed.
    pub(crate) fn ensure_system(&mut self, choice: LinearSolver) {
        if self.system.as_ref().is_some_and(|system| system.choice == choice) {
            return;
        }
        let layout = Layout::build(&mut self.stores, &mut self.groups);
        self.system = Some(LinearSystem {
            solver: ReducedSolver::new(&layout, choice),
            choice,
            reduced: vec![0.0; layout.n_reduced_blocks],
            step: vec![0.0; layout.n_gradient],
            scratch: vec![0.0; layout.max_members * layout.max_reduced_dim * layout.max_landmark_dim],
            held: vec![false; layout.landmarks.len()],
            normal: NormalEquations::default(),
            of_trial: NormalEquations::default(),
            layout,
        });
    }

    /// Number of free dimensions.
    pub(crate) fn n_free_dims(&self) -> usize {
        self.system.as_ref().map_or(0, |system| system.layout.n_gradient)
    }

    pub(crate) fn cost_at(&self, side: Side) -> Cost {
        let mut cost = Cost::default();
        for group in &self.groups {
            cost.add(group.cost(&self.stores, side));
        }
        cost
    }

    pub(crate) fn reset_trial(&mut self) {
        self.stores.iter_mut().for_each(|store| store.reset_trial());
    }

    pub(crate) fn accept_trial(&mut self) {
        self.stores.iter_mut().for_each(|store| store.accept());
    }

    /// Accepts the trial values together with the normal equations of
    /// [`linearize_trial`](Self::linearize_trial).
    pub(crate) fn accept_linearized_trial(&mut self) {
        self.accept_trial();
        let system = self.system.as_mut().expect("the system is laid out before it is filled");
        std::mem::swap(&mut system.normal, &mut system.of_trial);
    }

    /// Fills the normal equations at the accepted values; returns the cost there and the largest entry of the
    /// gradient.
    pub(crate) fn linearize(&mut self) -> (Cost, f64) {
        let system = self.system.as_mut().expect("the system is laid out before it is filled");
        let cost = fill(&mut system.normal, &system.layout, &self.groups, &self.stores, Side::Current);
        (cost, max_abs(&system.normal.gradient))
    }

    /// As [`linearize`](Self::linearize) at the values under trial.
    pub(crate) fn linearize_trial(&mut self) -> (Cost, f64) {
        let system = self.system.as_mut().expect("the system is laid out before it is filled");
        let cost = fill(&mut system.of_trial, &system.layout, &self.groups, &self.stores, Side::Trial);
        (cost, max_abs(&system.of_trial.gradient))
    }

    /// Reduces and factorizes the damped system.
    fn factorize(&mut self, damping: Damping) -> Result<(), crate::reduced::NotPositiveDefinite> {
        let system = self.system.as_mut().expect("the system is laid out before it is factorised");
        let (mut schur, layout, solver) = system.split(damping);
        schur.begin();
        for (store, span) in self.stores.iter().zip(&layout.spans) {
            let landmarks = LandmarkSpan { first: span.start, landmarks: &layout.landmarks[span.clone()] };
            store.eliminate(&mut schur, landmarks);
        }
        solver.factorize(layout, schur.system)
    }

    /// Solves the damped system and moves the trial values by the step; `None` when the system is not
    /// positive definite or the step not finite.
    pub(crate) fn try_step(&mut self, damping: Damping) -> Option<StepInfo> {
        self.factorize(damping).ok()?;
        let system = self.system.as_mut()?;
        let n_reduced = system.layout.n_reduced_dims;
        system.solver.solve(&mut system.step[..n_reduced]);
        let (mut schur, layout, _) = system.split(damping);
        for (store, span) in self.stores.iter().zip(&layout.spans) {
            let landmarks = LandmarkSpan { first: span.start, landmarks: &layout.landmarks[span.clone()] };
            store.back_substitute(&mut schur, landmarks);
        }
        let info = StepInfo {
            predicted: system.predicted_decrease(&self.stores, damping),
            max_entry: max_abs(&system.step),
            n_held: system.held.iter().filter(|held| **held).count(),
        };
        if !info.max_entry.is_finite() || !info.predicted.is_finite() {
            return None;
        }
        let step = &system.step;
        self.stores.iter_mut().for_each(|store| store.retract(step));
        Some(info)
    }
}

impl LinearSystem {
    fn split(&mut self, damping: Damping) -> (Schur<'_>, &Layout, &mut ReducedSolver) {
        let schur = Schur {
            blocks: &self.normal.blocks,
            gradient: &self.normal.gradient,
            reduced: &self.layout.reduced,
            members: &self.layout.members,
            pairs: &self.layout.pairs,
            damping,
            system: &mut self.reduced,
            step: &mut self.step,
            scratch: &mut self.scratch,
            held: &mut self.held,
        };
        (schur, &self.layout, &mut self.solver)
    }

    /// `½ δᵀ (λ D δ − g)`, what the quadratic model gains by the step `δ`.
    fn predicted_decrease(&self, stores: &Stores, damping: Damping) -> f64 {
        let of = |gradient: usize, diagonal: usize, dim: usize| -> f64 {
            let entries = (0..dim).map(|i| {
                let delta = self.step[gradient + i];
                let damped = damping.of(self.normal.blocks[diagonal + i * (dim + 1)]);
                0.5 * delta * (damped * delta - self.normal.gradient[gradient + i])
            });
            entries.sum()
        };
        let mut sum: f64 = self.layout.reduced.iter().map(|v| of(v.gradient, v.diagonal, v.dim)).sum();
        for (store, span) in stores.iter().zip(&self.layout.spans) {
            let landmarks = &self.layout.landmarks[span.clone()];
            sum += landmarks.iter().map(|l| of(l.gradient, l.diagonal, store.dim())).sum::<f64>();
        }
        sum
    }
}

/// Fills normal equations with what all factors say at the accepted or the trial values; returns the cost
/// there.
fn fill(
    normal: &mut NormalEquations,
    layout: &Layout,
    groups: &[Box<dyn Group>],
    stores: &Stores,
    side: Side,
) -> Cost {
    normal.resize(layout.n_blocks, layout.n_gradient);
    let mut cost = Cost::default();
    groups.iter().for_each(|group| cost.add(group.linearize(stores, side, normal)));
    cost
}

/// The largest magnitude, or NaN if any entry is.
fn max_abs(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(0.0, |max: f64, value| if max.is_nan() || value.abs() <= max { max } else { value.abs() })
}
