//! How far two vanishing directions of a view are from perpendicular, by a camera that is not exactly known.

use super::calibrated_reprojection::{CorrectionVector, correction_of};
use geometry::nalgebra::{Matrix3, SMatrix, Vector1, Vector3};
use optim::{Factor, Linearized};

/// The angle between two directions of edges that a builder made perpendicular: two vanishing points of one
/// image and a right angle give the focal length.
///
/// `r(c) = d₁ · d₂ / σ` with `d = A_c w / ‖A_c w‖`, where `w` is a ray of the camera as it was given, and
/// `A_c` takes it to that of the camera corrected by `c`. Radial distortion is taken to be out of `w`
/// already.
#[derive(Clone, Copy, Debug)]
pub struct OrthogonalityFactor {
    /// The rays towards the two vanishing points by the nominal pinhole.
    pub nominal: [Vector3<f64>; 2],
    /// One over the standard deviation of the cosine of the angle between them.
    pub inverse_sigma: f64,
}

impl OrthogonalityFactor {
    /// A ray by the corrected camera, of unit length, with its derivatives by focal length and principal
    /// point.
    fn corrected(&self, idx: usize, correction: &CorrectionVector) -> (Vector3<f64>, Matrix3<f64>) {
        let correct = correction_of(correction).corrected_from_nominal();
        let ray = correct * self.nominal[idx];
        // A⁻¹ is linear in the members of c, and dA = -A d(A⁻¹) A.
        let d_ray = correct
            * -Matrix3::from_columns(&[
                Vector3::new(ray.x, ray.y, 0.0),
                Vector3::new(ray.z, 0.0, 0.0),
                Vector3::new(0.0, ray.z, 0.0),
            ]);
        let norm = ray.norm();
        let direction = ray / norm;
        (direction, (Matrix3::identity() - direction * direction.transpose()) * d_ray / norm)
    }
}

impl Factor for OrthogonalityFactor {
    type Residual = Vector1<f64>;
    type Variables = (CorrectionVector,);

    fn residual(&self, (correction,): (&CorrectionVector,)) -> Option<Vector1<f64>> {
        let [(first, _), (second, _)] = [0, 1].map(|idx| self.corrected(idx, correction));
        (correction[0] > -1.0).then(|| Vector1::new(first.dot(&second) * self.inverse_sigma))
    }

    fn linearize(&self, (correction,): (&CorrectionVector,)) -> Option<Linearized<Self>> {
        let residual = self.residual((correction,))?;
        let [(first, d_first), (second, d_second)] = [0, 1].map(|idx| self.corrected(idx, correction));
        let by_pinhole = (second.transpose() * d_first + first.transpose() * d_second) * self.inverse_sigma;
        let mut jacobian = SMatrix::<f64, 1, 5>::zeros();
        jacobian.fixed_view_mut::<1, 3>(0, 0).copy_from(&by_pinhole);
        Some((residual, (jacobian,)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let factor = OrthogonalityFactor {
                nominal: [
                    Vector3::new(s.sin(), 0.2 * s.cos(), 1.0).normalize(),
                    Vector3::new(-s.cos(), 0.1, 0.7 * s.sin()).normalize(),
                ],
                inverse_sigma: 50.0,
            };
            let correction =
                CorrectionVector::from([4.0 * s.sin(), s.cos(), (3.0 * s).sin(), 1.0, 1.0]) * 0.05;
            optim::testing::assert_jacobians_match(&factor, &(correction,), 1e-6, 1e-5);
        }
    }

    #[test]
    fn a_right_angle_is_one_by_the_true_focal_length_alone() {
        // A corner of a room, seen across its diagonal by a camera of focal length 1.25 times the nominal.
        let truth = CorrectionVector::from([0.25, 0.0, 0.0, 0.0, 0.0]);
        let to_nominal = correction_of(&truth).nominal_from_corrected();
        let nominal = [Vector3::new(1.0, 0.0, 1.0), Vector3::new(-1.0, 0.0, 1.0)].map(|ray| to_nominal * ray);
        let factor = OrthogonalityFactor { nominal, inverse_sigma: 1.0 };
        assert!(factor.residual((&truth,)).unwrap().norm() < 1e-12);
        assert!(factor.residual((&CorrectionVector::zeros(),)).unwrap().norm() > 0.1);
    }
}
