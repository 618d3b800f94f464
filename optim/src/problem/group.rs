//! Groups of factors of one type: where static dispatch happens.

use std::any::Any;
use std::fmt;
use std::marker::PhantomData;

use crate::factor::{Factor, Residual, VariableIds, Variables};
use crate::kernel::Kernel;
use crate::normal::NormalEquations;
use crate::variables::{NO_SLOT, Side, Stores, VariableRef};

/// The squared norm at which a factor that cannot be evaluated is counted.
///
/// A hundred standard deviations: so much that no step gains by pushing an observation out of its domain
/// (a point behind its camera), so little that one such observation does not drown the others.
pub const INVALID_CHI2: f64 = 1e4;

/// Names a group of factors of type `F` within the problem that gave it out.
pub struct GroupId<F> {
    index: u32,
    kind: PhantomData<fn() -> F>,
}

impl<F> GroupId<F> {
    pub(crate) fn new(index: usize) -> Self {
        let index = u32::try_from(index).expect("fewer than 2^32 groups");
        Self { index, kind: PhantomData }
    }

    pub(crate) fn index(self) -> usize {
        self.index as usize
    }
}

impl<F> Clone for GroupId<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for GroupId<F> {}
impl<F> fmt::Debug for GroupId<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "GroupId({})", self.index)
    }
}

/// The cost of a set of factors and what went into it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// `½ Σ ρ(‖r‖²)` over the enabled factors, those that cannot be evaluated counted at [`INVALID_CHI2`].
    pub robust: f64,
    /// `Σ ‖r‖²` over the enabled factors that can be evaluated, without kernel.
    pub chi2: f64,
    /// Number of residuals (not of factors) in `chi2`.
    pub n_residuals: usize,
    /// Number of enabled factors that could not be evaluated.
    pub n_invalid: usize,
}

impl Cost {
    pub(crate) fn add(&mut self, other: Cost) {
        self.robust += other.robust;
        self.chi2 += other.chi2;
        self.n_residuals += other.n_residuals;
        self.n_invalid += other.n_invalid;
    }
}

/// Where the products of two different members of a factor go, in the order (0,1), (0,2), (1,2).
pub(crate) type FactorPairs = [u32; 3];

pub(crate) struct TypedGroup<F: Factor> {
    pub(crate) factors: Vec<F>,
    pub(crate) enabled: Vec<bool>,
    pub(crate) kernel: Kernel,
    ids: Vec<VariableIds<F>>,
    pairs: Vec<FactorPairs>,
}

impl<F: Factor> TypedGroup<F> {
    pub(crate) fn new(kernel: Kernel, factors: impl IntoIterator<Item = (VariableIds<F>, F)>) -> Self {
        let (ids, factors): (Vec<_>, Vec<_>) = factors.into_iter().unzip();
        let n = factors.len();
        Self { factors, enabled: vec![true; n], kernel, ids, pairs: vec![[NO_SLOT; 3]; n] }
    }

    pub(crate) fn chi2(&self, stores: &Stores, index: usize) -> Option<f64> {
        let views = F::Variables::views(stores, Side::Current);
        let values = F::Variables::values(views, self.ids[index]);
        self.factors[index].residual(values).map(|residual| residual.squared_norm())
    }
}

/// What the solver does with a group without knowing its type.
pub(crate) trait Group: Send + Sync {
    fn len(&self) -> usize;
    fn variables(&self, index: usize, stores: &Stores) -> [Option<VariableRef>; 3];
    fn set_pairs(&mut self, index: usize, pairs: FactorPairs);
    /// The cost at the accepted or the trial values.
    fn cost(&self, stores: &Stores, side: Side) -> Cost;
    /// Adds the group's share to the normal equations at the accepted values.
    fn linearize(&self, stores: &Stores, normal: &mut NormalEquations);
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

impl<F: Factor> Group for TypedGroup<F> {
    fn len(&self) -> usize {
        self.factors.len()
    }

    fn variables(&self, index: usize, stores: &Stores) -> [Option<VariableRef>; 3] {
        F::Variables::variable_refs(self.ids[index], stores)
    }

    fn set_pairs(&mut self, index: usize, pairs: FactorPairs) {
        self.pairs[index] = pairs;
    }

    fn cost(&self, stores: &Stores, side: Side) -> Cost {
        if self.factors.is_empty() {
            return Cost::default();
        }
        let views = F::Variables::views(stores, side);
        let mut cost = Cost::default();
        let mut n_valid = 0;
        for ((factor, &ids), &enabled) in self.factors.iter().zip(&self.ids).zip(&self.enabled) {
            if !enabled {
                continue;
            }
            match factor.residual(F::Variables::values(views, ids)) {
                Some(residual) => {
                    let chi2 = residual.squared_norm();
                    cost.chi2 += chi2;
                    cost.robust += 0.5 * self.kernel.loss(chi2);
                    n_valid += 1;
                }
                None => cost.n_invalid += 1,
            }
        }
        cost.n_residuals = n_valid * F::Residual::DIM;
        cost.robust += 0.5 * cost.n_invalid as f64 * self.kernel.loss(INVALID_CHI2);
        cost
    }

    fn linearize(&self, stores: &Stores, normal: &mut NormalEquations) {
        if self.factors.is_empty() {
            return;
        }
        let views = F::Variables::views(stores, Side::Current);
        let slots = F::Variables::slots(stores);
        let members = self.ids.iter().zip(&self.pairs).zip(&self.enabled);
        for (factor, ((&ids, pairs), &enabled)) in self.factors.iter().zip(members) {
            if !enabled {
                continue;
            }
            if let Some(linearized) = factor.linearize(F::Variables::values(views, ids)) {
                let weight = self.kernel.weight(linearized.0.squared_norm());
                F::Variables::accumulate(&linearized, weight, ids, slots, pairs, normal);
            }
        }
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}
