//! The camera's rotation from directions seen in it (Wahba's problem).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::plane::unit;

/// The sine of 20 degrees: two directions nearer to parallel than this leave the turn about them too
/// uncertain.
const MIN_SIN_BETWEEN: f64 = 0.342_02;

/// A direction known in the world and seen by the camera. Neither need be of unit length, and signs do not
/// matter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionPair {
    /// In the world.
    pub in_world: Vector3<f64>,
    /// In the camera.
    pub in_camera: Vector3<f64>,
    /// Inverse variance of the angle between the two, up to a common factor. Positive.
    pub weight: f64,
}

/// The rotation `camera_from_world` that turns the directions of the world best into those seen: `argmin sum
/// w |c - R d|²` [Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976].
///
/// Directions have no sign: each pair's is taken such that `predicted` turns one to within 90 degrees of the
/// other, so the prediction must be right to 45 degrees or so. Pairs that are not finite or weigh nothing are
/// passed over; `None` if no two directions at least 20 degrees apart remain.
pub fn rotation_from_directions(
    pairs: &[DirectionPair],
    predicted: &UnitQuaternion<f64>,
) -> Option<UnitQuaternion<f64>> {
    let mut first: Option<Vector3<f64>> = None;
    let mut is_determined = false;
    let mut correlation = Matrix3::zeros();
    let largest_weight = pairs.iter().map(|pair| pair.weight).filter(|w| w.is_finite()).fold(0.0, f64::max);
    for pair in pairs {
        let (Some(in_world), Some(in_camera)) = (unit(&pair.in_world), unit(&pair.in_camera)) else {
            continue;
        };
        if !(pair.weight.is_finite() && pair.weight > 0.0) {
            continue;
        }
        let sign = if in_camera.dot(&(predicted * in_world)) < 0.0 { -1.0 } else { 1.0 };
        correlation += in_camera * in_world.transpose() * (sign * pair.weight / largest_weight);
        let first = first.get_or_insert(in_world);
        is_determined |= first.cross(&in_world).norm() >= MIN_SIN_BETWEEN;
    }
    if !is_determined {
        return None;
    }
    let svd = correlation.try_svd(true, true, f64::EPSILON, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let handedness = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * handedness * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    rotation.coords.iter().all(|x| x.is_finite()).then_some(rotation)
}

/// Every rotation `camera_from_world` under which two directions of the world are where two seen ones are, to
/// within `tolerance` radians in the angle between them. Rotations nearer than that to one found before are
/// left out, and so is what exceeds `max_rotations`.
///
/// For where nothing is predicted: three directions at right angles can be told apart in 24 ways.
/// [method: Rotation from vanishing points]
pub fn rotation_hypotheses(
    in_world: &[Vector3<f64>],
    in_camera: &[Vector3<f64>],
    tolerance: f64,
    max_rotations: usize,
) -> Vec<UnitQuaternion<f64>> {
    let known: Vec<Vector3<f64>> = in_world.iter().filter_map(unit).collect();
    let seen: Vec<Vector3<f64>> = in_camera.iter().filter_map(unit).collect();
    let mut rotations: Vec<UnitQuaternion<f64>> = Vec::new();
    for [a, b] in pairs(&seen) {
        for [first, second] in pairs(&known).flat_map(|[first, second]| [[first, second], [second, first]]) {
            for (first, second) in [(first, second), (first, -second), (-first, second), (-first, -second)] {
                let Some(rotation) = rotation_between([&first, &second], [&a, &b], tolerance) else {
                    continue;
                };
                let is_new = rotations.iter().all(|other| other.angle_to(&rotation) > tolerance);
                if is_new {
                    rotations.push(rotation);
                }
                if rotations.len() >= max_rotations {
                    return rotations;
                }
            }
        }
    }
    rotations
}

/// Those far enough from parallel, in the order given.
fn pairs(directions: &[Vector3<f64>]) -> impl Iterator<Item = [Vector3<f64>; 2]> {
    let later = |i: usize| directions[i + 1..].iter();
    let all = directions.iter().enumerate().flat_map(move |(i, a)| later(i).map(move |b| [*a, *b]));
    all.filter(|[a, b]| a.cross(b).norm() >= MIN_SIN_BETWEEN)
}

/// The rotation that turns one pair of directions best into another, if the angle between them is the same.
fn rotation_between(
    known: [&Vector3<f64>; 2],
    seen: [&Vector3<f64>; 2],
    tolerance: f64,
) -> Option<UnitQuaternion<f64>> {
    if (known[0].angle(known[1]) - seen[0].angle(seen[1])).abs() > tolerance {
        return None;
    }
    let frame = |[a, b]: [&Vector3<f64>; 2]| {
        let (along, across) = ((a + b).normalize(), (a - b).normalize());
        Matrix3::from_columns(&[along, across, along.cross(&across)])
    };
    let rotation = Rotation3::from_matrix_unchecked(frame(seen) * frame(known).transpose());
    Some(UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypotheses_hold_the_truth() {
        let truth = UnitQuaternion::from_euler_angles(0.4, -1.1, 2.5);
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let seen = axes.map(|axis| truth * -axis);
        let rotations = rotation_hypotheses(&axes, &seen, 0.05, 100);
        assert_eq!(rotations.len(), 24);
        assert!(rotations.iter().any(|rotation| rotation.angle_to(&truth) < 1e-9));
        // Directions 40 degrees apart are no two of these.
        let askew = [Vector3::x(), UnitQuaternion::from_euler_angles(0.0, 0.7, 0.0) * Vector3::x()];
        assert!(rotation_hypotheses(&axes, &askew, 0.05, 100).is_empty());
        assert_eq!(rotation_hypotheses(&axes, &seen, 0.05, 7).len(), 7);
        assert!(rotation_hypotheses(&axes, &seen[..1], 0.05, 100).is_empty());
        assert!(rotation_hypotheses(&[Vector3::zeros(), Vector3::x()], &seen, 0.05, 100).is_empty());
    }

    fn pair(in_world: Vector3<f64>, in_camera: Vector3<f64>) -> DirectionPair {
        DirectionPair { in_world, in_camera, weight: 2.0 }
    }

    #[test]
    fn two_directions_of_any_sign_give_the_rotation() {
        let truth = UnitQuaternion::from_euler_angles(0.5, -1.1, 2.0);
        let predicted = UnitQuaternion::from_euler_angles(0.05, 0.1, -0.1) * truth;
        let (a, b) = (Vector3::new(1.0, 0.2, 0.0), Vector3::new(0.5, 0.1, 3.0));
        let pairs = [pair(a, truth * a * -4.0), pair(-b, truth * b)];
        let found = rotation_from_directions(&pairs, &predicted).unwrap();
        assert!(found.angle_to(&truth) < 1e-7);
        let useless = pair(Vector3::new(f64::NAN, 0.0, 0.0), a);
        let weightless = DirectionPair { weight: f64::NAN, ..pair(a, b) };
        let with_bad = [pairs[0], useless, weightless, pairs[1]];
        assert_eq!(rotation_from_directions(&with_bad, &predicted), Some(found));
    }

    #[test]
    fn the_better_known_direction_counts_more() {
        // Two axes seen one degree too near to one another: the rotation must follow the heavier of them.
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1_f64.to_radians());
        let heavy = DirectionPair { weight: 1e6, ..pair(Vector3::x(), turned * Vector3::x()) };
        let pairs = [heavy, pair(Vector3::y(), Vector3::y())];
        let found = rotation_from_directions(&pairs, &UnitQuaternion::identity()).unwrap();
        assert!(found.angle_to(&turned) < 1e-4);
    }

    #[test]
    fn parallel_directions_are_not_enough() {
        let near = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 15_f64.to_radians());
        let (a, b) = (Vector3::x(), near * Vector3::x());
        let identity = UnitQuaternion::identity();
        assert_eq!(rotation_from_directions(&[], &identity), None);
        assert_eq!(rotation_from_directions(&[pair(a, a)], &identity), None);
        assert_eq!(rotation_from_directions(&[pair(a, a), pair(b, b), pair(-a, a)], &identity), None);
    }
}
