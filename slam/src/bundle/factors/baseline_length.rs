//! How long the way between two cameras is: fixes the scale where nothing else does.

use geometry::Pose;
use geometry::nalgebra::{Matrix1x6, Vector1};
use optim::{Factor, Linearized};

/// Distance of a camera from the origin of its reference, against a given length.
///
/// `r(T) = (‖t‖ − length) / σ`, where `t` is the translation of `T`, a `camera_from_reference` (map units).
/// Not defined for a translation of zero.
#[derive(Clone, Copy, Debug)]
pub struct BaselineLengthFactor {
    /// The length, map units.
    pub length: f64,
    /// One over the standard deviation of the length, 1/map units.
    pub inverse_sigma: f64,
}

impl Factor for BaselineLengthFactor {
    type Residual = Vector1<f64>;
    type Variables = (Pose,);

    fn residual(&self, (camera_from_reference,): (&Pose,)) -> Option<Vector1<f64>> {
        let norm = camera_from_reference.translation.norm();
        (norm > 0.0).then(|| Vector1::new((norm - self.length) * self.inverse_sigma))
    }

    fn linearize(&self, (camera_from_reference,): (&Pose,)) -> Option<Linearized<Self>> {
        let residual = self.residual((camera_from_reference,))?;
        // A left rotation turns the translation about the origin and leaves its length.
        let direction = camera_from_reference.translation.normalize() * self.inverse_sigma;
        let d_residual_d_pose = Matrix1x6::new(0.0, 0.0, 0.0, direction.x, direction.y, direction.z);
        Some((residual, (d_residual_d_pose,)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector6;

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..16 {
            let s = f64::from(seed);
            let pose =
                Pose::exp(&Vector6::new(s.sin(), s.cos(), 0.1 * s, 1.0 + 0.1 * s, -0.5, (3.0 * s).sin()));
            let factor = BaselineLengthFactor { length: 0.7, inverse_sigma: 20.0 };
            optim::testing::assert_jacobians_match(&factor, &(pose,), 1e-6, 1e-5);
        }
    }
}
