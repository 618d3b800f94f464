//! The Schur complement: landmarks are eliminated one by one, each with matrices of fixed size.
//!
//! ```text
//!   reduced    [ A   E ] [ x ]      [ g_r ]       A: poses with poses         (sparse blocks)
//!   landmarks  [ Eᵀ  C ] [ δ ]  = − [ g   ]       C: one small block for each landmark
//!                                                 E: poses with landmarks
//! ```
//!
//! No factor has two landmarks, so `C` is block-diagonal, and the second row gives each landmark's step by
//! itself: `δ = −C⁻¹ (g + Eᵀ x)`. Put into the first row, that leaves a system of the poses alone,
//!
//! ```text
//!   S x = b,    S = A − E C⁻¹ Eᵀ,    b = −g_r + E C⁻¹ g.
//! ```
//!
//! `C⁻¹` is never formed: with `C = L Lᵀ` (damped), `F = E L⁻ᵀ` and `y = L⁻¹ g` it is `S = A − F Fᵀ`,
//! `b = −g_r + F y`, which keeps `S` symmetric to the last bit and costs half. A landmark touches `S` only
//! where two of its members meet; with members `a`, `b`, `c` it subtracts
//!
//! ```text
//!          a       b       c
//!   a  [ Fa Faᵀ                 ]      the diagonal blocks at ReducedVariable::diagonal,
//!   b  [ Fb Faᵀ  Fb Fbᵀ         ]      those below at Layout::pairs, in the order
//!   c  [ Fc Faᵀ  Fc Fbᵀ  Fc Fcᵀ ]      (a,b) (a,c) (b,c)
//! ```
//!
//! This is where bundle adjustment spends its time: `n (n + 1) / 2` products for a landmark of `n` members.
//! Blocks of 6 rows (poses) therefore have a path of their own, whose loops the compiler unrolls.
//!
//! Landmarks come in the order of their ids, so the sums are the same on every run.

use nalgebra::{SMatrix, SVector};

use crate::arithmetic::{Arithmetic, vectorized};
use crate::layout::{Landmark, Member, ReducedVariable};

/// A landmark's pivot, relative to its own diagonal entry, below which the landmark is held in this
/// iteration: for a point that is a parallax of about 0.0006 degrees.
const MIN_RELATIVE_PIVOT: f64 = 1e-10;

/// Marquardt's damping `λ max(h_ii, floor)` of the diagonal entry `h_ii`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    pub lambda: f64,
    pub floor: f64,
}

impl Damping {
    /// No damping at all.
    pub(crate) const NONE: Self = Self { lambda: 0.0, floor: 0.0 };

    #[inline]
    pub(crate) fn of(self, diagonal: f64) -> f64 {
        self.lambda * diagonal.max(self.floor)
    }
}

/// The landmarks of one store, with the index of the first among all of them.
#[derive(Clone, Copy)]
pub(crate) struct LandmarkSpan<'a> {
    pub first: usize,
    pub landmarks: &'a [Landmark],
}

/// The linear system of one iteration, being reduced or solved.
pub(crate) struct Schur<'a> {
    /// Blocks and gradient of the normal equations.
    pub blocks: &'a [f64],
    pub gradient: &'a [f64],
    pub reduced: &'a [ReducedVariable],
    pub members: &'a [Member],
    pub pairs: &'a [u32],
    pub damping: Damping,
    /// The reduced system, laid out as the first part of `blocks`.
    pub system: &'a mut [f64],
    /// First the right-hand side of the reduced system, then the whole step.
    pub step: &'a mut [f64],
    /// Room for `F` of the landmark with the most members.
    pub scratch: &'a mut [f64],
    /// Which landmarks could not be eliminated and stay where they are.
    pub held: &'a mut [bool],
}

/// From a tangent vector's type to the elimination of landmarks of its length. Implemented for every
/// `SVector<f64, N>`; nobody outside the crate can name it.
#[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
pub trait Eliminate {
    /// See [`Schur::eliminate`].
    fn eliminate(schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>);
    /// See [`Schur::back_substitute`].
    fn back_substitute(schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>);
}

#[expect(private_interfaces, reason = "sealed: only this crate can call these functions")]
impl<const N: usize> Eliminate for SVector<f64, N> {
    fn eliminate(schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>) {
        vectorized!(M => schur.eliminate::<M, N>(landmarks));
    }

    fn back_substitute(schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>) {
        vectorized!(M => schur.back_substitute::<M, N>(landmarks));
    }
}

