//! How each lens model bends rays: maps between bearings and the *distorted plane*, which is the image before
//! focal lengths and principal point are applied.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use crate::CameraModel;
use crate::spheres::SphereLens;

/// Rounds of Newton's method before a point counts as not invertible. From the starting points used here four
/// to six reach rounding.
const MAX_NEWTON_ROUNDS: usize = 30;

/// Newton's method stops after a step below this, in the distorted plane. It converges quadratically, so what
/// is left then is the square of this, below rounding.
const NEWTON_TOLERANCE: f64 = 1e-8;

/// Steps in which the range of a radial function is searched for the place where it stops rising.
const MONOTONE_SCAN_STEPS: usize = 2000;

/// A radial function counts as rising while its slope exceeds this. Below it one pixel of the image would
/// cover a thousand of the undistorted one.
const MIN_RADIAL_SLOPE: f64 = 1e-3;

/// A function that stops rising is used only while its slope exceeds this: towards the fold a pixel's noise
/// grows without bound, and a polynomial that folds was not fitted there.
const MIN_SLOPE_BEFORE_FOLD: f64 = 0.1;

/// A lens model with its coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Distortion {
    None,
    Radtan(Radtan),
    KannalaBrandt(KannalaBrandt),
    Fov(Fov),
    Sphere(SphereLens),
}

impl Distortion {
    /// A model with checked coefficients. `max_angle` is the largest angle from the axis that will be asked
    /// for.
    pub(crate) fn new(model: CameraModel, coefficients: &[f64], max_angle: f64) -> Self {
        let d = coefficients;
        match model {
            CameraModel::Pinhole => Self::None,
            CameraModel::Radtan => Self::Radtan(Radtan::new(d, max_angle)),
            CameraModel::KannalaBrandt => Self::KannalaBrandt(KannalaBrandt::new([d[0], d[1], d[2], d[3]])),
            CameraModel::Fov => Self::Fov(Fov::new(d[0])),
            CameraModel::ExtendedUnified => Self::Sphere(SphereLens::extended_unified(d)),
            CameraModel::DoubleSphere => Self::Sphere(SphereLens::double_sphere(d)),
        }
    }

    /// The derivatives of [`project`](Self::project) by the coefficients, in their order, at a point where it
    /// is defined.
    pub(crate) fn by_coefficients(&self, point: &Vector3<f64>, n_coefficients: usize) -> Vec<Vector2<f64>> {
        (0..n_coefficients)
            .map(|idx| match self {
                Self::None => Vector2::zeros(),
                Self::Radtan(model) => model.by_coefficient(&(point.xy() / point.z), idx),
                Self::KannalaBrandt(_) => KannalaBrandt::by_coefficient(point, idx),
                Self::Fov(model) => model.by_coefficient(&(point.xy() / point.z)),
                Self::Sphere(lens) => lens.by_coefficient(point, idx),
            })
            .collect()
    }

