//! Fusion of the vanishing points of several keyframes into one direction.

use crate::map::{Keyframe, Map, PrimitiveObservation};
use geometry::Direction;
use geometry::nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2};

/// Standard deviation of a keyframe's attitude in the world, beside that of its vanishing point, radians:
/// without it a single frame with many lines would outweigh all others.
const ATTITUDE_SIGMA_RAD: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Rounds of linearization: directions are close to begin with.
const N_ROUNDS: usize = 2;

/// A fused direction of the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DirectionEstimate {
    pub direction: Direction,
    /// In the direction's tangent basis, 1/radians².
    pub information: Matrix2<f64>,
}

impl DirectionEstimate {
    /// Covariance in the world, of rank two, radians²; `None` if the direction is not determined.
    pub fn covariance(&self) -> Option<Matrix3<f64>> {
        let basis = self.direction.basis();
        Some(basis * self.information.try_inverse()? * basis.transpose())
    }
}

/// Weighted fusion of vanishing directions in the world [method: Fusion of vanishing directions]: the weight
/// of each is its information, which grows with the number and length of its segments, limited by how well
/// the camera's attitude is known. Blind to the directions' signs.
pub(crate) fn estimate_direction(
    map: &Map,
    observations: impl Iterator<Item = PrimitiveObservation> + Clone,
) -> Option<DirectionEstimate> {
    let observations = observations.filter_map(|seen| {
        let keyframe = map.keyframe(seen.keyframe)?;
        Some((in_world(keyframe, seen.vanishing_idx)?, covariance_in_world(keyframe, seen.vanishing_idx)?))
    });
    let (mut direction, _) = observations.clone().next()?;
    let mut information = Matrix2::zeros();
    for _ in 0..N_ROUNDS {
        let basis = direction.basis();
        information = Matrix2::zeros();
        let mut weighted = Vector2::zeros();
        for (sighted, covariance) in observations.clone() {
            let Some(weight) = information_in(&basis, &covariance) else { continue };
            information += weight;
            weighted += weight * direction.local(&sighted);
        }
        direction = direction.retract(&(information.try_inverse()? * weighted));
    }
    let estimate = DirectionEstimate { direction, information };
    estimate.direction.as_vector().iter().all(|value| value.is_finite()).then_some(estimate)
}

/// A vanishing point's direction in the world.
pub(crate) fn in_world(keyframe: &Keyframe, vanishing_idx: u32) -> Option<Direction> {
    let vanishing = keyframe.vanishing.get(vanishing_idx as usize)?;
    Direction::new(keyframe.camera_from_world.rotation.inverse() * vanishing.direction)
}

fn covariance_in_world(keyframe: &Keyframe, vanishing_idx: u32) -> Option<Matrix3<f64>> {
    let vanishing = keyframe.vanishing.get(vanishing_idx as usize)?;
    let world_from_camera = keyframe.camera_from_world.rotation_matrix().transpose();
    Some(world_from_camera * vanishing.covariance * world_from_camera.transpose())
}

fn information_in(basis: &Matrix3x2<f64>, covariance: &Matrix3<f64>) -> Option<Matrix2<f64>> {
    let attitude = Matrix2::identity() * ATTITUDE_SIGMA_RAD * ATTITUDE_SIGMA_RAD;
    (basis.transpose() * covariance * basis + attitude).try_inverse()
}

/// Standard deviation of a vanishing point's direction, attitude included, in its worst direction, radians.
pub(crate) fn sigma_rad(covariance: &Matrix3<f64>) -> f64 {
    // The trace bounds the largest eigenvalue and is at most twice it.
    (covariance.trace().max(0.0) / 2.0 + ATTITUDE_SIGMA_RAD * ATTITUDE_SIGMA_RAD).sqrt()
}
