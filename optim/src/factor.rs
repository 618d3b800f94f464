//! Factors: the terms of the cost, and the variables each of them touches.

use nalgebra::SVector;

use crate::manifold::Manifold;
use crate::wiring::{Variables, Wiring};

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
/// let (factor, at) = (OnCircle { radius: 1.0, sigma: 0.1 }, Vector2::new(1.0, 2.0));
/// optim::testing::assert_jacobians_match(&factor, &(at,), 1e-6, 1e-5);
/// ```
pub trait Factor: Send + Sync + 'static {
    /// The residual, an `SVector<f64, R>`.
    type Residual: Residual;

    /// The tuple of variable types, such as `(Pose, Vector3<f64>)`. The second bound says no more than the
    /// first: it is the solver's access to such a tuple.
    type Variables: Variables<Self::Residual> + Wiring<Self::Residual>;

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

mod sealed {
    /// Keeps [`super::Residual`] to nalgebra's vectors.
    pub trait Sealed {}
    impl<const R: usize> Sealed for nalgebra::SVector<f64, R> {}
}
