//! Rigid motions with a change of scale, Sim(3): what monocular drift and loop closures are measured in.

use std::ops::Mul;

use nalgebra::{Matrix3, Matrix4, Quaternion, SVector, SymmetricEigen, UnitQuaternion, Vector3};

use crate::{Pose, so3};

/// Ten-point Gauss-Legendre rule on `[0, 1]`: abscissae and weights of the upper half; the rest by symmetry.
const GAUSS_LEGENDRE: [(f64, f64); 5] = [
    (0.148_874_338_981_631_22, 0.295_524_224_714_752_87),
    (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
    (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
    (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
    (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
];

/// A similarity `x ↦ s R x + t`.
///
/// Tangent vectors are `[rotation(3), translation(3), log scale]` and act on the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// `R`, as a unit quaternion.
    pub rotation: UnitQuaternion<f64>,
    /// `t`, in units of the target.
    pub translation: Vector3<f64>,
    /// `s > 0`, units of the target per unit of the source.
    pub scale: f64,
}

impl Default for Similarity {
    fn default() -> Self {
        Self::identity()
    }
}

impl Similarity {
    /// The similarity that moves nothing.
    #[inline]
    pub fn identity() -> Self {
        Self::from_pose(&Pose::identity())
    }

    /// The similarity `x ↦ scale rotation x + translation`.
    #[inline]
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>, scale: f64) -> Self {
        Self { rotation, translation, scale }
    }

    /// The rigid motion `pose` as a similarity of scale one.
    #[inline]
    pub fn from_pose(pose: &Pose) -> Self {
        Self { rotation: pose.rotation, translation: pose.translation, scale: 1.0 }
    }

    /// The exponential of `[rotation(3), translation(3), log scale]`.
    pub fn exp(delta: &SVector<f64, 7>) -> Self {
        let phi = Vector3::new(delta[0], delta[1], delta[2]);
        let rho = Vector3::new(delta[3], delta[4], delta[5]);
        Self {
            rotation: so3::exp(&phi),
            translation: mean_scaled_rotation(&phi, delta[6]) * rho,
            scale: delta[6].exp(),
        }
    }

    /// The tangent vector of which this is the exponential, its rotation at most π.
    pub fn log(&self) -> SVector<f64, 7> {
        let phi = so3::log(&self.rotation);
        let sigma = self.scale.ln();
        // The mean is invertible wherever |phi| < 2π, so this only fails on numbers that are not finite.
        let rho = mean_scaled_rotation(&phi, sigma)
            .try_inverse()
            .map_or_else(|| Vector3::repeat(f64::NAN), |inverse| inverse * self.translation);
        SVector::from([phi.x, phi.y, phi.z, rho.x, rho.y, rho.z, sigma])
    }

    /// The similarity back.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self { rotation, translation: -scale * (rotation * self.translation), scale }
    }

    /// `s R point + t`.
    #[inline]
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.scale * (self.rotation * point) + self.translation
    }

    /// `exp(delta) * self`, with the quaternion brought back to unit length.
    pub fn retract(&self, delta: &SVector<f64, 7>) -> Self {
        let mut moved = Self::exp(delta) * *self;
        moved.rotation.renormalize();
        moved
    }

    /// The `delta` with `self.retract(delta) == other`.
    pub fn local(&self, other: &Self) -> SVector<f64, 7> {
        (*other * self.inverse()).log()
    }

    /// The rigid motion with the same rotation and center, expressed in the units of the source: if this is a
    /// `camera_from_world` whose camera frame is in other units than the world, the result is the same
    /// camera in world units.
    #[inline]
    pub fn pose_part(&self) -> Pose {
        Pose { rotation: self.rotation, translation: self.translation / self.scale }
    }

    /// Whether every number in it is finite and the scale positive.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.scale.is_finite() && self.scale > 0.0 && Pose::new(self.rotation, self.translation).is_finite()
    }

    /// The similarity, or with `with_scale == false` the rigid motion, that brings the points `source`
    /// closest to `target` in the sense of least squares [Horn 1987].
    ///
    /// The slices pair up by index. `None` if there are fewer than three pairs, the slices differ in length,
    /// the points lie on one line, so that the rotation about it is free, or anything is not finite.
    pub fn from_correspondences(
        source: &[Vector3<f64>],
        target: &[Vector3<f64>],
        with_scale: bool,
    ) -> Option<Self> {
        if source.len() != target.len() || source.len() < 3 {
            return None;
        }
        let n = source.len() as f64;
        let source_mean = source.iter().sum::<Vector3<f64>>() / n;
        let target_mean = target.iter().sum::<Vector3<f64>>() / n;
        let mut correlation = Matrix3::zeros();
        let (mut source_spread, mut target_spread) = (0.0, 0.0);
        for (a, b) in source.iter().zip(target) {
            let (a, b) = (a - source_mean, b - target_mean);
            correlation += a * b.transpose();
            source_spread += a.norm_squared();
            target_spread += b.norm_squared();
        }
        let rotation = horn_rotation(&correlation, (source_spread * target_spread).sqrt())?;
        let scale = if with_scale {
            (rotation.to_rotation_matrix().matrix() * correlation).trace() / source_spread
        } else {
            1.0
        };
        let translation = target_mean - scale * (rotation * source_mean);
        let result = Self { rotation, translation, scale };
        result.is_finite().then_some(result)
    }
}

