//! The essential matrices of five pairs of bearings [Nistér 2004].

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector3};

use crate::polynomial;

/// The real essential matrices (up to ten, of norm √2) of five pairs of unit bearings, exactly; of more
/// pairs, in the least-squares sense.
///
/// Empty if the slices differ in length or are shorter than five, or anything is not finite.
pub fn essential_five_point(bearings_a: &[Vector3<f64>], bearings_b: &[Vector3<f64>]) -> Vec<Matrix3<f64>> {
    if bearings_a.len() != bearings_b.len() || bearings_a.len() < 5 {
        return Vec::new();
    }
    let Some(basis) = null_space(bearings_a, bearings_b) else { return Vec::new() };
    let Some(reduced) = eliminate(constraints(&basis)) else { return Vec::new() };
    let system = UnivariateSystem::new(&reduced);
    let mut solutions = Vec::with_capacity(10);
    for z in polynomial::real_roots(&system.determinant()) {
        let Some((x, y)) = system.solve_at(z) else { continue };
        let essential = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
        let norm = essential.norm();
        if norm.is_finite() && norm > 0.0 {
            solutions.push(essential * (std::f64::consts::SQRT_2 / norm));
        }
    }
    solutions
}

/// Four orthonormal matrices whose combinations satisfy `bᵀ E a = 0` for all pairs.
fn null_space(bearings_a: &[Vector3<f64>], bearings_b: &[Vector3<f64>]) -> Option<[Matrix3<f64>; 4]> {
    let row = |a: &Vector3<f64>, b: &Vector3<f64>| {
        SVector::<f64, 9>::from([
            b.x * a.x,
            b.x * a.y,
            b.x * a.z,
            b.y * a.x,
            b.y * a.y,
            b.y * a.z,
            b.z * a.x,
            b.z * a.y,
            b.z * a.z,
        ])
    };
    let pairs = bearings_a.iter().zip(bearings_b);
    if !bearings_a.iter().chain(bearings_b).all(|b| b.iter().all(|x| x.is_finite())) {
        return None;
    }
    let as_matrix = |e: SVector<f64, 9>| Matrix3::from_row_slice(e.as_slice());
    if bearings_a.len() == 5 {
        let mut columns = SMatrix::<f64, 9, 5>::zeros();
        for (i, (a, b)) in pairs.enumerate() {
            columns.set_column(i, &row(a, b));
        }
        let mut q_transposed = SMatrix::<f64, 9, 9>::identity();
        columns.qr().q_tr_mul(&mut q_transposed);
        return Some(std::array::from_fn(|i| as_matrix(q_transposed.row(5 + i).transpose())));
    }
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in pairs {
        let r = row(a, b);
        normal.ger(1.0, &r, &r, 1.0);
    }
    let eigen = SymmetricEigen::new(normal);
    let mut order: [usize; 9] = std::array::from_fn(|i| i);
    order.sort_by(|i, j| eigen.eigenvalues[*i].total_cmp(&eigen.eigenvalues[*j]));
    // The best comes last: its coefficient is the one fixed to one, so it must not be zero.
    Some(std::array::from_fn(|i| as_matrix(eigen.eigenvectors.column(order[3 - i]).into_owned())))
}

