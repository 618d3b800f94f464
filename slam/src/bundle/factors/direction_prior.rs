//! What is known of a direction from elsewhere.

use geometry::Direction;
use geometry::nalgebra::{Matrix2, Vector2};
use optim::{Factor, Linearized};

/// Difference of a direction from a known one, in standard deviations.
///
/// `r(d) = S Bᵀ (±d)`, where `B` is the tangent basis of the known direction, the sign makes the angle acute,
/// and `Sᵀ S` is the information (1/radians²) in that basis: the sight of keyframes outside the problem.
/// [method: Direction prior]
#[derive(Clone, Copy, Debug)]
pub struct DirectionPriorFactor {
    /// The known direction, world.
    pub known: Direction,
    /// A square root of the information in the known direction's tangent basis, 1/radians.
    pub square_root_information: Matrix2<f64>,
}

impl Factor for DirectionPriorFactor {
    type Residual = Vector2<f64>;
    type Variables = (Direction,);

    fn residual(&self, (direction,): (&Direction,)) -> Option<Vector2<f64>> {
        let tangent = self.known.basis().transpose() * direction.as_vector();
        Some(self.square_root_information * tangent * self.sign(direction))
    }

    fn linearize(&self, (direction,): (&Direction,)) -> Option<Linearized<Self>> {
        let residual = self.residual((direction,))?;
        let d_residual = self.square_root_information
            * (self.known.basis().transpose() * direction.basis())
            * self.sign(direction);
        Some((residual, (d_residual,)))
    }
}

impl DirectionPriorFactor {
    fn sign(&self, direction: &Direction) -> f64 {
        if self.known.as_vector().dot(direction.as_vector()) < 0.0 { -1.0 } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector3;

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let known = Direction::new(Vector3::new((0.7 * s).sin(), s.cos(), 0.3 + 0.1 * s)).unwrap();
            let direction = known.retract(&Vector2::new(0.2 * s.sin(), 0.3 * s.cos()));
            let square_root_information = Matrix2::new(40.0, 0.0, -7.0, 25.0 + s);
            let factor = DirectionPriorFactor { known, square_root_information };
            optim::testing::assert_jacobians_match(&factor, &(direction,), 1e-6, 1e-5);
            assert!(factor.residual((&known,)).unwrap().norm() < 1e-12);
        }
    }
}