    /// The point of the distorted plane where `point` (camera frame) is seen. `None` outside the field where
    /// the model is one-to-one.
    #[inline]
    pub(crate) fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        match self {
            Self::None => on_plane(point),
            Self::Radtan(model) => {
                let p = on_plane(point)?;
                (p.norm_squared() < model.limit * model.limit).then(|| model.distort(&p))
            }
            Self::KannalaBrandt(model) => model.project(point),
            Self::Fov(model) => Some(model.distort(&on_plane(point)?)),
            Self::Sphere(lens) => lens.project(point),
        }
    }

    /// As [`project`](Self::project), with the derivative by `point`.
    #[inline]
    pub(crate) fn project_with_jacobian(
        &self,
        point: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (distorted, d_distorted_d_plane, plane) = match self {
            Self::None => {
                let p = on_plane(point)?;
                (p, Matrix2::identity(), p)
            }
            Self::Radtan(model) => {
                let p = on_plane(point)?;
                if p.norm_squared() >= model.limit * model.limit {
                    return None;
                }
                (model.distort(&p), model.jacobian(&p), p)
            }
            Self::Fov(model) => {
                let p = on_plane(point)?;
                (model.distort(&p), model.jacobian(&p), p)
            }
            Self::KannalaBrandt(model) => return Some((model.project(point)?, model.jacobian(point))),
            Self::Sphere(lens) => return lens.project_with_jacobian(point),
        };
        let inverse_z = 1.0 / point.z;
        let d_plane_d_point =
            Matrix2x3::new(inverse_z, 0.0, -plane.x * inverse_z, 0.0, inverse_z, -plane.y * inverse_z);
        Some((distorted, d_distorted_d_plane * d_plane_d_point))
    }

    /// The unit vector seen at `distorted`, a point of the distorted plane. `None` outside the field where
    /// the model is one-to-one.
    #[inline]
    pub(crate) fn unproject(&self, distorted: &Vector2<f64>) -> Option<Vector3<f64>> {
        let plane = match self {
            Self::None => *distorted,
            Self::Radtan(model) => model.undistort(distorted)?,
            Self::Fov(model) => model.undistort(distorted)?,
            Self::KannalaBrandt(model) => return model.unproject(distorted),
            Self::Sphere(lens) => return lens.unproject(distorted),
        };
        let bearing = Vector3::new(plane.x, plane.y, 1.0).normalize();
        bearing.iter().all(|x| x.is_finite()).then_some(bearing)
    }

    /// The angle from the optical axis up to which the model is one-to-one.
    pub(crate) fn field_limit(&self) -> f64 {
        match self {
            Self::None | Self::Fov(_) => std::f64::consts::FRAC_PI_2,
            Self::Radtan(model) => model.limit.atan(),
            Self::KannalaBrandt(model) => model.limit,
            Self::Sphere(lens) => lens.limit(),
        }
    }
}

#[inline]
fn on_plane(point: &Vector3<f64>) -> Option<Vector2<f64>> {
    if point.z > 0.0 {
        let p = Vector2::new(point.x / point.z, point.y / point.z);
        (p.x.is_finite() && p.y.is_finite()).then_some(p)
    } else {
        None
    }
}

/// Up to where in `(0, end]` the function of slope `slope` can be used: to `end` if it rises that far, else
/// to a little before it stops.
fn rising_until(end: f64, slope: impl Fn(f64) -> f64) -> f64 {
    let limit = steeper_until(end, MIN_RADIAL_SLOPE, &slope);
    if limit < end { steeper_until(end, MIN_SLOPE_BEFORE_FOLD, &slope) } else { end }
}

/// Where in `(0, end]` the slope first falls to `least`, or `end` if it does not.
fn steeper_until(end: f64, least: f64, slope: &impl Fn(f64) -> f64) -> f64 {
    let rising = |x: f64| slope(x) > least;
    let step = end / MONOTONE_SCAN_STEPS as f64;
    let Some(first_bad) = (0..=MONOTONE_SCAN_STEPS).find(|i| !rising(*i as f64 * step)) else {
        return end;
    };
    if first_bad == 0 {
        return 0.0;
    }
    let (mut good, mut bad) = ((first_bad - 1) as f64 * step, first_bad as f64 * step);
    for _ in 0..50 {
        let middle = 0.5 * (good + bad);
        if rising(middle) { good = middle } else { bad = middle }
    }
    good
}

/// Solves `value(x) = target` for a function that rises over `[0, end]`, with `value(0) = 0`. Newton's
/// method, with a bisection step wherever Newton would leave the bracket.
#[inline]
fn invert_rising(target: f64, end: f64, value_and_slope: impl Fn(f64) -> (f64, f64)) -> Option<f64> {
    if !(target >= 0.0 && target <= value_and_slope(end).0) {
        return None;
    }
    let (mut low, mut high) = (0.0, end);
    let mut x = target.min(end);
    for _ in 0..MAX_NEWTON_ROUNDS {
        let (value, slope) = value_and_slope(x);
        let error = value - target;
        if error > 0.0 {
            high = x
        } else {
            low = x
        }
        let newton = x - error / slope;
        if newton >= low && newton <= high {
            let step = (newton - x).abs();
            x = newton;
            if step <= NEWTON_TOLERANCE {
                break;
            }
        } else {
            x = 0.5 * (low + high);
        }
    }
    Some(x)
}

