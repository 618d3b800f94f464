//! Lenses described by spheres: the extended unified and the double-sphere model, which show more than 180
//! degrees.

use nalgebra::{Matrix2x3, RowVector3, Vector2, Vector3};

/// What a point is divided by to get to the distorted plane, with its derivatives.
struct Divisor {
    value: f64,
    by_point: RowVector3<f64>,
    /// By the model's two coefficients.
    by_coefficients: [f64; 2],
}

impl Divisor {
    #[inline]
    fn divide(&self, point: &Vector3<f64>) -> Vector2<f64> {
        point.xy() / self.value
    }

    #[inline]
    fn jacobian(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        let inverse = 1.0 / self.value;
        Matrix2x3::new(inverse, 0.0, 0.0, 0.0, inverse, 0.0) - self.divide(point) * self.by_point * inverse
    }

    #[inline]
    fn by_coefficient(&self, point: &Vector3<f64>, idx: usize) -> Vector2<f64> {
        self.divide(point) * (-self.by_coefficients[idx] / self.value)
    }
}

/// The extended unified camera model [Khomutenko, Garcia & Martinet 2016]:
/// `p = (x, y) / (α d + (1 - α) z)`, `d² = β (x² + y²) + z²`. With `β = 1` the unified model of Mei, whose
/// `ξ` is `α / (1 - α)`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ExtendedUnified {
    alpha: f64,
    beta: f64,
}

impl ExtendedUnified {
    #[inline]
    fn divisor(&self, point: &Vector3<f64>) -> Divisor {
        let Self { alpha, beta } = *self;
        let rho2 = point.xy().norm_squared();
        let d = (beta * rho2 + point.z * point.z).sqrt();
        let by_point = RowVector3::new(beta * point.x, beta * point.y, point.z) * (alpha / d)
            + RowVector3::new(0.0, 0.0, 1.0 - alpha);
        let by_coefficients = [d - point.z, 0.5 * alpha * rho2 / d];
        Divisor { value: alpha * d + (1.0 - alpha) * point.z, by_point, by_coefficients }
    }

    /// Up to which angle from the axis points have an image of their own.
    fn limit(&self) -> f64 {
        // There z = -w d with d² = β ρ² + z², so ρ / |z| = sqrt((1 / w² - 1) / β).
        let w = if self.alpha > 0.5 { 1.0 / self.alpha - 1.0 } else { self.alpha / (1.0 - self.alpha) };
        ((1.0 - w * w).max(0.0) / self.beta).sqrt().atan2(-w)
    }

    #[inline]
    fn unproject(&self, distorted: &Vector2<f64>) -> Option<Vector3<f64>> {
        let Self { alpha, beta } = *self;
        let r2 = distorted.norm_squared();
        let inside = 1.0 - (2.0 * alpha - 1.0) * beta * r2;
        let z = (1.0 - beta * alpha * alpha * r2) / (alpha * inside.max(0.0).sqrt() + 1.0 - alpha);
        (inside >= 0.0).then(|| distorted.push(z))
    }
}

/// The double-sphere model [Usenko, Demmel & Cremers 2018]: `p = (x, y) / (α d₂ + (1 - α) (ξ d₁ + z))`, where
/// `d₁` is the length of the point and `d₂` that of `(x, y, ξ d₁ + z)`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct DoubleSphere {
    xi: f64,
    alpha: f64,
}

impl DoubleSphere {
    #[inline]
    fn divisor(&self, point: &Vector3<f64>) -> Divisor {
        let Self { xi, alpha } = *self;
        let d1 = point.norm();
        let shifted = xi * d1 + point.z;
        let d2 = (point.xy().norm_squared() + shifted * shifted).sqrt();
        let d_shifted = point.transpose() * (xi / d1) + RowVector3::new(0.0, 0.0, 1.0);
        let d_d2 = (RowVector3::new(point.x, point.y, 0.0) + d_shifted * shifted) / d2;
        let by_xi = alpha * shifted * d1 / d2 + (1.0 - alpha) * d1;
        Divisor {
            value: alpha * d2 + (1.0 - alpha) * shifted,
            by_point: d_d2 * alpha + d_shifted * (1.0 - alpha),
            by_coefficients: [by_xi, d2 - shifted],
        }
    }

