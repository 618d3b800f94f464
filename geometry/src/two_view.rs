//! What two views of one scene have in common: fundamental and essential matrices, homographies, and the
//! motions they stand for.
//!
//! Matrices go from view *a* to view *b*: `bᵀ F a = 0` and `b ∼ H a`. Motions are `b_from_a`, `X_b = R X_a +
//! t`.

mod decomposition;
mod five_point;
mod linear;

pub use decomposition::{decompose_essential, decompose_homography};
pub use five_point::essential_five_point;
pub use linear::{fundamental_eight_point, homography_four_point};

use nalgebra::{Matrix3, SymmetricEigen, UnitQuaternion, Vector2, Vector3};

/// Squared distances of `a` and `b` from the epipolar lines of each other: in image a, in image b. Infinite
/// or not a number at an epipole.
#[inline]
pub fn squared_epipolar_distances(b_from_a: &Matrix3<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> (f64, f64) {
    let (a, b) = (a.push(1.0), b.push(1.0));
    let line_in_b = b_from_a * a;
    let line_in_a = b_from_a.tr_mul(&b);
    let algebraic2 = b.dot(&line_in_b).powi(2);
    (algebraic2 / line_in_a.xy().norm_squared(), algebraic2 / line_in_b.xy().norm_squared())
}

/// To first order, the squared distance by which `a` and `b` together must move to satisfy `bᵀ F a = 0`
/// [Sampson 1982].
#[inline]
pub fn squared_sampson_distance(b_from_a: &Matrix3<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let (a, b) = (a.push(1.0), b.push(1.0));
    let line_in_b = b_from_a * a;
    let line_in_a = b_from_a.tr_mul(&b);
    b.dot(&line_in_b).powi(2) / (line_in_a.xy().norm_squared() + line_in_b.xy().norm_squared())
}

/// The squared distance from `b` to where the homography takes `a`; infinite if that is at infinity.
#[inline]
pub fn squared_transfer_error(b_from_a: &Matrix3<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let moved = b_from_a * a.push(1.0);
    let error = (moved.xy() / moved.z - b).norm_squared();
    if error.is_nan() { f64::INFINITY } else { error }
}

/// The transfer errors of a homography in image a, by its inverse, and in image b. Their sum is the symmetric
/// transfer error.
#[inline]
pub fn squared_transfer_errors(
    b_from_a: &Matrix3<f64>,
    a_from_b: &Matrix3<f64>,
    a: &Vector2<f64>,
    b: &Vector2<f64>,
) -> (f64, f64) {
    (squared_transfer_error(a_from_b, b, a), squared_transfer_error(b_from_a, a, b))
}

/// The unit direction of the translation of `b_from_a` when its rotation is known, from two or more pairs of
/// unit bearings. Its sign is the one that puts most points in front of both cameras.
///
/// `None` if the slices differ in length or are shorter than two, or no direction is determined: too little
/// parallax, or all points on one epipolar line.
pub fn two_point_with_known_rotation(
    b_from_a_rotation: &UnitQuaternion<f64>,
    bearings_a: &[Vector3<f64>],
    bearings_b: &[Vector3<f64>],
) -> Option<Vector3<f64>> {
    /// The translation is undetermined when the second smallest singular value of the unit epipolar normals
    /// is below this.
    const MIN_SINGULAR_VALUE: f64 = 1e-6;
    if bearings_a.len() != bearings_b.len() || bearings_a.len() < 2 {
        return None;
    }
    // t is orthogonal to R a × b for each pair. Left at their length, the sine of the parallax, so that far
    // points, whose normals are noise, count little.
    let mut normal_matrix = Matrix3::zeros();
    for (a, b) in bearings_a.iter().zip(bearings_b) {
        let normal = (b_from_a_rotation * a).cross(b);
        normal_matrix += normal * normal.transpose();
    }
    let total = normal_matrix.trace();
    if !(total.is_finite() && total > 0.0) {
        return None;
    }
    let eigen = SymmetricEigen::new(normal_matrix / total);
    let smallest = eigen.eigenvalues.imin();
    let middle = eigen.eigenvalues.sum() - eigen.eigenvalues.max() - eigen.eigenvalues.min();
    if middle < MIN_SINGULAR_VALUE * MIN_SINGULAR_VALUE {
        return None;
    }
    let t = eigen.eigenvectors.column(smallest).into_owned();
    let votes: f64 = bearings_a
        .iter()
        .zip(bearings_b)
        .map(|(a, b)| {
            // depth_b b = depth_a R a + t, crossed with one ray or the other.
            let rotated = b_from_a_rotation * a;
            let normal = b.cross(&rotated);
            let depth_a = t.cross(b).dot(&normal);
            let depth_b = t.cross(&rotated).dot(&normal);
            depth_a.signum() + depth_b.signum()
        })
        .sum();
    Some(if votes < 0.0 { -t } else { t })
}
