//! Groups of factors of one type: where static dispatch happens.

use std::any::Any;
use std::fmt;
use std::marker::PhantomData;

use crate::arithmetic::{Arithmetic, vectorized};
use crate::cost::{Cost, INVALID_CHI2};
use crate::factor::{Factor, Residual, VariableIds};
use crate::kernel::Kernel;
use crate::layout::{FactorPairs, NO_SLOT};
use crate::normal::NormalEquations;
use crate::variables::{Side, Stores, VariableRef};
use crate::wiring::Wiring;

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

    /// `ρ(‖r‖²)` of an enabled factor, if it can be evaluated.
    pub(crate) fn loss_at(&self, stores: &Stores, side: Side, index: usize) -> Option<f64> {
        let views = F::Variables::views(stores, side);
        let values = F::Variables::values(views, self.ids[index]);
        let residual = self.factors[index].residual(values).filter(|_| self.enabled[index])?;
        Some(self.kernel.loss(residual.squared_norm()))
    }

    /// See [`Group::cost`].
    #[inline(always)]
    fn sum_cost(&self, stores: &Stores, side: Side) -> Cost {
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
        self.complete(&mut cost, n_valid);
        cost
    }

    /// See [`Group::linearize`].
    #[inline(always)]
    fn add_to<M: Arithmetic>(&self, stores: &Stores, side: Side, normal: &mut NormalEquations) -> Cost {
        let mut cost = Cost::default();
        if self.factors.is_empty() {
            return cost;
        }
        let views = F::Variables::views(stores, side);
        let slots = F::Variables::slots(stores);
        let members = self.ids.iter().zip(&self.pairs).zip(&self.enabled);
        let mut n_valid = 0;
        for (factor, ((&ids, pairs), &enabled)) in self.factors.iter().zip(members) {
            if !enabled {
                continue;
            }
            let values = F::Variables::values(views, ids);
            // No closures: only what is surely inlined is compiled with the instructions of `M`.
            let Some(linearized) = factor.linearize(values) else {
                cost.n_invalid += 1;
                continue;
            };
            let chi2 = linearized.0.squared_norm();
            cost.chi2 += chi2;
            cost.robust += 0.5 * self.kernel.loss(chi2);
            n_valid += 1;
            let weight = self.kernel.weight(chi2);
            // The compiler leaves out what only the derivatives by a fixed first variable need: many of the
            // observations of a local bundle adjustment are from keyframes that are held.
            if F::Variables::is_first_fixed(ids, slots) {
                F::Variables::accumulate::<M, true>(&linearized, weight, ids, slots, pairs, normal);
            } else {
                F::Variables::accumulate::<M, false>(&linearized, weight, ids, slots, pairs, normal);
            }
        }
        self.complete(&mut cost, n_valid);
        cost
    }

    /// Counts the residuals of a sum and adds what factors without one cost.
    fn complete(&self, cost: &mut Cost, n_valid: usize) {
        cost.n_residuals = n_valid * F::Residual::DIM;
        cost.robust += 0.5 * cost.n_invalid as f64 * self.kernel.loss(INVALID_CHI2);
    }
}

/// What the solver does with a group without knowing its type.
pub(crate) trait Group: Send + Sync {
    fn len(&self) -> usize;
    fn variables(&self, index: usize, stores: &Stores) -> [Option<VariableRef>; 3];
    fn set_pairs(&mut self, index: usize, pairs: FactorPairs);
    /// The cost at the accepted or the trial values.
    fn cost(&self, stores: &Stores, side: Side) -> Cost;
    /// Adds the group's share to the normal equations at the accepted or the trial values; returns the cost
    /// there.
    fn linearize(&self, stores: &Stores, side: Side, normal: &mut NormalEquations) -> Cost;
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
        vectorized!(_M => self.sum_cost(stores, side))
    }

    fn linearize(&self, stores: &Stores, side: Side, normal: &mut NormalEquations) -> Cost {
        vectorized!(M => self.add_to::<M>(stores, side, normal))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}
