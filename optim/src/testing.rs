//! Checks for factors and manifolds, to be called from tests.

use crate::factor::{Factor, Residual};
use crate::manifold::{Manifold, Tangent};
use crate::wiring::{Variables, Wiring};

/// Asserts that a factor's derivatives agree with central differences of its residual at `values`.
///
/// `step` is the step in each tangent direction (1e-6 is usual); the largest deviation of a member's matrix
/// may be `relative_error` times its largest entry, or times one if that is smaller (1e-5 is usual).
///
/// # Panics
/// When they do not agree, when `linearize` gives another residual than `residual`, when an entry is not
/// finite, or when the factor cannot be evaluated at or around `values`.
#[track_caller]
pub fn assert_jacobians_match<F: Factor>(factor: &F, values: &F::Variables, step: f64, relative_error: f64) {
    let (residual, jacobians) = factor.linearize(values.refs()).expect("the factor can be linearised here");
    let plain = factor.residual(values.refs()).expect("the factor can be evaluated here");
    for (a, b) in residual.entries().iter().zip(plain.entries()) {
        assert!((a - b).abs() <= 1e-12 * (1.0 + b.abs()), "linearize gives residual {a}, residual gives {b}");
    }
    let rows = F::Residual::DIM;
    for (member, dim) in F::Variables::dims().into_iter().take(F::Variables::ARITY).enumerate() {
        let analytic = F::Variables::jacobian_entries(&jacobians, member);
        let scale = analytic.iter().fold(1.0, |max: f64, entry| max.max(entry.abs()));
        for axis in 0..dim {
            let at = |step: f64| {
                let moved = values.perturbed(member, axis, step);
                factor.residual(moved.refs()).expect("the factor can be evaluated around here")
            };
            let (ahead, behind) = (at(step), at(-step));
            for row in 0..rows {
                let numeric = (ahead.entries()[row] - behind.entries()[row]) / (2.0 * step);
                let analytic = analytic[axis * rows + row];
                let error = (numeric - analytic).abs() / scale;
                assert!(
                    error <= relative_error,
                    "variable {member}, d r[{row}] / d δ[{axis}]: analytic {analytic}, numeric {numeric}, \
                     relative error {error:e}"
                );
            }
        }
    }
}

/// Asserts the laws of [`Manifold`] at `x` for the tangent vector `delta` (shorter than the manifold's
/// injectivity radius), within `tolerance` in tangent units.
///
/// # Panics
/// When a law is broken or a number is not finite.
#[track_caller]
pub fn assert_manifold_laws<T: Manifold>(x: &T, delta: &T::Tangent, tolerance: f64) {
    let zero = vec![0.0; T::DIM];
    let unmoved = x.retract(&T::Tangent::from_slice(&zero));
    assert_close(x.local(&unmoved).as_slice(), &zero, tolerance, "x.local(x.retract(0)) = 0");
    let y = x.retract(delta);
    assert_close(x.local(&y).as_slice(), delta.as_slice(), tolerance, "x.local(x.retract(δ)) = δ");
    let again = x.retract(&x.local(&y));
    assert_close(y.local(&again).as_slice(), &zero, tolerance, "x.retract(x.local(y)) = y");
    let back: Vec<f64> = y.local(x).as_slice().iter().map(|entry| -entry).collect();
    let longest = |values: &[f64]| values.iter().map(|entry| entry * entry).sum::<f64>().sqrt();
    let (there, back) = (longest(delta.as_slice()), longest(&back));
    assert!(
        back <= 10.0 * there + tolerance,
        "the way back, {back}, is much longer than the way there, {there}"
    );
}

#[track_caller]
fn assert_close(got: &[f64], expected: &[f64], tolerance: f64, law: &str) {
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() <= tolerance, "{law}: {got} instead of {expected}");
    }
}
