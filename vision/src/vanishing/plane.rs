//! A segment as a calibrated camera sees it: the plane through the camera's center that holds it.

use nalgebra::{Matrix3, Vector2, Vector3};

/// Endpoints nearer than this are one point, radians: a twentieth of a pixel at a focal length of 500 px.
const MIN_LENGTH_RAD: f64 = 1e-4;
/// `sin t sin(a - t) / sin² a` a quarter of the way `t` along a (short) segment of length `a`.
const INSIDE_PRODUCT: f64 = 3.0 / 16.0;

/// The interpretation plane of one image segment, in the camera frame, and how noise in its endpoints turns
/// it.
///
/// A direction `d` of a 3D line that projects onto the segment lies in the plane: `normal · d = 0`. Always
/// finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentPlane {
    start: Vector3<f64>,
    end: Vector3<f64>,
    normal: Vector3<f64>,
    length_rad: f64,
    /// `start_arm · d` is how far, in standard deviations of the start, noise there lifts the plane off `d`.
    start_arm: Vector3<f64>,
    /// The same for the end.
    end_arm: Vector3<f64>,
    /// What the product of the two arms' dot products with a direction exceeds if that points to the inside.
    inside_limit: f64,
}

impl SegmentPlane {
    /// From the endpoints in the undistorted, normalized image, `(x / z, y / z)`.
    ///
    /// `sigma` is the standard deviation of an endpoint across the segment in the same units, `sigma_px / f`;
    /// it need not be small against the distance from the image center, where a pixel covers a smaller angle:
    /// that is accounted for. `None` if anything is not finite, the endpoints coincide or `sigma` is not
    /// positive.
    pub fn from_normalized(start: &Vector2<f64>, end: &Vector2<f64>, sigma: f64) -> Option<Self> {
        let (start, end) = (start.push(1.0), end.push(1.0));
        let normal = start.cross(&end).try_normalize(0.0)?;
        // One unit across the image line lifts the point by this sine of the angle between image and plane,
        // seen from its distance.
        let across = normal.xy().norm() * sigma;
        Self::new(&start, &end, across / start.norm(), across / end.norm())
    }

    /// From the rays to the endpoints, of any positive length. `sigma_rad` is the standard deviation of the
    /// angle by which an endpoint leaves the plane.
    ///
    /// `None` if anything is not finite, the rays are parallel or opposite, or `sigma_rad` is not positive.
    pub fn from_rays(start: &Vector3<f64>, end: &Vector3<f64>, sigma_rad: f64) -> Option<Self> {
        Self::new(start, end, sigma_rad, sigma_rad)
    }

    fn new(start: &Vector3<f64>, end: &Vector3<f64>, start_sigma: f64, end_sigma: f64) -> Option<Self> {
        let (start, end) = (unit(start)?, unit(end)?);
        let cross = start.cross(&end);
        let sin_length = cross.norm();
        if sin_length < MIN_LENGTH_RAD {
            return None;
        }
        let normal = cross / sin_length;
        let plane = Self {
            start,
            end,
            normal,
            length_rad: sin_length.atan2(start.dot(&end)),
            start_arm: end.cross(&normal) * (start_sigma / sin_length),
            end_arm: normal.cross(&start) * (end_sigma / sin_length),
            inside_limit: INSIDE_PRODUCT * start_sigma * end_sigma,
        };
        let arms_are_usable =
            [start_sigma, end_sigma].iter().all(|sigma| sigma.is_normal() && *sigma > 0.0 && *sigma < 1.0);
        arms_are_usable.then_some(plane)
    }

    /// Unit ray to the start.
    #[inline]
    pub fn start(&self) -> &Vector3<f64> {
        &self.start
    }

    /// Unit ray to the end.
    #[inline]
    pub fn end(&self) -> &Vector3<f64> {
        &self.end
    }

    /// Unit normal of the plane, along `start x end`.
    #[inline]
    pub fn normal(&self) -> &Vector3<f64> {
        &self.normal
    }

    /// Angle between the rays to the endpoints.
    #[inline]
    pub fn length_rad(&self) -> f64 {
        self.length_rad
    }

    /// The sine of the angle by which a unit `direction` leaves the plane: the residual.
    #[inline]
    pub fn residual(&self, direction: &Vector3<f64>) -> f64 {
        self.normal.dot(direction)
    }

    /// Variance of the [`residual`](Self::residual) of a direction in the plane.
    ///
    /// An endpoint's noise turns the plane about the other endpoint, so with `t` the angle from the start to
    /// the direction and `a` the length, `(σ_start² sin²(a - t) + σ_end² sin² t) / sin² a`: great for short
    /// segments and directions far from them.
    #[inline]
    pub fn variance(&self, direction: &Vector3<f64>) -> f64 {
        self.start_arm.dot(direction).powi(2) + self.end_arm.dot(direction).powi(2)
    }

