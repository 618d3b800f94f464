//! The normalized linear estimators [Hartley 1997].

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2};

/// The fundamental matrix, of rank two and unit norm, of eight or more pairs of points.
///
/// `None` if the slices differ in length or are shorter than eight, all points of one image coincide, or
/// anything is not finite. Degenerate scenes (planes) are not detected: any matrix of the family that fits is
/// returned.
pub fn fundamental_eight_point(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if a.len() != b.len() || a.len() < 8 {
        return None;
    }
    let (normalize_a, normalize_b) = (Normalization::of(a)?, Normalization::of(b)?);
    let mut rows = NullVector::new(a.len());
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (normalize_a.apply(a), normalize_b.apply(b));
        rows.push([b.x * a.x, b.x * a.y, b.x, b.y * a.x, b.y * a.y, b.y, a.x, a.y, 1.0]);
    }
    let f = Matrix3::from_row_slice(rows.solve()?.as_slice());
    let mut svd = f.svd(true, true);
    let smallest = svd.singular_values.imin();
    svd.singular_values[smallest] = 0.0;
    let f = svd.recompose().ok()?;
    finite_unit(normalize_b.matrix().transpose() * f * normalize_a.matrix())
}

/// The homography, of unit norm, of four or more pairs of points.
///
/// `None` if the slices differ in length or are shorter than four, all points of one image coincide, the
/// result is singular (three of four points on a line), or anything is not finite.
pub fn homography_four_point(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    /// Least determinant of the homography between normalized points, at unit norm.
    const MIN_DETERMINANT: f64 = 1e-8;
    if a.len() != b.len() || a.len() < 4 {
        return None;
    }
    let (normalize_a, normalize_b) = (Normalization::of(a)?, Normalization::of(b)?);
    let mut rows = NullVector::new(2 * a.len());
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (normalize_a.apply(a), normalize_b.apply(b));
        rows.push([a.x, a.y, 1.0, 0.0, 0.0, 0.0, -b.x * a.x, -b.x * a.y, -b.x]);
        rows.push([0.0, 0.0, 0.0, a.x, a.y, 1.0, -b.y * a.x, -b.y * a.y, -b.y]);
    }
    let h = Matrix3::from_row_slice(rows.solve()?.as_slice());
    if h.determinant().abs() < MIN_DETERMINANT {
        return None;
    }
    finite_unit(normalize_b.inverse_matrix() * h * normalize_a.matrix())
}

fn finite_unit(m: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let norm = m.norm();
    (norm.is_finite() && norm > 0.0).then(|| m / norm)
}

/// Moves the centroid to the origin and the mean distance from it to √2.
struct Normalization {
    centroid: Vector2<f64>,
    scale: f64,
}

impl Normalization {
    fn of(points: &[Vector2<f64>]) -> Option<Self> {
        let n = points.len() as f64;
        let centroid = points.iter().sum::<Vector2<f64>>() / n;
        let mean_distance = points.iter().map(|p| (p - centroid).norm()).sum::<f64>() / n;
        let scale = std::f64::consts::SQRT_2 / mean_distance;
        (scale.is_finite() && scale > 0.0).then_some(Self { centroid, scale })
    }

    #[inline]
    fn apply(&self, point: &Vector2<f64>) -> Vector2<f64> {
        (point - self.centroid) * self.scale
    }

    fn matrix(&self) -> Matrix3<f64> {
        let (s, c) = (self.scale, self.centroid);
        Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0)
    }

    fn inverse_matrix(&self) -> Matrix3<f64> {
        let (s, c) = (1.0 / self.scale, self.centroid);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }
}

/// The unit vector most orthogonal to a number of rows of nine.
///
/// For eight rows, the minimal sample, by a QR decomposition, which loses no digits; for more by the
/// eigenvectors of the normal equations, whose size does not grow with the data.
enum NullVector {
    Eight { rows: SMatrix<f64, 9, 8>, n: usize },
    Many { normal: SMatrix<f64, 9, 9> },
}

impl NullVector {
    fn new(n_rows: usize) -> Self {
        if n_rows == 8 {
            Self::Eight { rows: SMatrix::zeros(), n: 0 }
        } else {
            Self::Many { normal: SMatrix::zeros() }
        }
    }

    #[inline]
    fn push(&mut self, row: [f64; 9]) {
        let row = SVector::<f64, 9>::from(row);
        match self {
            Self::Eight { rows, n } => {
                rows.set_column(*n, &row);
                *n += 1;
            }
            Self::Many { normal } => normal.ger(1.0, &row, &row, 1.0),
        }
    }

    fn solve(self) -> Option<SVector<f64, 9>> {
        match self {
            Self::Eight { rows, .. } => {
                if !rows.iter().all(|x| x.is_finite()) {
                    return None;
                }
                // Qᵀ of the full decomposition; its last row is orthogonal to all columns.
                let mut q_transposed = SMatrix::<f64, 9, 9>::identity();
                rows.qr().q_tr_mul(&mut q_transposed);
                Some(q_transposed.row(8).transpose())
            }
            Self::Many { normal } => {
                if !normal.iter().all(|x| x.is_finite()) {
                    return None;
                }
                let eigen = SymmetricEigen::new(normal);
                Some(eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned())
            }
        }
    }
}