/// Brown's model, with OpenCV's rational extension:
/// `p' = p (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + tangential(p1, p2)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Radtan {
    /// `k1, k2, k3`.
    numerator: [f64; 3],
    /// `k4, k5, k6`.
    denominator: [f64; 3],
    p1: f64,
    p2: f64,
    /// The radius in the plane `z = 1` up to which the radial part rises.
    limit: f64,
}

impl Radtan {
    /// `coefficients` in OpenCV's order `k1 k2 p1 p2 [k3 [k4 k5 k6]]`; those left out are zero. `max_angle`
    /// is the largest angle from the axis that will be asked for.
    pub(crate) fn new(coefficients: &[f64], max_angle: f64) -> Self {
        let c = |i: usize| coefficients.get(i).copied().unwrap_or(0.0);
        let mut model = Self {
            numerator: [c(0), c(1), c(4)],
            denominator: [c(5), c(6), c(7)],
            p1: c(2),
            p2: c(3),
            limit: max_angle.tan(),
        };
        model.limit = rising_until(model.limit, |r| model.radial_value_and_slope(r).1);
        model
    }

    /// The radial factor and its derivative by `r²`.
    #[inline]
    fn factor(&self, r2: f64) -> (f64, f64) {
        let [k1, k2, k3] = self.numerator;
        let [k4, k5, k6] = self.denominator;
        let top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let d_top = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let bottom = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let d_bottom = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let factor = top / bottom;
        (factor, (d_top - factor * d_bottom) / bottom)
    }

    #[inline]
    fn radial_value_and_slope(&self, r: f64) -> (f64, f64) {
        let r2 = r * r;
        let (factor, d_factor) = self.factor(r2);
        (r * factor, factor + 2.0 * r2 * d_factor)
    }

