//! Non-linear refinement of a vanishing point: from a rough direction and the segments that accept it to a
//! direction with its covariance.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};

use super::plane::SegmentPlane;

/// Rounds of reweighting per fit: weights depend on the direction, and change little after two rounds.
const N_ROUNDS: usize = 4;
/// Where Cauchy's weight has fallen to a half, standard deviations: 95 % efficient under Gaussian noise.
const CAUCHY_SCALE: f64 = 2.385;
/// Normals must spread this many times wider (variance) than their noise alone makes them. Below, the
/// segments are as good as one image line and leave the direction along it open.
const MIN_SPREAD_TO_NOISE: f64 = 4.0;

/// A direction fitted to segments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Unit.
    pub direction: Vector3<f64>,
    /// Rank 2, zero along the direction.
    pub covariance: Matrix3<f64>,
}

impl Fit {
    /// Standard deviation along the worst determined tangent, radians.
    pub fn worst_sigma(&self) -> f64 {
        // Of a rank 2 matrix the trace is the sum of the two eigenvalues, the sum of the principal minors
        // their product.
        let c = &self.covariance;
        let minor = |i: usize, j: usize| c[(i, i)] * c[(j, j)] - c[(i, j)] * c[(j, i)];
        let (half_sum, product) = (c.trace() / 2.0, minor(0, 1) + minor(0, 2) + minor(1, 2));
        (half_sum + (half_sum * half_sum - product).max(0.0).sqrt()).sqrt()
    }
}

/// The direction of parallel lines that segments show, unit, with its covariance of rank 2, from a rough one.
/// `None` if they do not determine it.
pub fn fit_direction(
    segments: &[SegmentPlane],
    rough: &Vector3<f64>,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let Fit { direction, covariance } = fit(segments.iter(), rough)?;
    let sign = if direction.dot(rough) < 0.0 { -1.0 } else { 1.0 };
    Some((direction * sign, covariance))
}

/// Weighted sums over segments, for one direction.
struct Moments {
    /// `sum w m m^T`: the information in the normals, noise and all.
    normals: Matrix3<f64>,
    /// `sum w cov(m)`: what noise adds to it on average.
    noise: Matrix3<f64>,
}

impl Moments {
    fn of<'a>(planes: impl Iterator<Item = &'a SegmentPlane>, direction: &Vector3<f64>) -> Self {
        let mut moments = Self { normals: Matrix3::zeros(), noise: Matrix3::zeros() };
        for plane in planes {
            let variance = plane.variance(direction);
            let deviation2 = plane.residual(direction).powi(2) / variance;
            let weight = 1.0 / (variance * (1.0 + deviation2 / (CAUCHY_SCALE * CAUCHY_SCALE)));
            moments.normals += plane.normal() * plane.normal().transpose() * weight;
            moments.noise += plane.normal_covariance() * weight;
        }
        moments
    }

    /// The information without what noise adds, for noise as strong as the residuals show, but no stronger
    /// than stated. [Kanatani, "Renormalization for unbiased estimation", ICCV 1993]
    fn without_noise(&self, direction: &Vector3<f64>) -> Matrix3<f64> {
        let observed = direction.dot(&(self.normals * direction));
        let expected = direction.dot(&(self.noise * direction));
        self.normals - self.noise * (observed / expected).min(1.0)
    }

    fn determines(&self, basis: &Matrix3x2<f64>) -> bool {
        let information = basis.transpose() * self.normals * basis;
        let eigen = information.symmetric_eigen();
        let weakest = basis * eigen.eigenvectors.column(eigen.eigenvalues.imin());
        eigen.eigenvalues.min() > MIN_SPREAD_TO_NOISE * weakest.dot(&(self.noise * weakest))
    }
}

