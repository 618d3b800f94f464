//! Two keyframes of the essential graph keep their relative place, attitude and scale.

use super::similarity_reprojection::d_moved_d_similarity;
use geometry::nalgebra::{Matrix3, SMatrix, SVector};
use geometry::{Similarity, so3};
use optim::{Factor, Linearized};

/// Departure of a relative similarity from what it was measured to be.
///
/// With `E = S_j · S_i⁻¹ · M⁻¹`, the identity when the measurement `M` (`j_from_i`) holds,
/// `r(S_i, S_j) = [log R_E / σ_r, t_E / σ_t, ln s_E / σ_s]`: rotation (radians), translation (units of `j`)
/// and scale. The variables are `camera_from_world` with a scale. [method: Loop detection and correction]
#[derive(Clone, Copy, Debug)]
pub struct RelativeSimilarityFactor {
    /// The inverse of the measured `j_from_i`.
    pub i_from_j: Similarity,
    /// One over the standard deviations of rotation (1/rad), translation (1/units) and log scale.
    pub inverse_sigmas: [f64; 3],
}

type Vector7 = SVector<f64, 7>;

impl RelativeSimilarityFactor {
    fn whitened(&self, error: &Similarity) -> Vector7 {
        let [rotation, translation, scale] = self.inverse_sigmas;
        let (phi, t) = (so3::log(&error.rotation) * rotation, error.translation * translation);
        Vector7::from([phi.x, phi.y, phi.z, t.x, t.y, t.z, error.scale.ln() * scale])
    }
}

impl Factor for RelativeSimilarityFactor {
    type Residual = Vector7;
    type Variables = (Similarity, Similarity);

    fn residual(&self, (i, j): (&Similarity, &Similarity)) -> Option<Vector7> {
        Some(self.whitened(&(*j * i.inverse() * self.i_from_j)))
    }

    fn linearize(&self, (i, j): (&Similarity, &Similarity)) -> Option<Linearized<Self>> {
        let j_from_i = *j * i.inverse();
        let error = j_from_i * self.i_from_j;
        let [rotation, translation, scale] = self.inverse_sigmas;
        // E becomes exp(δ) E when j moves by δ.
        let mut d_j = SMatrix::<f64, 7, 7>::zeros();
        let d_log = so3::left_jacobian_inverse(&so3::log(&error.rotation));
        d_j.fixed_view_mut::<3, 3>(0, 0).copy_from(&(d_log * rotation));
        d_j.fixed_rows_mut::<3>(3).copy_from(&(d_moved_d_similarity(&error.translation) * translation));
        d_j[(6, 6)] = scale;
        // It becomes A exp(-δ) A⁻¹ E with A = j_from_i when i does.
        let d_i = -d_j * adjoint(&j_from_i);
        Some((self.whitened(&error), (d_i, d_j)))
    }
}

/// The matrix with `A exp(δ) A⁻¹ = exp(adjoint(A) δ)`.
fn adjoint(a: &Similarity) -> SMatrix<f64, 7, 7> {
    let rotation: Matrix3<f64> = a.rotation.to_rotation_matrix().into_inner();
    let mut adjoint = SMatrix::<f64, 7, 7>::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(so3::skew(&a.translation) * rotation));
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&(rotation * a.scale));
    adjoint.fixed_view_mut::<3, 1>(3, 6).copy_from(&-a.translation);
    adjoint[(6, 6)] = 1.0;
    adjoint
}

#[cfg(test)]
mod tests {
    use super::*;

    fn similarity(k: f64, size: f64) -> Similarity {
        Similarity::exp(&Vector7::from_fn(|i, _| size * (k * (1.1 + i as f64)).sin()))
    }

    #[test]
    fn jacobians_match_central_differences() {
        for seed in 0..32 {
            let s = f64::from(seed);
            let (i, j) = (similarity(s, 0.8), similarity(s + 0.4, 0.8));
            let measured = similarity(0.3 * s, 0.2) * j * i.inverse();
            let factor =
                RelativeSimilarityFactor { i_from_j: measured.inverse(), inverse_sigmas: [3.0, 2.0, 5.0] };
            optim::testing::assert_jacobians_match(&factor, &(i, j), 1e-6, 1e-5);
        }
    }

    #[test]
    fn a_measurement_that_holds_costs_nothing() {
        let (i, j) = (similarity(1.0, 0.8), similarity(2.0, 0.8));
        let factor = RelativeSimilarityFactor { i_from_j: i * j.inverse(), inverse_sigmas: [10.0; 3] };
        assert!(factor.residual((&i, &j)).is_some_and(|residual| residual.norm() < 1e-9));
    }
}