    fn limit(&self) -> f64 {
        let Self { xi, alpha } = *self;
        let w1 = if alpha > 0.5 { (1.0 - alpha) / alpha } else { alpha / (1.0 - alpha) };
        let w2 = (w1 + xi) / (2.0 * w1 * xi + xi * xi + 1.0).max(f64::MIN_POSITIVE).sqrt();
        (-w2).clamp(-1.0, 1.0).acos()
    }

    #[inline]
    fn unproject(&self, distorted: &Vector2<f64>) -> Option<Vector3<f64>> {
        let Self { xi, alpha } = *self;
        let r2 = distorted.norm_squared();
        let inside = 1.0 - (2.0 * alpha - 1.0) * r2;
        if inside < 0.0 {
            return None;
        }
        let z = (1.0 - alpha * alpha * r2) / (alpha * inside.sqrt() + 1.0 - alpha);
        let root = z * z + (1.0 - xi * xi) * r2;
        let scale = (z * xi + root.max(0.0).sqrt()) / (z * z + r2);
        (root >= 0.0).then(|| distorted.push(z) * scale - Vector3::new(0.0, 0.0, xi))
    }
}

/// Either of the two.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Model {
    ExtendedUnified(ExtendedUnified),
    DoubleSphere(DoubleSphere),
}

/// A lens of one of these models, used as far as it is one-to-one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SphereLens {
    model: Model,
    /// The angle from the axis up to which it is, and its cosine.
    limit: f64,
    least_cosine: f64,
}

impl SphereLens {
    /// The extended unified model with coefficients `α β`, of which `α` lies in 0 to 1 and `β` above 0.
    pub(crate) fn extended_unified(coefficients: &[f64]) -> Self {
        let lens = ExtendedUnified { alpha: coefficients[0], beta: coefficients[1] };
        Self::new(Model::ExtendedUnified(lens), lens.limit())
    }

    /// The double-sphere model with coefficients `ξ α`, of which `ξ` lies in -1 to 1 and `α` in 0 to 1.
    pub(crate) fn double_sphere(coefficients: &[f64]) -> Self {
        let lens = DoubleSphere { xi: coefficients[0], alpha: coefficients[1] };
        Self::new(Model::DoubleSphere(lens), lens.limit())
    }

    fn new(model: Model, limit: f64) -> Self {
        Self { model, limit, least_cosine: limit.cos() }
    }

    #[inline]
    fn divisor(&self, point: &Vector3<f64>) -> Divisor {
        match &self.model {
            Model::ExtendedUnified(lens) => lens.divisor(point),
            Model::DoubleSphere(lens) => lens.divisor(point),
        }
    }

    /// The angle from the axis up to which the model is one-to-one.
    pub(crate) fn limit(&self) -> f64 {
        self.limit
    }

    #[inline]
    pub(crate) fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.divisor_inside(point).map(|divisor| divisor.divide(point))
    }

    #[inline]
    pub(crate) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let divisor = self.divisor_inside(point)?;
        Some((divisor.divide(point), divisor.jacobian(point)))
    }

    #[inline]
    fn divisor_inside(&self, point: &Vector3<f64>) -> Option<Divisor> {
        let length = point.norm();
        let is_inside = length > 0.0 && length.is_finite() && point.z > self.least_cosine * length;
        let divisor = self.divisor(point);
        (is_inside && divisor.value > 0.0).then_some(divisor)
    }

    /// The derivative of the projection by a coefficient, counted from 0.
    pub(crate) fn by_coefficient(&self, point: &Vector3<f64>, idx: usize) -> Vector2<f64> {
        self.divisor(point).by_coefficient(point, idx)
    }

    #[inline]
    pub(crate) fn unproject(&self, distorted: &Vector2<f64>) -> Option<Vector3<f64>> {
        let ray = match &self.model {
            Model::ExtendedUnified(lens) => lens.unproject(distorted)?,
            Model::DoubleSphere(lens) => lens.unproject(distorted)?,
        };
        let bearing = ray.try_normalize(0.0)?;
        let is_inside = bearing.z >= self.least_cosine && bearing.iter().all(|x| x.is_finite());
        is_inside.then_some(bearing)
    }
}