/// Exponents of x, y, z of the twenty monomials of degree up to three, in the order of Nistér's table: after
/// elimination the first ten are expressed by the last ten, which are of low degree in x and y.
const MONOMIALS: [[u8; 3]; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

/// Where x, y, z and 1 stand among [`MONOMIALS`].
const LINEAR: [usize; 4] = [12, 15, 18, 19];

/// Where the monomials of degree up to two stand among [`MONOMIALS`].
const QUADRATIC: [usize; 10] = [5, 7, 9, 11, 12, 14, 15, 17, 18, 19];

/// `PRODUCT[m][k]`: the index of monomial `m`, of degree up to two, times x, y, z or 1 (`k`).
const PRODUCT: [[usize; 4]; 20] = product_table();

const fn product_table() -> [[usize; 4]; 20] {
    let mut table = [[usize::MAX; 4]; 20];
    let mut m = 0;
    while m < 20 {
        let mut k = 0;
        while k < 4 {
            let mut exponents = MONOMIALS[m];
            if k < 3 {
                exponents[k] += 1;
            }
            let mut i = 0;
            while i < 20 {
                let e = MONOMIALS[i];
                if e[0] == exponents[0] && e[1] == exponents[1] && e[2] == exponents[2] {
                    table[m][k] = i;
                }
                i += 1;
            }
            k += 1;
        }
        m += 1;
    }
    table
}

/// A polynomial in x, y, z: coefficients of [`MONOMIALS`].
type Polynomial = [f64; 20];

/// `sum += factor * p * q`, `p` of degree up to one, `q` given by x, y, z, 1.
fn add_linear_product(sum: &mut Polynomial, factor: f64, p: &[f64; 4], q: &[f64; 4]) {
    for (i, monomial) in LINEAR.into_iter().enumerate() {
        for k in 0..4 {
            sum[PRODUCT[monomial][k]] += factor * p[i] * q[k];
        }
    }
}

/// `sum += factor * p * q`, `p` of degree up to two, `q` given by x, y, z, 1.
fn add_quadratic_product(sum: &mut Polynomial, factor: f64, p: &Polynomial, q: &[f64; 4]) {
    for monomial in QUADRATIC {
        for k in 0..4 {
            sum[PRODUCT[monomial][k]] += factor * p[monomial] * q[k];
        }
    }
}

/// The ten cubic equations an essential matrix satisfies, `det E = 0` and `2 E Eᵀ E = tr(E Eᵀ) E`, for
/// `E = x X + y Y + z Z + W`.
fn constraints(basis: &[Matrix3<f64>; 4]) -> SMatrix<f64, 10, 20> {
    let e: [[[f64; 4]; 3]; 3] =
        std::array::from_fn(|r| std::array::from_fn(|c| std::array::from_fn(|k| basis[k][(r, c)])));
    let mut equations = SMatrix::<f64, 10, 20>::zeros();

    let mut determinant = [0.0; 20];
    for c in 0..3 {
        let (c1, c2) = ((c + 1) % 3, (c + 2) % 3);
        let mut minor = [0.0; 20];
        add_linear_product(&mut minor, 1.0, &e[1][c1], &e[2][c2]);
        add_linear_product(&mut minor, -1.0, &e[1][c2], &e[2][c1]);
        add_quadratic_product(&mut determinant, 1.0, &minor, &e[0][c]);
    }
    equations.row_mut(0).copy_from_slice(&determinant);

    // 2 E Eᵀ - tr(E Eᵀ) I, which is symmetric.
    let mut gram = [[[0.0; 20]; 3]; 3];
    let mut trace = [0.0; 20];
    for (r, row) in e.iter().enumerate() {
        for (c, other) in e.iter().enumerate() {
            for (p, q) in row.iter().zip(other) {
                add_linear_product(&mut gram[r][c], 2.0, p, q);
            }
        }
        row.iter().for_each(|p| add_linear_product(&mut trace, 1.0, p, p));
    }
    for (r, row) in gram.iter_mut().enumerate() {
        row[r].iter_mut().zip(&trace).for_each(|(entry, t)| *entry -= t);
    }
    for (r, row) in gram.iter().enumerate() {
        for c in 0..3 {
            let mut equation = [0.0; 20];
            for (p, q) in row.iter().zip(&e) {
                add_quadratic_product(&mut equation, 1.0, p, &q[c]);
            }
            equations.row_mut(1 + 3 * r + c).copy_from_slice(&equation);
        }
    }
    equations
}

/// Gauss-Jordan with row pivoting: the right half once the left half is the identity. `None` if that is
/// singular.
fn eliminate(mut m: SMatrix<f64, 10, 20>) -> Option<SMatrix<f64, 10, 10>> {
    for column in 0..10 {
        let pivot = (column..10).max_by(|i, j| m[(*i, column)].abs().total_cmp(&m[(*j, column)].abs()))?;
        m.swap_rows(column, pivot);
        let inverse = 1.0 / m[(column, column)];
        if !inverse.is_finite() {
            return None;
        }
        for c in column..20 {
            m[(column, c)] *= inverse;
        }
        for r in (0..10).filter(|r| *r != column) {
            let factor = m[(r, column)];
            for c in column..20 {
                m[(r, c)] -= factor * m[(column, c)];
            }
        }
    }
    Some(m.fixed_view::<10, 10>(0, 10).into_owned())
}

/// Three equations `x p(z) + y q(z) + r(z) = 0`, from which the terms in x², y² and xy are eliminated.
/// Polynomials ascending, of degree 3, 3 and 4.
struct UnivariateSystem {
    rows: [[[f64; 5]; 3]; 3],
}

impl UnivariateSystem {
    fn new(reduced: &SMatrix<f64, 10, 10>) -> Self {
        // Rows 4 and 5 start with x²z and x², 6 and 7 with y²z and y², 8 and 9 with xyz and xy.
        let rows = std::array::from_fn(|i| {
            let (upper, lower) = (reduced.row(4 + 2 * i), reduced.row(5 + 2 * i));
            // Columns: xz², xz, x, yz², yz, y, z³, z², z, 1. `upper - z lower`:
            let cubic = |first: usize| {
                [
                    upper[first + 2],
                    upper[first + 1] - lower[first + 2],
                    upper[first] - lower[first + 1],
                    -lower[first],
                    0.0,
                ]
            };
            let quartic =
                [upper[9], upper[8] - lower[9], upper[7] - lower[8], upper[6] - lower[7], -lower[6]];
            [cubic(0), cubic(3), quartic]
        });
        Self { rows }
    }

    /// The determinant of the system, of degree ten in z.
    fn determinant(&self) -> [f64; 11] {
        let mut determinant = [0.0; 11];
        for (i, row) in self.rows.iter().enumerate() {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let (next, last) = (&self.rows[j], &self.rows[k]);
            // Cofactor of the quartic of this row, of degree six.
            let mut cofactor = [0.0; 7];
            for (m, n) in (0..4).flat_map(|m| (0..4).map(move |n| (m, n))) {
                cofactor[m + n] += next[0][m] * last[1][n] - next[1][m] * last[0][n];
            }
            for (m, c) in cofactor.iter().enumerate() {
                for (n, q) in row[2].iter().enumerate() {
                    determinant[m + n] += c * q;
                }
            }
        }
        determinant
    }

    /// x and y for a root of the determinant.
    fn solve_at(&self, z: f64) -> Option<(f64, f64)> {
        let rows: [Vector3<f64>; 3] = std::array::from_fn(|i| {
            Vector3::from_fn(|j, _| self.rows[i][j].iter().rev().fold(0.0, |value, c| value * z + c))
                .normalize()
        });
        // The vector orthogonal to all three rows, from the two that differ most.
        let solution = [(0, 1), (0, 2), (1, 2)]
            .map(|(i, j)| rows[i].cross(&rows[j]))
            .into_iter()
            .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()))?;
        let (x, y) = (solution.x / solution.z, solution.y / solution.z);
        (x.is_finite() && y.is_finite()).then_some((x, y))
    }
}
