//! Factors: the terms of the cost, and the variables each of them touches.

use nalgebra::{SMatrix, SVector};

use crate::manifold::{Manifold, sealed};
use crate::normal::NormalEquations;
use crate::variables::{Side, Stores, VariableId, VariableRef, VariableSlot};

/// One term `½ ρ(‖r‖²)` of the cost, between one to three variables.
///
/// A factor is pure mathematics: it holds its measurement and knows residual and derivatives, not which
/// variables of a problem it is tied to; those are given to [`crate::Problem::add_factors`].
///
/// * `r` is **whitened**: divided by its standard deviation, so that `‖r‖²` is χ²-distributed.
/// * Derivatives are with respect to the tangent vector of each variable, `∂ r(x.retract(δ)) / ∂ δ` at
///   `δ = 0`, one matrix per variable. Check them with [`crate::testing::assert_jacobians_match`].
/// * `None` says that the factor cannot be evaluated here, such as a point behind its camera. It then counts
///   as an outlier of constant cost, [`crate::INVALID_CHI2`], and pulls at nothing.
///
/// ```
/// use nalgebra::{Matrix1, Vector1, Matrix1x2, Vector2};
/// use optim::{Factor, Linearized};
///
/// /// `r = (‖p‖ − radius) / sigma`
/// struct OnCircle { radius: f64, sigma: f64 }
///
/// impl Factor for OnCircle {
///     type Residual = Vector1<f64>;
///     type Variables = (Vector2<f64>,);
///
///     fn residual(&self, (p,): (&Vector2<f64>,)) -> Option<Vector1<f64>> {
///         Some(Vector1::new((p.norm() - self.radius) / self.sigma))
///     }
///     fn linearize(&self, (p,): (&Vector2<f64>,)) -> Option<Linearized<Self>> {
///         let d_residual_d_p: Matrix1x2<f64> = p.transpose() / (p.norm() * self.sigma);
///         Some((self.residual((p,))?, (d_residual_d_p,)))
///     }
/// }
/// optim::testing::assert_jacobians_match(&OnCircle { radius: 1.0, sigma: 0.1 }, &(Vector2::new(1.0, 2.0),), 1e-6, 1e-5);
/// ```
pub trait Factor: Send + Sync + 'static {
    /// The residual, an `SVector<f64, R>`.
    type Residual: Residual;

    /// The tuple of variable types, such as `(Pose, Vector3<f64>)`.
    type Variables: Variables<Self::Residual>;

    /// The whitened residual at `values`, or `None` where it is not defined.
    fn residual(&self, values: ValueRefs<'_, Self>) -> Option<Self::Residual>;

    /// The whitened residual and its derivatives at `values`, or `None` where it is not defined.
    fn linearize(&self, values: ValueRefs<'_, Self>) -> Option<Linearized<Self>>;
}

/// References to the values of a factor's variables, such as `(&Pose, &Vector3<f64>)`.
pub type ValueRefs<'a, F> = <<F as Factor>::Variables as Variables<<F as Factor>::Residual>>::Refs<'a>;

/// The ids of a factor's variables, such as `(VariableId<Pose>, VariableId<Vector3<f64>>)`.
pub type VariableIds<F> = <<F as Factor>::Variables as Variables<<F as Factor>::Residual>>::Ids;

/// The derivatives of a factor's residual, such as `(Matrix2x6<f64>, Matrix2x3<f64>)`.
pub type Jacobians<F> = <<F as Factor>::Variables as Variables<<F as Factor>::Residual>>::Jacobians;

/// A residual with its derivatives.
pub type Linearized<F> = (<F as Factor>::Residual, Jacobians<F>);

/// A residual vector of fixed length. Implemented for every `SVector<f64, R>` and for nothing else.
pub trait Residual: sealed::Sealed + Copy + Send + Sync + 'static {
    /// Number of residuals, the factor's degrees of freedom.
    const DIM: usize;

    /// `‖r‖²`
    fn squared_norm(&self) -> f64;

    /// The entries in order.
    fn entries(&self) -> &[f64];
}

impl<const R: usize> Residual for SVector<f64, R> {
    const DIM: usize = R;

    #[inline]
    fn squared_norm(&self) -> f64 {
        self.norm_squared()
    }

    #[inline]
    fn entries(&self) -> &[f64] {
        self.as_slice()
    }
}