    /// Covariance of the normal, rank 2: `variance(d) = d^T C d`.
    #[inline]
    pub(super) fn normal_covariance(&self) -> Matrix3<f64> {
        self.start_arm * self.start_arm.transpose() + self.end_arm * self.end_arm.transpose()
    }

    /// Not positive if the direction can be that of the segment's line: if the residual is within
    /// `gate2.sqrt()` standard deviations, and the direction does not point into the middle half of the
    /// segment. A line appears to end at its vanishing point, so that a segment never reaches over it.
    #[inline]
    pub(super) fn excess(&self, direction: &Vector3<f64>, gate2: f64) -> f64 {
        let residual = self.residual(direction);
        let (from_start, from_end) = (self.start_arm.dot(direction), self.end_arm.dot(direction));
        let beyond_gate = residual * residual - gate2 * (from_start * from_start + from_end * from_end);
        beyond_gate.max(from_start * from_end - self.inside_limit)
    }
}

/// Scaled by the largest component first, so that squares neither overflow nor vanish.
pub(super) fn unit(vector: &Vector3<f64>) -> Option<Vector3<f64>> {
    let largest = vector.amax();
    let is_usable = largest.is_normal() && vector.iter().all(|x| x.is_finite());
    is_usable.then(|| (vector / largest).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_what_is_no_segment() {
        let (a, b) = (Vector2::new(0.1, 0.2), Vector2::new(0.3, 0.2));
        assert!(SegmentPlane::from_normalized(&a, &b, 1e-3).is_some());
        for bad in [f64::NAN, f64::INFINITY, -1e-3, 0.0, 2.0, 1e-320] {
            assert_eq!(SegmentPlane::from_normalized(&a, &b, bad), None, "sigma {bad}");
        }
        for bad in [f64::NAN, f64::INFINITY, f64::MAX] {
            assert_eq!(SegmentPlane::from_normalized(&Vector2::new(bad, 0.0), &b, 1e-3), None, "x {bad}");
        }
        assert_eq!(SegmentPlane::from_normalized(&a, &a, 1e-3), None);
        let ray = Vector3::new(0.0, 0.6, 0.8);
        for parallel in [ray, -ray, ray * 3.0, Vector3::zeros()] {
            assert_eq!(SegmentPlane::from_rays(&ray, &parallel, 1e-3), None);
        }
    }

    #[test]
    fn variance_is_that_of_the_closed_form() {
        // var = σ² (1 - cos a cos 2g) / sin² a, g from the middle of the segment to the direction.
        let ray = |angle: f64| Vector3::new(angle.sin(), 0.0, angle.cos());
        let (length, sigma) = (0.2_f64, 1e-3);
        let plane = SegmentPlane::from_rays(&ray(0.3), &ray(0.3 + length), sigma).unwrap();
        for gamma in [-1.2, 0.0, 0.5, 1.5_f64] {
            let expected = sigma.powi(2) * (1.0 - length.cos() * (2.0 * gamma).cos()) / length.sin().powi(2);
            let actual = plane.variance(&ray(0.3 + length / 2.0 + gamma));
            assert!((actual / expected - 1.0).abs() < 1e-12, "{actual} {expected}");
        }
    }

    #[test]
    fn a_segment_does_not_reach_over_its_vanishing_point() {
        let ray = |angle: f64| Vector3::new(angle.sin(), 0.0, angle.cos());
        let plane = SegmentPlane::from_rays(&ray(0.0), &ray(0.2), 1e-3).unwrap();
        for (angle, is_accepted) in [(-1.0, true), (0.0, true), (0.1, false), (0.14, false), (0.25, true)] {
            for direction in [ray(angle), -ray(angle)] {
                assert_eq!(plane.excess(&direction, 4.0) <= 0.0, is_accepted, "{angle}");
            }
        }
    }

    #[test]
    fn image_noise_becomes_the_spread_of_the_residual() {
        // Central differences through the constructor, far from the image center: each endpoint moved across.
        let (start, end) = (Vector2::new(0.7, -0.5), Vector2::new(0.9, -0.2));
        let sigma = 1e-6;
        let along = (end - start).normalize();
        let across = Vector2::new(-along.y, along.x) * sigma;
        let plane = SegmentPlane::from_normalized(&start, &end, sigma).unwrap();
        // A direction in the plane.
        let direction = (plane.start() * 0.3 - plane.end()).normalize();
        let moved = |s: Vector2<f64>, e: Vector2<f64>| {
            SegmentPlane::from_normalized(&s, &e, sigma).unwrap().residual(&direction)
        };
        let variance = moved(start + across, end).powi(2) + moved(start, end + across).powi(2);
        assert!((variance / plane.variance(&direction) - 1.0).abs() < 1e-4);
    }
}