impl Mul for Similarity {
    type Output = Similarity;

    #[inline]
    fn mul(self, source: Similarity) -> Similarity {
        Similarity {
            rotation: self.rotation * source.rotation,
            translation: self.transform(&source.translation),
            scale: self.scale * source.scale,
        }
    }
}

impl Mul<Vector3<f64>> for Similarity {
    type Output = Vector3<f64>;

    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.transform(&point)
    }
}

/// `∫ exp(σu) exp(u φ) du` over `u` in `[0, 1]`: what the translation part of a tangent vector is multiplied
/// by.
///
/// The closed form is `0 / 0` where the rotation, the scale or both vanish, each in its own way. The
/// integrand is entire, so Gauss-Legendre quadrature is exact to rounding everywhere: with ten nodes its
/// error is below `1e-17` while `|σ + iθ| <= 4`, and longer intervals are cut.
fn mean_scaled_rotation(phi: &Vector3<f64>, sigma: f64) -> Matrix3<f64> {
    let theta2 = phi.norm_squared();
    let extent = (theta2 + sigma * sigma).sqrt();
    // exp overflows beyond |σ| = 710: no finite similarity needs more panels than this.
    let n_panels = if extent.is_finite() { (extent / 4.0).ceil().clamp(1.0, 256.0) } else { 1.0 };
    let half_width = 0.5 / n_panels;
    let (mut constant, mut linear, mut quadratic) = (0.0, 0.0, 0.0);
    for panel in 0..n_panels as usize {
        let middle = (panel as f64 + 0.5) / n_panels;
        for (abscissa, weight) in GAUSS_LEGENDRE {
            for u in [middle - half_width * abscissa, middle + half_width * abscissa] {
                let (sinc, cosc) = so3::sinc_and_cosc(theta2 * u * u);
                let scaled_weight = half_width * weight * (sigma * u).exp();
                constant += scaled_weight;
                linear += scaled_weight * u * sinc;
                quadratic += scaled_weight * u * u * cosc;
            }
        }
    }
    let k = so3::skew(phi);
    constant * Matrix3::identity() + linear * k + quadratic * (k * k)
}

/// The rotation `R` that maximizes `Σ b · R a` for `correlation = Σ a bᵀ`: the eigenvector of the largest
/// eigenvalue of Horn's quaternion matrix. `None` if it is not unique: the points lie on a line.
fn horn_rotation(correlation: &Matrix3<f64>, magnitude: f64) -> Option<UnitQuaternion<f64>> {
    /// Least gap between the two largest eigenvalues, relative to the spread of the points.
    const MIN_RELATIVE_GAP: f64 = 1e-9;
    let c = correlation;
    if !(magnitude.is_finite() && magnitude > 0.0 && c.iter().all(|x| x.is_finite())) {
        return None;
    }
    let delta = Vector3::new(c[(1, 2)] - c[(2, 1)], c[(2, 0)] - c[(0, 2)], c[(0, 1)] - c[(1, 0)]) / magnitude;
    let trace = c.trace() / magnitude;
    let symmetric = (c + c.transpose()) / magnitude - Matrix3::from_diagonal_element(trace);
    // Rows and columns in the order w, x, y, z.
    let mut matrix = Matrix4::zeros();
    matrix[(0, 0)] = trace;
    for i in 0..3 {
        matrix[(0, i + 1)] = delta[i];
        matrix[(i + 1, 0)] = delta[i];
    }
    matrix.fixed_view_mut::<3, 3>(1, 1).copy_from(&symmetric);
    let eigen = SymmetricEigen::new(matrix);
    let best = eigen.eigenvalues.imax();
    let runner_up =
        (0..4).filter(|i| *i != best).map(|i| eigen.eigenvalues[i]).fold(f64::NEG_INFINITY, f64::max);
    if eigen.eigenvalues[best] - runner_up < MIN_RELATIVE_GAP {
        return None;
    }
    let q = eigen.eigenvectors.column(best);
    Some(UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3])))
}
