//! What a variable must offer to be optimized: a tangent space, `retract` and `local`.

use geometry::{Direction, OrthonormalLine, Pose, Similarity};
use nalgebra::SVector;

use crate::schur::Eliminate;

/// A point of a smooth manifold of dimension `DIM`, moved by vectors of its tangent space.
///
/// Laws, checked by [`crate::testing::assert_manifold_laws`]:
/// `x.retract(0) == x`, `x.local(x.retract(δ)) == δ` for small `δ`, `x.retract(x.local(y)) == y`.
pub trait Manifold: Clone + Send + Sync + 'static {
    /// The tangent vector; an [`SVector<f64, N>`] whose `N` is the manifold's dimension.
    type Tangent: Tangent;

    /// Number of degrees of freedom.
    const DIM: usize = <Self::Tangent as Tangent>::DIM;

    /// Moves from `self` along `delta`, which lives in the tangent space at `self`.
    fn retract(&self, delta: &Self::Tangent) -> Self;

    /// The `delta` for which `self.retract(&delta)` is `other`.
    fn local(&self, other: &Self) -> Self::Tangent;
}

/// A tangent vector of fixed length. Implemented for every `SVector<f64, N>` and for nothing else.
///
/// The supertrait seals it: it is how the Schur complement gets at the length as a constant of the compiler.
pub trait Tangent: Eliminate + Copy + Send + Sync + std::fmt::Debug + 'static {
    /// Length of the vector.
    const DIM: usize;

    /// Reads the vector from the first `DIM` entries of `values`.
    fn from_slice(values: &[f64]) -> Self;

    /// The entries in order.
    fn as_slice(&self) -> &[f64];
}

impl<const N: usize> Tangent for SVector<f64, N> {
    const DIM: usize = N;

    #[inline]
    fn from_slice(values: &[f64]) -> Self {
        SVector::from_column_slice(&values[..N])
    }

    #[inline]
    fn as_slice(&self) -> &[f64] {
        self.as_slice()
    }
}

/// Vectors are their own tangent space: positions of points, and anything else that adds.
impl<const N: usize> Manifold for SVector<f64, N> {
    type Tangent = SVector<f64, N>;

    #[inline]
    fn retract(&self, delta: &Self::Tangent) -> Self {
        self + delta
    }

    #[inline]
    fn local(&self, other: &Self) -> Self::Tangent {
        other - self
    }
}

/// Lets a type that already has `retract` and `local` of the right shape be a variable.
macro_rules! impl_manifold {
    ($(#[$doc:meta])* $T:ty, $n:literal) => {
        $(#[$doc])*
        impl Manifold for $T {
            type Tangent = SVector<f64, $n>;

            #[inline]
            fn retract(&self, delta: &Self::Tangent) -> Self {
                <$T>::retract(self, delta)
            }

            #[inline]
            fn local(&self, other: &Self) -> Self::Tangent {
                <$T>::local(self, other)
            }
        }
    };
}

impl_manifold!(
    /// `exp(δ) * T`, `δ = [rotation, translation]`.
    Pose,
    6
);
impl_manifold!(
    /// `exp(δ) * S`, `δ = [rotation, translation, log scale]`.
    Similarity,
    7
);
impl_manifold!(
    /// Two angles in the tangent plane of the unit vector.
    Direction,
    2
);
impl_manifold!(
    /// Three angles of the frame and one of the ratio of moment to direction.
    OrthonormalLine,
    4
);

#[cfg(test)]
mod tests {
    use nalgebra::{SVector, Vector2, Vector3, Vector4, Vector6};

    use super::*;
    use crate::testing::assert_manifold_laws;

    /// A few dozen small tangent vectors, spread by a fixed irrational stride.
    fn deltas<const N: usize>() -> impl Iterator<Item = SVector<f64, N>> {
        (1..40).map(|k| SVector::from_fn(|i, _| (f64::from(k) * (i as f64 + 1.7)).sin() * 0.3))
    }

    #[test]
    fn vectors_obey_the_laws() {
        deltas().for_each(|delta| assert_manifold_laws(&Vector3::new(1.0, -2.0, 3.0), &delta, 1e-12));
    }

    #[test]
    fn poses_and_similarities_obey_the_laws() {
        let pose = Pose::exp(&Vector6::new(0.4, -1.2, 0.7, 1.0, 2.0, -3.0));
        deltas().for_each(|delta| assert_manifold_laws(&pose, &delta, 1e-9));
        let similarity = Similarity::exp(&SVector::from([0.4, -1.2, 0.7, 1.0, 2.0, -3.0, 0.5]));
        deltas().for_each(|delta| assert_manifold_laws(&similarity, &delta, 1e-9));
    }

    #[test]
    fn directions_obey_the_laws() {
        for axis in [Vector3::new(0.3, -0.8, 0.4), Vector3::x(), Vector3::y(), Vector3::z()] {
            let direction = Direction::new(axis).expect("the axis is not zero");
            deltas().for_each(|delta: Vector2<f64>| assert_manifold_laws(&direction, &delta, 1e-9));
        }
    }

    #[test]
    fn lines_obey_the_laws() {
        let line = geometry::Line3::from_points(&Vector3::new(1.0, 2.0, 3.0), &Vector3::new(-1.0, 2.5, 4.0));
        let line =
            line.and_then(|line| OrthonormalLine::from_line(&line)).expect("the line misses the origin");
        deltas().for_each(|delta: Vector4<f64>| assert_manifold_laws(&line, &delta, 1e-9));
    }

    #[test]
    fn poses_are_perturbed_from_the_left_rotation_first() {
        let pose = Pose::exp(&Vector6::new(0.1, 0.2, 0.3, 1.0, 2.0, 3.0));
        let moved = Manifold::retract(&pose, &Vector6::new(0.0, 0.0, 0.0, 0.5, 0.0, 0.0));
        assert!((moved.translation - pose.translation - Vector3::new(0.5, 0.0, 0.0)).norm() < 1e-12);
    }
}