impl Schur<'_> {
    /// Fills `system` and the right-hand side with the damped reduced blocks.
    pub(crate) fn begin(&mut self) {
        self.system.copy_from_slice(&self.blocks[..self.system.len()]);
        for variable in self.reduced {
            for i in 0..variable.dim {
                let entry = &mut self.system[variable.diagonal + i * (variable.dim + 1)];
                *entry += self.damping.of(*entry);
                self.step[variable.gradient + i] = -self.gradient[variable.gradient + i];
            }
        }
    }

    /// Subtracts what landmarks of dimension `N` contribute to the reduced system.
    #[inline(always)]
    fn eliminate<M: Arithmetic, const N: usize>(&mut self, span: LandmarkSpan<'_>) {
        for (index, landmark) in span.landmarks.iter().enumerate() {
            // A landmark that its observations do not fix (no parallax) is held where it is: as if it were
            // known.
            let lower = self.factor::<N>(landmark);
            self.held[span.first + index] = lower.is_none();
            let Some(lower) = lower else { continue };
            // y = L⁻¹ g
            let y =
                solve_lower(&lower, &SVector::from_column_slice(&self.gradient[landmark.gradient..][..N]));
            // F = E L⁻ᵀ, member by member into the scratch memory; b += F y on the way.
            let members = &self.members[landmark.members.clone()];
            let mut filled = 0;
            for member in members {
                let variable = self.reduced[member.reduced as usize];
                let size = variable.dim * N;
                let f = &mut self.scratch[filled..filled + size];
                let e = &self.blocks[member.cross as usize..][..size];
                let rhs = &mut self.step[variable.gradient..][..variable.dim];
                if variable.dim == 6 {
                    scale_columns::<M, 6, N>(f, e, &lower, &y, rhs);
                } else {
                    scale_columns_any::<N>(f, e, variable.dim, &lower, &y, rhs);
                }
                filled += size;
            }
            // S −= F Fᵀ
            self.subtract_products::<M, N>(members, &self.pairs[landmark.pairs..]);
        }
    }

    /// `S −= F Fᵀ` over all pairs of a landmark's members, whose `F` stand one behind the other in the
    /// scratch memory.
    #[inline(always)]
    fn subtract_products<M: Arithmetic, const N: usize>(&mut self, members: &[Member], pairs: &[u32]) {
        let mut pairs = pairs.iter();
        let mut a_at = 0;
        for (position, a) in members.iter().enumerate() {
            let a = self.reduced[a.reduced as usize];
            let fa = &self.scratch[a_at..][..a.dim * N];
            subtract::<M, N>(&mut self.system[a.diagonal..], fa, fa, a.dim, a.dim);
            let mut b_at = a_at + a.dim * N;
            for (b, &pair) in members[position + 1..].iter().zip(pairs.by_ref()) {
                let dim = self.reduced[b.reduced as usize].dim;
                let fb = &self.scratch[b_at..][..dim * N];
                subtract::<M, N>(&mut self.system[pair as usize..], fb, fa, dim, a.dim);
                b_at += dim * N;
            }
            a_at += a.dim * N;
        }
    }

    /// Completes the step for landmarks of dimension `N`, `δ = −C⁻¹ (g + Eᵀ x)`, from that of the reduced
    /// variables. Held ones get a step of zero.
    #[inline(always)]
    fn back_substitute<M: Arithmetic, const N: usize>(&mut self, span: LandmarkSpan<'_>) {
        for (index, landmark) in span.landmarks.iter().enumerate() {
            let factor = if self.held[span.first + index] { None } else { self.factor::<N>(landmark) };
            let mut sum = SVector::<f64, N>::zeros();
            // Factoring again is cheaper than to have kept `L` of every landmark.
            if let Some(lower) = factor {
                sum = -SVector::from_column_slice(&self.gradient[landmark.gradient..][..N]);
                for member in &self.members[landmark.members.clone()] {
                    let variable = self.reduced[member.reduced as usize];
                    let x = &self.step[variable.gradient..][..variable.dim];
                    let e = &self.blocks[member.cross as usize..][..variable.dim * N];
                    if variable.dim == 6 {
                        subtract_transposed::<M, 6, N>(&mut sum, e, x);
                    } else {
                        for (column, entry) in e.chunks_exact(variable.dim).zip(sum.iter_mut()) {
                            *entry -= column.iter().zip(x).map(|(e, x)| e * x).sum::<f64>();
                        }
                    }
                }
                // C⁻¹ = L⁻ᵀ L⁻¹
                sum = solve_lower_transposed(&lower, &solve_lower(&lower, &sum));
            }
            self.step[landmark.gradient..][..N].copy_from_slice(sum.as_slice());
        }
    }

    /// Cholesky factor of a landmark's damped block, its diagonal inverted; `None` when it is singular.
    #[inline(always)]
    fn factor<const N: usize>(&self, landmark: &Landmark) -> Option<SMatrix<f64, N, N>> {
        let mut c = SMatrix::<f64, N, N>::from_column_slice(&self.blocks[landmark.diagonal..][..N * N]);
        for k in 0..N {
            // What is left of the damped diagonal after the columns before; if hardly anything, the landmark
            // is not determined in this direction, and dividing by it would send it anywhere.
            let diagonal = c[(k, k)] + self.damping.of(c[(k, k)]);
            let mut pivot = diagonal;
            for j in 0..k {
                pivot -= c[(k, j)] * c[(k, j)];
            }
            let sound =
                pivot.is_finite() && pivot > MIN_RELATIVE_PIVOT * diagonal && pivot > f64::MIN_POSITIVE;
            if !sound {
                return None;
            }
            let inverse = 1.0 / pivot.sqrt();
            c[(k, k)] = inverse;
            for i in k + 1..N {
                let mut entry = c[(i, k)];
                for j in 0..k {
                    entry -= c[(i, j)] * c[(k, j)];
                }
                c[(i, k)] = entry * inverse;
            }
        }
        Some(c)
    }
}

