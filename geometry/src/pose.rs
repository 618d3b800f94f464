//! Rigid motions of space, SE(3).

use std::ops::Mul;

use nalgebra::{Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector3, Vector6};

use crate::so3;

/// A rigid motion `x ↦ R x + t`, named `target_from_source` where it is stored.
///
/// Tangent vectors are `[rotation(3), translation(3)]` and act on the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// `R`, as a unit quaternion.
    pub rotation: UnitQuaternion<f64>,
    /// `t`, in map units.
    pub translation: Vector3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// The motion that moves nothing.
    #[inline]
    pub fn identity() -> Self {
        Self { rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// The motion `x ↦ rotation x + translation`.
    #[inline]
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// The motion of a rotation matrix, which must be orthonormal with determinant one, and a translation.
    pub fn from_rotation_matrix(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Self {
        let rotation = Rotation3::from_matrix_unchecked(*rotation);
        Self { rotation: UnitQuaternion::from_rotation_matrix(&rotation), translation: *translation }
    }

    /// The exponential of the twist `[rotation(3), translation(3)]`.
    #[inline]
    pub fn exp(delta: &Vector6<f64>) -> Self {
        let phi = Vector3::new(delta[0], delta[1], delta[2]);
        let rho = Vector3::new(delta[3], delta[4], delta[5]);
        Self { rotation: so3::exp(&phi), translation: so3::left_jacobian_times(&phi, &rho) }
    }

    /// The twist `[rotation(3), translation(3)]` of which this is the exponential, its rotation at most π.
    #[inline]
    pub fn log(&self) -> Vector6<f64> {
        let phi = so3::log(&self.rotation);
        let rho = so3::left_jacobian_inverse_times(&phi, &self.translation);
        Vector6::new(phi.x, phi.y, phi.z, rho.x, rho.y, rho.z)
    }

    /// The motion back.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// `R point + t`.
    #[inline]
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// `R` as a matrix.
    #[inline]
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    /// The source-frame point that goes to the target's origin, `-Rᵀ t`: the camera center in the world if
    /// this is `camera_from_world`.
    #[inline]
    pub fn center(&self) -> Vector3<f64> {
        -(self.rotation.inverse() * self.translation)
    }

    /// `exp(delta) * self`, with the quaternion brought back to unit length.
    #[inline]
    pub fn retract(&self, delta: &Vector6<f64>) -> Self {
        let mut moved = Self::exp(delta) * *self;
        moved.rotation.renormalize();
        moved
    }

    /// The `delta` with `self.retract(delta) == other`.
    #[inline]
    pub fn local(&self, other: &Self) -> Vector6<f64> {
        (*other * self.inverse()).log()
    }

    /// The matrix with `self * exp(δ) = exp(adjoint δ) * self`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let r = self.rotation_matrix();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
        adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(so3::skew(&self.translation) * r));
        adjoint
    }

    /// Whether every number in it is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.rotation.coords.iter().chain(self.translation.iter()).all(|x| x.is_finite())
    }

    /// The pose a share `t` of the way along the constant-velocity motion from `self` (`t = 0`) to `other`
    /// (`t = 1`); other values of `t` extrapolate.
    pub fn interpolate(&self, other: &Self, t: f64) -> Self {
        self.retract(&(self.local(other) * t))
    }
}

impl Mul for Pose {
    type Output = Pose;

    #[inline]
    fn mul(self, source: Pose) -> Pose {
        Pose {
            rotation: self.rotation * source.rotation,
            translation: self.rotation * source.translation + self.translation,
        }
    }
}

impl Mul<&Pose> for Pose {
    type Output = Pose;

    #[inline]
    fn mul(self, source: &Pose) -> Pose {
        self * *source
    }
}

impl Mul<Pose> for &Pose {
    type Output = Pose;

    #[inline]
    fn mul(self, source: Pose) -> Pose {
        *self * source
    }
}

impl Mul<&Pose> for &Pose {
    type Output = Pose;

    #[inline]
    fn mul(self, source: &Pose) -> Pose {
        *self * *source
    }
}

impl Mul<Vector3<f64>> for Pose {
    type Output = Vector3<f64>;

    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.transform(&point)
    }
}

impl Mul<Vector3<f64>> for &Pose {
    type Output = Vector3<f64>;

    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.transform(&point)
    }
}