/// A tuple of one to three manifolds that a factor with residual `R` touches.
///
/// Implemented here for `(A,)`, `(A, B)` and `(A, B, C)`; the hidden methods are the solver's typed path
/// from ids to values and from derivatives to the normal equations.
pub trait Variables<R>: Sized + Clone + Send + Sync + 'static {
    /// A [`VariableId`] for each member.
    type Ids: Copy + Send + Sync + 'static;
    /// A reference to each member's value.
    type Refs<'a>: Copy;
    /// A matrix of derivatives for each member.
    type Jacobians;
    #[doc(hidden)]
    type Views<'a>: Copy;
    #[doc(hidden)]
    type Slots<'a>: Copy;

    /// Number of members.
    const ARITY: usize;

    /// References to the members of an owned tuple.
    fn refs(&self) -> Self::Refs<'_>;

    #[doc(hidden)]
    fn perturbed(&self, member: usize, axis: usize, step: f64) -> Self;
    #[doc(hidden)]
    fn dims() -> [usize; 3];
    #[doc(hidden)]
    fn jacobian_entries(jacobians: &Self::Jacobians, member: usize) -> &[f64];
    #[doc(hidden)]
    fn variable_refs(ids: Self::Ids, stores: &Stores) -> [Option<VariableRef>; 3];
    #[doc(hidden)]
    fn views(stores: &Stores, side: Side) -> Self::Views<'_>;
    #[doc(hidden)]
    fn values<'a>(views: Self::Views<'a>, ids: Self::Ids) -> Self::Refs<'a>;
    #[doc(hidden)]
    fn slots(stores: &Stores) -> Self::Slots<'_>;
    #[doc(hidden)]
    fn accumulate(
        linearized: &(R, Self::Jacobians),
        weight: f64,
        ids: Self::Ids,
        slots: Self::Slots<'_>,
        pairs: &[u32; 3],
        normal: &mut NormalEquations,
    );
}

/// Implements [`Variables`] for one arity; `pairs` lists the member pairs in the order of `FactorPlan`.
macro_rules! impl_variables {
    ($arity:literal; $($index:tt $T:ident $N:ident),+; $(($pair:tt, $a:tt, $b:tt)),*) => {
        impl<const R: usize, $($T, const $N: usize),+> Variables<SVector<f64, R>> for ($($T,)+)
        where
            $($T: Manifold<Tangent = SVector<f64, $N>>),+
        {
            type Ids = ($(VariableId<$T>,)+);
            type Refs<'a> = ($(&'a $T,)+);
            type Jacobians = ($(SMatrix<f64, R, $N>,)+);
            type Views<'a> = ($(&'a [$T],)+);
            type Slots<'a> = [&'a [VariableSlot]; $arity];

            const ARITY: usize = $arity;

            #[inline]
            fn refs(&self) -> Self::Refs<'_> {
                ($(&self.$index,)+)
            }

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

            fn slots(stores: &Stores) -> Self::Slots<'_> {
                [$(stores.slots::<$T>()),+]
            }

            #[inline(always)]
            fn accumulate(
                (residual, jacobians): &(SVector<f64, R>, Self::Jacobians),
                weight: f64,
                ids: Self::Ids,
                slots: Self::Slots<'_>,
                pairs: &[u32; 3],
                normal: &mut NormalEquations,
            ) {
                let weighted = ($(jacobians.$index * weight,)+);
                $(normal.add_diagonal(slots[$index][ids.$index.index()], &weighted.$index, &jacobians.$index, residual);)+
                $(normal.add_pair(pairs[$pair], &weighted.$a, &jacobians.$b);)*
                let _ = pairs;
            }
        }
    };
}

impl_variables!(1; 0 A NA;);
impl_variables!(2; 0 A NA, 1 B NB; (0, 0, 1));
impl_variables!(3; 0 A NA, 1 B NB, 2 C NC; (0, 0, 1), (1, 0, 2), (2, 1, 2));

/// A factor of two variables whose second one is held at a given value, leaving one to the first.
///
/// Turns a bundle-adjustment factor of pose and landmark into one of the pose alone.
#[derive(Clone, Copy, Debug)]
pub struct HoldSecond<F, B> {
    /// The factor of two variables.
    pub factor: F,
    /// The value at which the second one is held.
    pub second: B,
}

impl<F, A, B, const R: usize, const NA: usize, const NB: usize> Factor for HoldSecond<F, B>
where
    F: Factor<Residual = SVector<f64, R>, Variables = (A, B)>,
    A: Manifold<Tangent = SVector<f64, NA>>,
    B: Manifold<Tangent = SVector<f64, NB>>,
{
    type Residual = SVector<f64, R>;
    type Variables = (A,);

    #[inline]
    fn residual(&self, (first,): (&A,)) -> Option<Self::Residual> {
        self.factor.residual((first, &self.second))
    }

    #[inline]
    fn linearize(&self, (first,): (&A,)) -> Option<Linearized<Self>> {
        let (residual, (d_residual_d_first, _)) = self.factor.linearize((first, &self.second))?;
        Some((residual, (d_residual_d_first,)))
    }
}
