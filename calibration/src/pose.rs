//! The pose of a board by one picture and a camera that is roughly known.

use geometry::nalgebra::{Matrix3, SMatrix, SymmetricEigen, Vector3};
use geometry::{Camera, Pose};

use crate::{Board, View};

/// `camera_from_board` by the homography that takes the board's plane to the rays of its corners. `None`
/// where the camera has no rays for them, or they are of no plane.
pub fn board_pose(camera: &Camera, board: &Board, view: &View) -> Option<Pose> {
    let corners: Vec<Vector3<f64>> = board.corners().collect();
    // Numbers around one.
    let center = corners.iter().sum::<Vector3<f64>>() / corners.len() as f64;
    let size = corners.iter().map(|corner| (corner - center).norm()).fold(0.0, f64::max);
    let from_board =
        |corner: &Vector3<f64>| Vector3::new((corner.x - center.x) / size, (corner.y - center.y) / size, 1.0);
    let rays: Vec<Vector3<f64>> =
        view.corners.iter().map(|pixel| camera.unproject(pixel)).collect::<Option<_>>()?;
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (corner, ray) in corners.iter().zip(&rays) {
        // ray x (H m) = 0, row by row of H.
        let (m, skew) = (from_board(corner), geometry::so3::skew(ray));
        let mut equations = SMatrix::<f64, 3, 9>::zeros();
        for row in 0..3 {
            equations.fixed_view_mut::<3, 3>(0, 3 * row).copy_from(&(skew.column(row) * m.transpose()));
        }
        normal += equations.transpose() * equations;
    }
    let eigen = SymmetricEigen::new(normal);
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let homography = Matrix3::from_row_slice(least.as_slice());
    let agreement: f64 =
        corners.iter().zip(&rays).map(|(corner, ray)| ray.dot(&(homography * from_board(corner)))).sum();
    let homography = homography * agreement.signum();
    let (x, y) = (homography.column(0).into_owned(), homography.column(1).into_owned());
    let length = 0.5 * (x.norm() + y.norm());
    if !(length.is_finite() && length > 0.0) {
        return None;
    }
    let rough = Matrix3::from_columns(&[x / length, y / length, x.cross(&y) / (length * length)]);
    let svd = rough.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let rotation = if rotation.determinant() < 0.0 { return None } else { rotation };
    let middle = homography.column(2) * (size / length);
    let translation = middle - rotation * center;
    let pose = Pose::from_rotation_matrix(&rotation, &translation);
    pose.translation.iter().all(|x| x.is_finite()).then_some(pose)
}
