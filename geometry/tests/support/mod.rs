//! Random scenes and numeric derivatives for the tests of this crate.
#![allow(dead_code, reason = "each test binary uses its own part")]

use geometry::nalgebra::{SMatrix, SVector, Vector2, Vector3};
use geometry::{Pose, so3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Generators whose seeds derive from the name of the test; the index is for messages.
pub fn generators(test: &str, n: u64) -> impl Iterator<Item = (u64, ChaCha8Rng)> {
    // FNV-1a.
    let base = test.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    (0..n).map(move |i| (i, ChaCha8Rng::seed_from_u64(base.wrapping_add(i))))
}

/// A vector with entries uniform in `[-extent, extent]`.
pub fn uniform<const N: usize>(rng: &mut impl Rng, extent: f64) -> SVector<f64, N> {
    SVector::from_fn(|_, _| rng.random_range(-extent..=extent))
}

pub fn unit_vector(rng: &mut impl Rng) -> Vector3<f64> {
    loop {
        let v: Vector3<f64> = uniform(rng, 1.0);
        if (0.01..1.0).contains(&v.norm()) {
            return v.normalize();
        }
    }
}

/// A pose turned by up to `max_angle` about any axis, with a translation within `extent`.
pub fn pose(rng: &mut impl Rng, max_angle: f64, extent: f64) -> Pose {
    let phi = unit_vector(rng) * rng.random_range(0.0..max_angle);
    Pose::new(so3::exp(&phi), uniform(rng, extent))
}

/// A point in front of a camera, inside a field of about 80 degrees, 2 to 8 units away.
pub fn point_in_view(rng: &mut impl Rng) -> Vector3<f64> {
    let depth = rng.random_range(2.0..8.0);
    let p: Vector2<f64> = uniform(rng, 0.6);
    Vector3::new(p.x * depth, p.y * depth, depth)
}

/// Central differences with step `h`.
pub fn numeric_jacobian<const M: usize, const N: usize>(
    f: impl Fn(&SVector<f64, N>) -> SVector<f64, M>,
    at: &SVector<f64, N>,
    h: f64,
) -> SMatrix<f64, M, N> {
    let mut jacobian = SMatrix::<f64, M, N>::zeros();
    for column in 0..N {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = h;
        jacobian.set_column(column, &((f(&(at + step)) - f(&(at - step))) / (2.0 * h)));
    }
    jacobian
}

/// Asserts that two matrices differ by at most `tolerance` relative to the second's largest entry (at least
/// one).
#[track_caller]
pub fn assert_close<const M: usize, const N: usize>(
    found: &SMatrix<f64, M, N>,
    expected: &SMatrix<f64, M, N>,
    tolerance: f64,
    context: &str,
) {
    let error = (found - expected).amax() / expected.amax().max(1.0);
    assert!(
        error <= tolerance,
        "{context}: error {error:e} > {tolerance:e}\nfound {found}expected {expected}"
    );
}

/// Angle and distance between two poses.
pub fn pose_error(a: &Pose, b: &Pose) -> f64 {
    so3::angle_between(&a.rotation, &b.rotation).max((a.translation - b.translation).norm())
}