/// `L x = b`, with `L` holding the inverses of its diagonal.
#[inline(always)]
fn solve_lower<const N: usize>(lower: &SMatrix<f64, N, N>, b: &SVector<f64, N>) -> SVector<f64, N> {
    let mut x = *b;
    for i in 0..N {
        for j in 0..i {
            x[i] -= lower[(i, j)] * x[j];
        }
        x[i] *= lower[(i, i)];
    }
    x
}

/// `Lᵀ x = b`, with `L` holding the inverses of its diagonal.
#[inline(always)]
fn solve_lower_transposed<const N: usize>(
    lower: &SMatrix<f64, N, N>,
    b: &SVector<f64, N>,
) -> SVector<f64, N> {
    let mut x = *b;
    for i in (0..N).rev() {
        for j in i + 1..N {
            x[i] -= lower[(j, i)] * x[j];
        }
        x[i] *= lower[(i, i)];
    }
    x
}

/// `F = E L⁻ᵀ` and `rhs += F y` for a block of `D` rows.
#[inline(always)]
fn scale_columns<M: Arithmetic, const D: usize, const N: usize>(
    f: &mut [f64],
    e: &[f64],
    lower: &SMatrix<f64, N, N>,
    y: &SVector<f64, N>,
    rhs: &mut [f64],
) {
    let e = SMatrix::<f64, D, N>::from_column_slice(e);
    let mut scaled = SMatrix::<f64, D, N>::zeros();
    let mut sum = SVector::<f64, D>::zeros();
    for k in 0..N {
        for i in 0..D {
            let mut entry = e[(i, k)];
            for j in 0..k {
                entry = M::multiply_add(-scaled[(i, j)], lower[(k, j)], entry);
            }
            scaled[(i, k)] = entry * lower[(k, k)];
            sum[i] = M::multiply_add(scaled[(i, k)], y[k], sum[i]);
        }
    }
    f.copy_from_slice(scaled.as_slice());
    rhs.iter_mut().zip(sum.iter()).for_each(|(rhs, sum)| *rhs += sum);
}

/// [`scale_columns`] for any number of rows.
#[inline(always)]
fn scale_columns_any<const N: usize>(
    f: &mut [f64],
    e: &[f64],
    dim: usize,
    lower: &SMatrix<f64, N, N>,
    y: &SVector<f64, N>,
    rhs: &mut [f64],
) {
    for k in 0..N {
        for i in 0..dim {
            let mut entry = e[k * dim + i];
            for j in 0..k {
                entry -= f[j * dim + i] * lower[(k, j)];
            }
            f[k * dim + i] = entry * lower[(k, k)];
            rhs[i] += f[k * dim + i] * y[k];
        }
    }
}

/// `sum −= Eᵀ x` for a block of `D` rows.
#[inline(always)]
fn subtract_transposed<M: Arithmetic, const D: usize, const N: usize>(
    sum: &mut SVector<f64, N>,
    e: &[f64],
    x: &[f64],
) {
    let (e, x) = (&e[..D * N], &x[..D]);
    for k in 0..N {
        let mut product = 0.0;
        for i in 0..D {
            product = M::multiply_add(e[k * D + i], x[i], product);
        }
        sum[k] -= product;
    }
}

/// `block −= fb faᵀ`, the block being `rows x columns`; fast for poses.
#[inline(always)]
fn subtract<M: Arithmetic, const N: usize>(
    block: &mut [f64],
    fb: &[f64],
    fa: &[f64],
    rows: usize,
    columns: usize,
) {
    if rows == 6 && columns == 6 {
        subtract_fixed::<M, 6, 6, N>(block, fb, fa);
    } else {
        for column in 0..columns {
            for k in 0..N {
                let scale = fa[k * columns + column];
                for row in 0..rows {
                    block[column * rows + row] -= fb[k * rows + row] * scale;
                }
            }
        }
    }
}

/// [`subtract`] for blocks of fixed size: one column at a time stays in registers.
#[inline(always)]
fn subtract_fixed<M: Arithmetic, const R: usize, const C: usize, const N: usize>(
    block: &mut [f64],
    fb: &[f64],
    fa: &[f64],
) {
    let fb: [[f64; R]; N] = std::array::from_fn(|k| std::array::from_fn(|row| fb[..R * N][k * R + row]));
    let fa = &fa[..C * N];
    let (columns, _) = block[..R * C].as_chunks_mut::<R>();
    for (index, column) in columns.iter_mut().enumerate() {
        let mut sum = *column;
        for k in 0..N {
            let scale = -fa[k * C + index];
            for row in 0..R {
                sum[row] = M::multiply_add(fb[k][row], scale, sum[row]);
            }
        }
        *column = sum;
    }
}
