//! How factors are wired to a problem: from ids to values, and from derivatives to the normal equations.
//!
//! A factor's variables are a tuple of types, and everything about it is known to the compiler: the lookup of
//! the values, the sizes of the derivatives, the products `J_aᵀ J_b`. [`Wiring`] is that typed path. It is
//! apart from [`Variables`], which users see, so that what it mentions can stay inside the crate.

use nalgebra::{SMatrix, SVector};

use crate::arithmetic::Arithmetic;
use crate::layout::{FactorPairs, VariableSlot};
use crate::manifold::Manifold;
use crate::normal::NormalEquations;
use crate::variables::{Side, Stores, VariableId, VariableRef};

/// A tuple of one to three manifolds that a factor with residual `R` touches.
///
/// Implemented for `(A,)`, `(A, B)` and `(A, B, C)`.
pub trait Variables<R>: Sized + Clone + Send + Sync + 'static {
    /// A [`VariableId`] for each member.
    type Ids: Copy + Send + Sync + 'static;
    /// A reference to each member's value.
    type Refs<'a>: Copy;
    /// A matrix of derivatives for each member.
    type Jacobians;

    /// Number of members.
    const ARITY: usize;

    /// References to the members of an owned tuple.
    fn refs(&self) -> Self::Refs<'_>;
}

/// The slots of all variables of each member's type; empty for members that a factor does not have.
pub(crate) type Slots<'a> = [&'a [VariableSlot]; 3];

/// The solver's access to a factor's variables. Implemented for the tuples that are [`Variables`]; nobody
/// outside the crate can name it.
#[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
pub trait Wiring<R>: Variables<R> {
    /// All values of each member's type.
    type Views<'a>: Copy;

    /// The members with one of them moved by `step` along an axis of its tangent space.
    fn perturbed(&self, member: usize, axis: usize, step: f64) -> Self;
    /// Each member's dimension, 0 for those that are not there.
    fn dims() -> [usize; 3];
    /// A member's matrix of derivatives, column-major.
    fn jacobian_entries(jacobians: &Self::Jacobians, member: usize) -> &[f64];
    /// The members without their types.
    fn variable_refs(ids: Self::Ids, stores: &Stores) -> [Option<VariableRef>; 3];
    /// Looks the types up, once for all factors of a group.
    fn views(stores: &Stores, side: Side) -> Self::Views<'_>;
    /// The members' values.
    fn values<'a>(views: Self::Views<'a>, ids: Self::Ids) -> Self::Refs<'a>;
    /// Looks the types up, once for all factors of a group.
    fn slots(stores: &Stores) -> Slots<'_>;
    /// Whether the first member is held at its value.
    fn is_first_fixed(ids: Self::Ids, slots: Slots<'_>) -> bool;
    /// Adds `w Jᵀ r` and `w Jᵀ J` of one factor; without its first member if that is known to be fixed.
    fn accumulate<M: Arithmetic, const FIRST_FIXED: bool>(
        linearized: &(R, Self::Jacobians),
        weight: f64,
        ids: Self::Ids,
        slots: Slots<'_>,
        pairs: &FactorPairs,
        normal: &mut NormalEquations,
    );
}

/// Implements [`Variables`] and [`Wiring`] for one arity; `pairs` lists the member pairs in the order of
/// [`FactorPairs`].
macro_rules! impl_variables {
    ($arity:literal; $($index:tt $T:ident $N:ident),+; $(($pair:tt, $a:tt, $b:tt)),*) => {
        impl<const R: usize, $($T, const $N: usize),+> Variables<SVector<f64, R>> for ($($T,)+)
        where
            $($T: Manifold<Tangent = SVector<f64, $N>>),+
        {
            type Ids = ($(VariableId<$T>,)+);
            type Refs<'a> = ($(&'a $T,)+);
            type Jacobians = ($(SMatrix<f64, R, $N>,)+);

            const ARITY: usize = $arity;

            #[inline]
            fn refs(&self) -> Self::Refs<'_> {
                ($(&self.$index,)+)
            }
        }

        #[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
        impl<const R: usize, $($T, const $N: usize),+> Wiring<SVector<f64, R>> for ($($T,)+)
        where
            $($T: Manifold<Tangent = SVector<f64, $N>>),+
        {
            type Views<'a> = ($(&'a [$T],)+);

            fn perturbed(&self, member: usize, axis: usize, step: f64) -> Self {
                let mut moved = self.clone();
                $(if member == $index {
                    let mut delta = SVector::<f64, $N>::zeros();
                    delta[axis] = step;
                    moved.$index = self.$index.retract(&delta);
                })+
                moved
            }

            fn dims() -> [usize; 3] {
                let mut dims = [0; 3];
                $(dims[$index] = $N;)+
                dims
            }

            fn jacobian_entries(jacobians: &Self::Jacobians, member: usize) -> &[f64] {
                match member {
                    $($index => jacobians.$index.as_slice(),)+
                    _ => &[],
                }
            }

            fn variable_refs(ids: Self::Ids, stores: &Stores) -> [Option<VariableRef>; 3] {
                let mut refs = [None; 3];
                $(refs[$index] = Some(stores.variable_ref(ids.$index));)+
                refs
            }

            fn views(stores: &Stores, side: Side) -> Self::Views<'_> {
                ($(stores.values::<$T>(side),)+)
            }

            #[inline(always)]
            fn values<'a>(views: Self::Views<'a>, ids: Self::Ids) -> Self::Refs<'a> {
                ($(&views.$index[ids.$index.index()],)+)
            }

            fn slots(stores: &Stores) -> Slots<'_> {
                let mut slots: Slots<'_> = [&[]; 3];
                $(slots[$index] = stores.slots::<$T>();)+
                slots
            }

            #[inline(always)]
            fn is_first_fixed(ids: Self::Ids, slots: Slots<'_>) -> bool {
                slots[0][ids.0.index()].is_fixed()
            }

            #[inline(always)]
            fn accumulate<M: Arithmetic, const FIRST_FIXED: bool>(
                (residual, jacobians): &(SVector<f64, R>, Self::Jacobians),
                weight: f64,
                ids: Self::Ids,
                slots: Slots<'_>,
                pairs: &FactorPairs,
                normal: &mut NormalEquations,
            ) {
                let weighted = ($(jacobians.$index * weight,)+);
                $(if !(FIRST_FIXED && $index == 0) {
                    normal.add_diagonal::<M, _, _>(slots[$index][ids.$index.index()], &weighted.$index, &jacobians.$index, residual);
                })+
                $(if !(FIRST_FIXED && $a == 0) {
                    normal.add_pair::<M, _, _, _>(pairs[$pair], &weighted.$a, &jacobians.$b);
                })*
                let _ = pairs;
            }
        }
    };
}

impl_variables!(1; 0 A NA;);
impl_variables!(2; 0 A NA, 1 B NB; (0, 0, 1));
impl_variables!(3; 0 A NA, 1 B NB, 2 C NC; (0, 0, 1), (1, 0, 2), (2, 1, 2));
