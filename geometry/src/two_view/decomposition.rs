//! The motions an essential matrix or a homography can stand for.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::Pose;

/// The four motions `b_from_a`, with translations of unit length, of an essential matrix: two rotations, each
/// with the translation in both signs. At most one of them puts the points in front of both cameras.
///
/// The matrix need not be exactly essential (two equal singular values and a zero); the nearest one is taken.
/// `None` if it is zero or not finite.
pub fn decompose_essential(essential: &Matrix3<f64>) -> Option<[Pose; 4]> {
    let norm = essential.norm();
    if !(norm.is_finite() && norm > 0.0) {
        return None;
    }
    let svd = (essential / norm).svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    // Signs of U and V are free, as that of E is.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let quarter_turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let first = u * quarter_turn * v_t;
    let second = u * quarter_turn.transpose() * v_t;
    let t = u.column(2).into_owned();
    let pose = |rotation: &Matrix3<f64>, translation: Vector3<f64>| {
        let mut pose = Pose::from_rotation_matrix(rotation, &translation);
        pose.rotation.renormalize();
        pose
    };
    Some([pose(&first, t), pose(&first, -t), pose(&second, t), pose(&second, -t)])
}

/// The motions `b_from_a` and unit plane normals (in frame a) a homography between *normalized* coordinates
/// (`K⁻¹` times pixels) can stand for: `H ∼ R + t nᵀ` for the plane `n · X = 1`, so that translations are in
/// units of the distance from camera a to the plane.
///
/// Four in general, in two pairs that differ by the signs of `t` and `n` [Ma et al. 2004, section 5.3.3];
/// both cameras are taken to be on the same side of the plane. One, with zero translation and a normal
/// without meaning, if `H` is a rotation. None if `H` is singular or not finite.
pub fn decompose_homography(homography: &Matrix3<f64>) -> Vec<(Pose, Vector3<f64>)> {
    /// `H` is a rotation if its squared singular values differ from one by less than this.
    const ROTATION_TOLERANCE: f64 = 1e-10;
    let norm = homography.norm();
    if !(norm.is_finite() && norm > 0.0) {
        return Vec::new();
    }
    let mut h = homography / norm;
    let eigen = SymmetricEigen::new(h.tr_mul(&h));
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| eigen.eigenvalues[*j].total_cmp(&eigen.eigenvalues[*i]));
    let middle = eigen.eigenvalues[order[1]];
    let determinant = h.determinant();
    if middle <= 0.0 || determinant == 0.0 {
        return Vec::new();
    }
    // Of a true R + t nᵀ the middle singular value is one, and the determinant is the ratio of the two
    // cameras' distances from the plane, which is positive.
    h *= determinant.signum() / middle.sqrt();
    let [largest, smallest] = [order[0], order[2]].map(|i| eigen.eigenvalues[i] / middle);
    let [v1, v2, v3] = order.map(|i| eigen.eigenvectors.column(i).into_owned());
    if largest - smallest < ROTATION_TOLERANCE {
        let mut pose = Pose::from_rotation_matrix(&h, &Vector3::zeros());
        pose.rotation.renormalize();
        return vec![(pose, Vector3::z())];
    }
    // Two vectors that, like v2, keep their length under H and span with it a plane orthogonal to the normal.
    let along_v1 = v1 * ((1.0 - smallest).max(0.0) / (largest - smallest)).sqrt();
    let along_v3 = v3 * ((largest - 1.0).max(0.0) / (largest - smallest)).sqrt();
    let mut solutions = Vec::with_capacity(4);
    for kept in [along_v1 + along_v3, along_v1 - along_v3] {
        let normal = v2.cross(&kept);
        let before = Matrix3::from_columns(&[v2, kept, normal]);
        let (h_v2, h_kept) = (h * v2, h * kept);
        let after = Matrix3::from_columns(&[h_v2, h_kept, h_v2.cross(&h_kept)]);
        let rotation = after * before.transpose();
        let translation = (h - rotation) * normal;
        let mut pose = Pose::from_rotation_matrix(&rotation, &translation);
        pose.rotation.renormalize();
        if pose.is_finite() {
            solutions.push((pose, normal));
            solutions.push((Pose::new(pose.rotation, -translation), -normal));
        }
    }
    solutions
}
