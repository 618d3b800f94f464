//! Points from bearings of known cameras.

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3};

use crate::Pose;

/// Rays closer to parallel than this, in radians, do not define a point: a thousandth of a pixel of most
/// cameras.
const MIN_PARALLAX_RAD: f64 = 1e-6;

/// Gauss-Newton rounds that refine a point of many views; convergence is quadratic and takes two to four.
const MAX_REFINEMENTS: usize = 8;

/// The world point seen from two cameras, with the least sum of angular corrections to the two bearings: the
/// bearing further from the baseline's direction is left as it is, the other one turned into its epipolar
/// plane [Lee & Civera 2019, L1 criterion]. A closed form of a few dozen operations.
///
/// Bearings are unit vectors in the camera frames. `None` if the rays are parallel (the point is at
/// infinity), the point is behind a camera, or anything is not finite.
pub fn two_view(
    camera_a_from_world: &Pose,
    bearing_a: &Vector3<f64>,
    camera_b_from_world: &Pose,
    bearing_b: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let world_from_a = camera_a_from_world.inverse();
    let world_from_b = camera_b_from_world.inverse();
    let baseline = world_from_b.translation - world_from_a.translation;
    let mut ray_a = world_from_a.rotation * bearing_a;
    let mut ray_b = world_from_b.rotation * bearing_b;
    let normal_a = ray_a.cross(&baseline);
    let normal_b = ray_b.cross(&baseline);
    if normal_a.norm_squared() > normal_b.norm_squared() {
        ray_b -= normal_a * (ray_b.dot(&normal_a) / normal_a.norm_squared());
    } else {
        ray_a -= normal_b * (ray_a.dot(&normal_b) / normal_b.norm_squared());
    }
    // ray_a depth_a = baseline + ray_b depth_b; crossed with either ray, one unknown is left.
    let normal = ray_a.cross(&ray_b);
    let sin2_parallax = normal.norm_squared();
    let depth_a = baseline.cross(&ray_b).dot(&normal) / sin2_parallax;
    let depth_b = baseline.cross(&ray_a).dot(&normal) / sin2_parallax;
    let point = world_from_a.translation + ray_a * depth_a;
    // Comparisons with a number that is not finite fail, so such numbers end here too.
    let usable = sin2_parallax > MIN_PARALLAX_RAD * MIN_PARALLAX_RAD && depth_a > 0.0 && depth_b > 0.0;
    (usable && point.iter().all(|x| x.is_finite())).then_some(point)
}

/// The world point seen from two or more cameras (`camera_from_world`, unit bearing), by the homogeneous
/// linear method, then refined to the least sum of squared angular errors.
///
/// `None` with fewer than two views, if all rays are parallel, the point is behind a camera, or anything is
/// not finite.
pub fn many_view(views: &[(Pose, Vector3<f64>)]) -> Option<Vector3<f64>> {
    let point = refine(views, linear(views)?)?;
    let in_front = views.iter().all(|(pose, bearing)| pose.transform(&point).dot(bearing) > 0.0);
    let observable = views
        .iter()
        .any(|(pose, _)| parallax(&views[0].0.center(), &pose.center(), &point) > MIN_PARALLAX_RAD);
    (in_front && observable).then_some(point)
}

/// The angle at `point` between the directions to two camera centers, in `[0, π]` radians; zero if the point
/// coincides with a center.
#[inline]
pub fn parallax(center_a: &Vector3<f64>, center_b: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
    let (a, b) = (center_a - point, center_b - point);
    a.cross(&b).norm().atan2(a.dot(&b))
}

/// The right singular vector of the stacked equations `bearing × (R X + t) = 0`. Coordinates are moved to the
/// mean camera center and scaled by the spread of the centers, so that the result does not depend on either.
fn linear(views: &[(Pose, Vector3<f64>)]) -> Option<Vector3<f64>> {
    if views.len() < 2 {
        return None;
    }
    let n = views.len() as f64;
    let mean = views.iter().map(|(pose, _)| pose.center()).sum::<Vector3<f64>>() / n;
    let spread =
        (views.iter().map(|(pose, _)| (pose.center() - mean).norm_squared()).sum::<f64>() / n).sqrt();
    if !(spread.is_finite() && spread > 0.0) {
        return None;
    }
    let mut normal = Matrix4::zeros();
    for (pose, bearing) in views {
        // With r the ray in the world and c the scaled center, |r × (X - c w)|² = (X - c w)ᵀ Q (X - c w).
        let ray = pose.rotation.inverse() * bearing;
        let center = (pose.center() - mean) / spread;
        let q = Matrix3::identity() - ray * ray.transpose();
        let qc = q * center;
        let mut block = normal.fixed_view_mut::<3, 3>(0, 0);
        block += q;
        let mut column = normal.fixed_view_mut::<3, 1>(0, 3);
        column -= qc;
        let mut row = normal.fixed_view_mut::<1, 3>(3, 0);
        row -= qc.transpose();
        normal[(3, 3)] += center.dot(&qc);
    }
    if !normal.iter().all(|x| x.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(normal);
    let x = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let point = mean + x.xyz() * (spread / x.w);
    point.iter().all(|x| x.is_finite()).then_some(point)
}

/// Gauss-Newton on the differences between observed and predicted unit bearings.
fn refine(views: &[(Pose, Vector3<f64>)], start: Vector3<f64>) -> Option<Vector3<f64>> {
    let mut point = start;
    let mut cost = angular_cost(views, &point);
    for _ in 0..MAX_REFINEMENTS {
        let mut hessian = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for (pose, bearing) in views {
            let in_camera = pose.transform(&point);
            let inverse_range = 1.0 / in_camera.norm();
            let predicted = in_camera * inverse_range;
            let across = (Matrix3::identity() - predicted * predicted.transpose()) * inverse_range;
            let jacobian = across * pose.rotation_matrix();
            hessian += jacobian.transpose() * jacobian;
            gradient += jacobian.transpose() * (predicted - bearing);
        }
        let Some(step) = hessian.try_inverse().map(|inverse| -(inverse * gradient)) else { break };
        let moved = point + step;
        let moved_cost = angular_cost(views, &moved);
        if moved_cost.is_nan() || moved_cost >= cost {
            break;
        }
        let converged = cost - moved_cost < 1e-12 * cost;
        point = moved;
        cost = moved_cost;
        if converged {
            break;
        }
    }
    cost.is_finite().then_some(point)
}

fn angular_cost(views: &[(Pose, Vector3<f64>)], point: &Vector3<f64>) -> f64 {
    views.iter().map(|(pose, bearing)| (pose.transform(point).normalize() - bearing).norm_squared()).sum()
}