    #[inline]
    pub(crate) fn distort(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let (factor, _) = self.factor(r2);
        Vector2::new(
            x * factor + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * factor + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    #[inline]
    pub(crate) fn jacobian(&self, p: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (p.x, p.y);
        let (factor, d_factor) = self.factor(x * x + y * y);
        let cross = 2.0 * x * y * d_factor + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        Matrix2::new(
            factor + 2.0 * x * x * d_factor + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            cross,
            cross,
            factor + 2.0 * y * y * d_factor + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// The derivative of [`distort`](Self::distort) by a coefficient, counted in OpenCV's order.
    fn by_coefficient(&self, p: &Vector2<f64>, idx: usize) -> Vector2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = p.norm_squared();
        let [k4, k5, k6] = self.denominator;
        let bottom = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let factor = self.factor(r2).0;
        match idx {
            0 => p * (r2 / bottom),
            1 => p * (r2 * r2 / bottom),
            2 => Vector2::new(2.0 * x * y, r2 + 2.0 * y * y),
            3 => Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y),
            4 => p * (r2 * r2 * r2 / bottom),
            rational => p * (-factor * r2.powi(rational as i32 - 4) / bottom),
        }
    }

    /// Newton's method from a first guess, which nearly always converges; else from the safe inverse of the
    /// radial part. Within `limit` the model is one-to-one, so any solution found there is the solution.
    #[inline]
    pub(crate) fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let guess = distorted / self.factor(distorted.norm_squared()).0;
        self.newton(guess, distorted).or_else(|| self.newton(self.radial_inverse(distorted)?, distorted))
    }

    /// Where `p` of the plane `z = 1` is seen; beyond the limit as at its edge.
    #[inline]
    pub(crate) fn distort_anywhere(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let radius = p.norm();
        if radius <= self.limit { self.distort(p) } else { p * self.factor(self.limit * self.limit).0 }
    }

    /// Reverses [`distort_anywhere`](Self::distort_anywhere) for a model without tangential part.
    #[inline]
    pub(crate) fn undistort_anywhere(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        let at_edge = self.factor(self.limit * self.limit).0;
        if distorted.norm() >= self.limit * at_edge {
            return distorted / at_edge;
        }
        self.undistort(distorted).unwrap_or(distorted / at_edge)
    }

    /// The inverse without the tangential part.
    #[cold]
    fn radial_inverse(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = distorted.norm();
        let undistorted_radius = invert_rising(radius, self.limit, |r| self.radial_value_and_slope(r))?;
        Some(if radius > 0.0 { distorted * (undistorted_radius / radius) } else { *distorted })
    }

    #[inline]
    fn newton(&self, start: Vector2<f64>, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let limit2 = self.limit * self.limit;
        let mut p = start;
        for _ in 0..MAX_NEWTON_ROUNDS {
            let error = self.distort(&p) - distorted;
            let j = self.jacobian(&p);
            let determinant = j.determinant();
            // Also stops on numbers that are not finite.
            let inside = p.norm_squared() <= limit2 && determinant > 0.0;
            if !inside {
                return None;
            }
            let step = Vector2::new(
                (j.m22 * error.x - j.m12 * error.y) / determinant,
                (j.m11 * error.y - j.m21 * error.x) / determinant,
            );
            p -= step;
            if step.norm_squared() < NEWTON_TOLERANCE * NEWTON_TOLERANCE {
                return (p.norm_squared() < limit2).then_some(p);
            }
        }
        None
    }
}

/// The equidistant fisheye [Kannala & Brandt 2006], as in OpenCV's `fisheye`:
/// `r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, `θ` the angle from the axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct KannalaBrandt {
    k: [f64; 4],
    /// The angle up to which `r` rises.
    limit: f64,
}

impl KannalaBrandt {
    /// Angles above this are never used: the image of the point straight behind is a circle.
    const MAX_ANGLE: f64 = 3.0;

    pub(crate) fn new(k: [f64; 4]) -> Self {
        let mut model = Self { k, limit: Self::MAX_ANGLE };
        model.limit = rising_until(Self::MAX_ANGLE, |theta| model.radius_and_slope(theta).1);
        model
    }

