//! Rotations: exponential, logarithm and the Jacobians between them.
//!
//! All functions are accurate to rounding over their whole domain, including at zero, where the closed forms
//! are `0 / 0`, and at half a turn, where formulas by the trace of the rotation matrix lose all digits.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Below this squared angle the closed forms give way to their series. The first term left out is then
/// below `1e-16` relative to the first one.
const SMALL_ANGLE_SQUARED: f64 = 1e-4;

/// The rotation about the axis `phi` by the angle `|phi|`.
#[inline]
pub fn exp(phi: &Vector3<f64>) -> UnitQuaternion<f64> {
    let theta2 = phi.norm_squared();
    let (half_sinc, cos) = if theta2 < SMALL_ANGLE_SQUARED {
        // sin(θ/2)/θ and cos(θ/2).
        let h2 = theta2 / 4.0;
        (
            0.5 * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0))),
            1.0 - h2 / 2.0 * (1.0 - h2 / 12.0 * (1.0 - h2 / 30.0)),
        )
    } else {
        let theta = theta2.sqrt();
        let (sin, cos) = (0.5 * theta).sin_cos();
        (sin / theta, cos)
    };
    UnitQuaternion::new_unchecked(Quaternion::from_parts(cos, half_sinc * phi))
}

/// The rotation vector of `rotation`, of length at most π.
#[inline]
pub fn log(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = rotation.quaternion();
    // q and -q are the same rotation; the one with w >= 0 turns by at most π.
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let w = sign * q.w;
    let v = sign * q.imag();
    let sin = v.norm();
    if sin < 1e-4 {
        // 2 atan(s/w)/s by its series: the next term is (s/w)⁴/5.
        let ratio = sin / w;
        return v * (2.0 / w * (1.0 - ratio * ratio / 3.0));
    }
    v * (2.0 * sin.atan2(w) / sin)
}

/// The matrix of the cross product: `skew(a) * b = a × b`.
#[inline]
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// `sin θ / θ` and `(1 - cos θ) / θ²` for `theta2 = θ²`.
#[inline]
pub(crate) fn sinc_and_cosc(theta2: f64) -> (f64, f64) {
    if theta2 < SMALL_ANGLE_SQUARED {
        (
            1.0 - theta2 / 6.0 * (1.0 - theta2 / 20.0 * (1.0 - theta2 / 42.0)),
            0.5 - theta2 / 24.0 * (1.0 - theta2 / 30.0 * (1.0 - theta2 / 56.0)),
        )
    } else {
        let theta = theta2.sqrt();
        let half = (0.5 * theta).sin();
        (theta.sin() / theta, 2.0 * half * half / theta2)
    }
}

/// `(1 - cos θ) / θ²` and `(θ - sin θ) / θ³`: the coefficients of the left Jacobian.
#[inline]
fn jacobian_coefficients(theta2: f64) -> (f64, f64) {
    let (sinc, cosc) = sinc_and_cosc(theta2);
    let third = if theta2 < SMALL_ANGLE_SQUARED {
        1.0 / 6.0 - theta2 / 120.0 * (1.0 - theta2 / 42.0)
    } else {
        (1.0 - sinc) / theta2
    };
    (cosc, third)
}

/// `(1 - (θ/2) cot(θ/2)) / θ²`: the coefficient of the inverse of the left Jacobian.
#[inline]
fn inverse_jacobian_coefficient(theta2: f64) -> f64 {
    if theta2 < SMALL_ANGLE_SQUARED {
        1.0 / 12.0 + theta2 / 720.0 * (1.0 + theta2 / 42.0)
    } else {
        let half = 0.5 * theta2.sqrt();
        let (sin, cos) = half.sin_cos();
        (1.0 - half * cos / sin) / theta2
    }
}

/// `J` with `exp(phi + δ) = exp(J δ) exp(phi)` to first order; also the mean of `exp(u phi)` over `u` in
/// `[0, 1]`, which turns the translation part of a twist into a translation.
#[inline]
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let (cosc, third) = jacobian_coefficients(phi.norm_squared());
    let k = skew(phi);
    Matrix3::identity() + cosc * k + third * (k * k)
}

/// The inverse of [`left_jacobian`], defined for `|phi| < 2π`.
#[inline]
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let coefficient = inverse_jacobian_coefficient(phi.norm_squared());
    let k = skew(phi);
    Matrix3::identity() - 0.5 * k + coefficient * (k * k)
}

/// `left_jacobian(phi) * v`, without the matrix.
#[inline]
pub(crate) fn left_jacobian_times(phi: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let (cosc, third) = jacobian_coefficients(phi.norm_squared());
    let turned = phi.cross(v);
    v + cosc * turned + third * phi.cross(&turned)
}

/// `left_jacobian_inverse(phi) * v`, without the matrix.
#[inline]
pub(crate) fn left_jacobian_inverse_times(phi: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let turned = phi.cross(v);
    v - 0.5 * turned + inverse_jacobian_coefficient(phi.norm_squared()) * phi.cross(&turned)
}

/// The angle of the rotation that takes `a` to `b`, in `[0, π]`.
#[inline]
pub fn angle_between(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    log(&(b * a.inverse())).norm()
}