/// The direction nearest to lying in all planes: `argmin sum w (m · d)²`, `w` the inverse variance of the
/// residual times Cauchy's weight, by Gauss-Newton steps on the sphere from `start`.
///
/// `None` if the segments leave the direction undetermined.
pub(super) fn fit<'a>(
    planes: impl Iterator<Item = &'a SegmentPlane> + Clone,
    start: &Vector3<f64>,
) -> Option<Fit> {
    let mut direction = *start;
    for _ in 0..N_ROUNDS {
        let moments = Moments::of(planes.clone(), &direction);
        let basis = tangent_basis(&direction);
        if !moments.determines(&basis) {
            return None;
        }
        let information = moments.without_noise(&direction);
        let step = inverse(&(basis.transpose() * information * basis))?
            * (basis.transpose() * (information * direction));
        direction = (direction - basis * step).try_normalize(0.0)?;
    }
    let basis = tangent_basis(&direction);
    let information = Moments::of(planes, &direction).without_noise(&direction);
    let covariance = basis * inverse(&(basis.transpose() * information * basis))? * basis.transpose();
    let is_finite = direction.iter().chain(&covariance).all(|x| x.is_finite());
    is_finite.then_some(Fit { direction, covariance })
}

/// The inverse of a positive definite matrix.
fn inverse(matrix: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    (matrix[(0, 0)] > 0.0 && matrix.determinant() > 0.0).then(|| matrix.try_inverse())?
}

/// Two unit vectors orthogonal to a unit vector and to one another.
fn tangent_basis(direction: &Vector3<f64>) -> Matrix3x2<f64> {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    let first = direction.cross(&axis).normalize();
    Matrix3x2::from_columns(&[first, direction.cross(&first)])
}

/// Whether two fitted directions differ by no more than `n_sigma` of their common uncertainty along the way
/// from one to the other.
pub(super) fn may_be_same(a: &Fit, b: &Fit, n_sigma: f64) -> bool {
    let sign = if a.direction.dot(&b.direction) < 0.0 { -1.0 } else { 1.0 };
    let difference = a.direction * sign - b.direction;
    // For a unit vector u along the difference: |difference|² <= n² u^T C u.
    let spread = difference.dot(&((a.covariance + b.covariance) * difference));
    difference.norm_squared().powi(2) <= n_sigma * n_sigma * spread
}

/// The sine of the angle between two unit axes.
#[inline]
pub(super) fn sin_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm()
}

/// Fixes the sign of an axis: its last component that is not zero is positive.
pub(super) fn with_fixed_sign(direction: &Vector3<f64>) -> Vector3<f64> {
    let leading = direction.iter().rev().find(|x| **x != 0.0).copied().unwrap_or(0.0);
    if leading < 0.0 { -direction } else { *direction }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(along: &Vector3<f64>, through: &Vector3<f64>) -> SegmentPlane {
        SegmentPlane::from_rays(&(through - along * 0.3), &(through + along * 0.3), 1e-3).unwrap()
    }

    #[test]
    fn the_worst_tangent_is_found() {
        let turned = nalgebra::Rotation3::from_euler_angles(0.3, -0.7, 1.1);
        let covariance =
            turned * Matrix3::from_diagonal(&Vector3::new(4.0, 9.0, 0.0)) * turned.inverse().matrix();
        let fit = Fit { direction: turned * Vector3::z(), covariance };
        assert!((fit.worst_sigma() - 3.0).abs() < 1e-9);
    }

    #[test]
    fn exact_segments_give_the_exact_direction() {
        let direction = Vector3::new(0.5, -0.2, 0.6).normalize();
        let planes: Vec<_> = [(-1.0, 0.3), (0.4, -0.8), (0.9, 1.0)]
            .map(|(x, y)| Vector3::new(x, y, 4.0))
            .iter()
            .map(|through| plane(&direction, through))
            .collect();
        let start = (direction + Vector3::new(0.02, -0.01, 0.01)).normalize();
        let fit = fit(planes.iter(), &start).unwrap();
        assert!(sin_between(&fit.direction, &direction) < 1e-9);
        assert!((fit.covariance * fit.direction).norm() < 1e-12);
    }

    #[test]
    fn pieces_of_one_line_determine_nothing() {
        let direction = Vector3::x();
        let planes: Vec<_> =
            [-2.0, -1.0, 0.0, 1.0, 2.0].map(|x| plane(&direction, &Vector3::new(x, 0.5, 4.0))).to_vec();
        assert!(fit(planes.iter(), &direction).is_none());
    }
}
