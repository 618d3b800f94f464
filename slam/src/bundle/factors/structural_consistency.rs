//! How far a line of space is from having the direction of its primitive.

use geometry::nalgebra::{Matrix3, Matrix3x2, Matrix3x4, Vector3};
use geometry::{Direction, OrthonormalLine, so3};
use optim::{Factor, Linearized};

/// Sine of the angle between a line and its global primitive, in standard deviations.
///
/// `r(L, d) = (u × d) / σ`, where `u` is the unit direction of the line `L` and `d` that of the primitive,
/// both in the world, and `σ` the standard deviation of the angle (radians). In Jiang et al. (eq. 17) the
/// error is `|u · d − 1|`: its derivative vanishes at the solution, that of the cross product does not, and
/// it is blind to the sign of either. Of the three components two are independent.
/// [method: Structural consistency]
#[derive(Clone, Copy, Debug)]
pub struct StructuralConsistencyFactor {
    /// One over the standard deviation of the angle, 1/radians.
    pub inverse_sigma: f64,
}

/// The unit direction and its derivative by the line's four parameters.
fn direction_with_jacobian(line: &OrthonormalLine) -> (Vector3<f64>, Matrix3x4<f64>) {
    let (_, scaled) = line.pluecker();
    let length = scaled.norm();
    let unit = scaled / length;
    let d_scaled: Matrix3x4<f64> = line.jacobian().fixed_view::<3, 4>(3, 0).into_owned();
    (unit, (Matrix3::identity() - unit * unit.transpose()) * d_scaled / length)
}

impl Factor for StructuralConsistencyFactor {
    type Residual = Vector3<f64>;
    type Variables = (Direction, OrthonormalLine);

    #[inline]
    fn residual(&self, (primitive, line): (&Direction, &OrthonormalLine)) -> Option<Vector3<f64>> {
        let (_, direction) = line.pluecker();
        let unit = direction.try_normalize(f64::MIN_POSITIVE)?;
        Some(unit.cross(primitive.as_vector()) * self.inverse_sigma)
    }

    #[inline]
    fn linearize(&self, (primitive, line): (&Direction, &OrthonormalLine)) -> Option<Linearized<Self>> {
        let residual = self.residual((primitive, line))?;
        let (unit, d_unit) = direction_with_jacobian(line);
        let d_residual_d_primitive: Matrix3x2<f64> =
            so3::skew(&unit) * primitive.basis() * self.inverse_sigma;
        let d_residual_d_line: Matrix3x4<f64> =
            so3::skew(primitive.as_vector()) * d_unit * -self.inverse_sigma;
        Some((residual, (d_residual_d_primitive, d_residual_d_line)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Line3;

    fn line(s: f64) -> OrthonormalLine {
        let point = Vector3::new(0.3 * s.cos(), 1.0 + 0.1 * s, -0.4);
        let line = Line3::from_point_direction(&point, &Vector3::new(s.sin(), 0.5, s.cos())).unwrap();
        OrthonormalLine::from_line(&line).unwrap()
    }

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let direction = Direction::new(Vector3::new((0.7 * s).sin(), s.cos(), 0.3 + 0.1 * s)).unwrap();
            let factor = StructuralConsistencyFactor { inverse_sigma: 57.0 };
            optim::testing::assert_jacobians_match(&factor, &(direction, line(s)), 1e-6, 1e-5);
        }
    }

    #[test]
    fn the_residual_is_the_sine_of_the_angle() {
        let factor = StructuralConsistencyFactor { inverse_sigma: 2.0 };
        let direction = line(1.0).to_line().unwrap();
        let same = Direction::new(-direction.direction()).unwrap();
        assert!(factor.residual((&same, &line(1.0))).unwrap().norm() < 1e-12);
        let turned = same.retract(&geometry::nalgebra::Vector2::new(0.1, 0.0));
        let residual = factor.residual((&turned, &line(1.0))).unwrap();
        assert!((residual.norm() - 2.0 * 0.1f64.sin()).abs() < 1e-12);
    }
}