    #[inline]
    fn radius_and_slope(&self, theta: f64) -> (f64, f64) {
        let [k1, k2, k3, k4] = self.k;
        let t = theta * theta;
        (
            theta * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4)))),
            1.0 + t * (3.0 * k1 + t * (5.0 * k2 + t * (7.0 * k3 + t * 9.0 * k4))),
        )
    }

    #[inline]
    fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let rho = point.x.hypot(point.y);
        let theta = rho.atan2(point.z);
        if !(theta < self.limit && point.norm_squared() > 0.0 && point.z.is_finite() && rho.is_finite()) {
            return None;
        }
        // Towards the axis r/ρ goes to 1/z.
        let scale = if rho < 1e-9 * point.z { 1.0 / point.z } else { self.radius_and_slope(theta).0 / rho };
        Some(Vector2::new(point.x * scale, point.y * scale))
    }

    /// The derivative of [`project`](Self::project) at a point where it is defined.
    #[inline]
    fn jacobian(&self, point: &Vector3<f64>) -> Matrix2x3<f64> {
        let (x, y, z) = (point.x, point.y, point.z);
        let rho2 = x * x + y * y;
        let rho = rho2.sqrt();
        if rho < 1e-9 * z {
            let inverse_z = 1.0 / z;
            let (u, v) = (x * inverse_z, y * inverse_z);
            return Matrix2x3::new(inverse_z, 0.0, -u * inverse_z, 0.0, inverse_z, -v * inverse_z);
        }
        let (radius, slope) = self.radius_and_slope(rho.atan2(z));
        let d2 = rho2 + z * z;
        // p = (x, y) r/ρ;  dθ/dρ = z/d²,  dθ/dz = -ρ/d².
        let scale = radius / rho;
        let d_scale_over_rho = (slope * z / d2 - scale) / rho2;
        let cross = x * y * d_scale_over_rho;
        Matrix2x3::new(
            scale + x * x * d_scale_over_rho,
            cross,
            -slope * x / d2,
            cross,
            scale + y * y * d_scale_over_rho,
            -slope * y / d2,
        )
    }

    /// The derivative of [`project`](Self::project) by a coefficient.
    fn by_coefficient(point: &Vector3<f64>, idx: usize) -> Vector2<f64> {
        let rho = point.xy().norm();
        if rho <= 0.0 {
            return Vector2::zeros();
        }
        point.xy() * (rho.atan2(point.z).powi(2 * idx as i32 + 3) / rho)
    }

    #[inline]
    fn unproject(&self, distorted: &Vector2<f64>) -> Option<Vector3<f64>> {
        let radius = distorted.norm();
        let theta = invert_rising(radius, self.limit, |theta| self.radius_and_slope(theta))?;
        let (sin, cos) = theta.sin_cos();
        let scale = if radius < 1e-12 { 1.0 } else { sin / radius };
        Some(Vector3::new(distorted.x * scale, distorted.y * scale, cos))
    }
}

/// The field-of-view model [Devernay & Faugeras 2001]: `r' = atan(2 r tan(ω/2)) / ω`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fov {
    omega: f64,
    /// `2 tan(ω/2)`.
    stretch: f64,
}

impl Fov {
    pub(crate) fn new(omega: f64) -> Self {
        Self { omega, stretch: 2.0 * (0.5 * omega).tan() }
    }

    /// `r'/r` and its derivative by `r`, divided by `r`.
    #[inline]
    fn factor(&self, r2: f64) -> (f64, f64) {
        let s = self.stretch;
        let a2 = s * s * r2;
        if a2 < 1e-6 {
            // atan(a)/a = 1 - a²/3 + a⁴/5.
            let base = s / self.omega;
            return (
                base * (1.0 - a2 / 3.0 * (1.0 - a2 * 0.6)),
                base * s * s * (-2.0 / 3.0 + a2 * (0.8 - a2 * 6.0 / 7.0)),
            );
        }
        let r = r2.sqrt();
        let distorted_radius = (s * r).atan() / self.omega;
        let slope = s / (self.omega * (1.0 + a2));
        (distorted_radius / r, (slope - distorted_radius / r) / r2)
    }

    #[inline]
    fn distort(&self, p: &Vector2<f64>) -> Vector2<f64> {
        p * self.factor(p.norm_squared()).0
    }

    #[inline]
    fn jacobian(&self, p: &Vector2<f64>) -> Matrix2<f64> {
        let (factor, d_factor_over_r) = self.factor(p.norm_squared());
        Matrix2::identity() * factor + p * p.transpose() * d_factor_over_r
    }

    /// The derivative of [`distort`](Self::distort) by `ω`.
    fn by_coefficient(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let r = p.norm();
        if r <= 0.0 {
            return Vector2::zeros();
        }
        let (s, omega) = (self.stretch, self.omega);
        let d_stretch = 1.0 / (0.5 * omega).cos().powi(2);
        let slope = r * d_stretch / (1.0 + s * s * r * r);
        p * ((slope - (s * r).atan() / omega) / (omega * r))
    }

    #[inline]
    fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = distorted.norm();
        let angle = radius * self.omega;
        if angle.is_nan() || angle >= std::f64::consts::FRAC_PI_2 {
            return None;
        }
        let factor = if angle < 1e-9 { self.omega } else { angle.tan() / radius };
        Some(distorted * (factor / self.stretch))
    }
}
