//! Cholesky factorization of the reduced system by faer, dense or sparse, without allocating per iteration.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Mat, MatMut, Par, Side};

use crate::layout::Layout;

/// Up to this dimension dense factorization wins whatever the sparsity.
const DENSE_DIM: usize = 300;
/// Above [`DENSE_DIM`], the share of present blocks from which dense factorization still wins.
const DENSE_FILL: f64 = 0.4;

/// One thread: a session's work stays on the session's thread, and sums keep their order.
const SEQUENTIAL: Par = Par::Seq;

/// How the reduced system is factorized.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinearSolver {
    /// Dense for small or densely connected problems, sparse for large and loose ones.
    #[default]
    Auto,
    /// Dense Cholesky.
    Dense,
    /// Sparse Cholesky under a minimum-degree ordering.
    Sparse,
}

/// The reduced system is not positive definite at this damping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NotPositiveDefinite;

/// Factorizes and solves the reduced system, with all its memory set aside.
pub(crate) enum ReducedSolver {
    Dense(DenseCholesky),
    Sparse(Box<SparseCholesky>),
}

impl ReducedSolver {
    pub(crate) fn new(layout: &Layout, choice: LinearSolver) -> Self {
        let dense = match choice {
            LinearSolver::Dense => true,
            LinearSolver::Sparse => layout.n_reduced_dims == 0,
            LinearSolver::Auto => layout.n_reduced_dims <= DENSE_DIM || layout.fill() >= DENSE_FILL,
        };
        if dense {
            Self::Dense(DenseCholesky::new(layout.n_reduced_dims))
        } else {
            Self::Sparse(Box::new(SparseCholesky::new(layout)))
        }
    }

    /// Factorizes `system`, laid out as in `layout`.
    pub(crate) fn factorize(&mut self, layout: &Layout, system: &[f64]) -> Result<(), NotPositiveDefinite> {
        match self {
            Self::Dense(dense) => dense.factorize(layout, system),
            Self::Sparse(sparse) => sparse.factorize(layout, system),
        }
    }

    /// Solves in place with the last factorization.
    pub(crate) fn solve(&mut self, rhs: &mut [f64]) {
        match self {
            Self::Dense(dense) => dense.solve(rhs),
            Self::Sparse(sparse) => sparse.solve(rhs),
        }
    }
}

pub(crate) struct DenseCholesky {
    matrix: Mat<f64>,
    memory: MemBuffer,
}

impl DenseCholesky {
    fn new(dim: usize) -> Self {
        let factorize = llt::factor::cholesky_in_place_scratch::<f64>(dim, SEQUENTIAL, Default::default());
        let solve = llt::solve::solve_in_place_scratch::<f64>(dim, 1, SEQUENTIAL);
        Self { matrix: Mat::zeros(dim, dim), memory: MemBuffer::new(StackReq::any_of(&[factorize, solve])) }
    }

    fn factorize(&mut self, layout: &Layout, system: &[f64]) -> Result<(), NotPositiveDefinite> {
        let mut matrix = self.matrix.as_mut();
        matrix.fill(0.0);
        for (index, column) in layout.reduced.iter().enumerate() {
            let below = layout.below(index);
            let below = below.map(|at| {
                let row = &layout.reduced[layout.rows[at] as usize];
                (row.gradient, row.dim, layout.offsets[at] as usize)
            });
            for (row, rows, offset) in
                std::iter::once((column.gradient, column.dim, column.diagonal)).chain(below)
            {
                for (c, values) in system[offset..offset + rows * column.dim].chunks_exact(rows).enumerate() {
                    let target = matrix.as_mut().col_mut(column.gradient + c).subrows_mut(row, rows);
                    let target = target.try_as_col_major_mut().expect("Mat is column-major");
                    target.as_slice_mut().copy_from_slice(values);
                }
            }
        }
        let stack = MemStack::new(&mut self.memory);
        llt::factor::cholesky_in_place(matrix, Default::default(), SEQUENTIAL, stack, Default::default())
            .map(|_| ())
            .map_err(|_| NotPositiveDefinite)
    }

    fn solve(&mut self, rhs: &mut [f64]) {
        let stack = MemStack::new(&mut self.memory);
        let n = rhs.len();
        let rhs = MatMut::from_column_major_slice_mut(rhs, n, 1);
        llt::solve::solve_in_place(self.matrix.as_ref(), rhs, SEQUENTIAL, stack);
    }
}

pub(crate) struct SparseCholesky {
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
    /// Lower triangle of the system, in the order of `pattern`.
    values: Vec<f64>,
    factor: Vec<f64>,
    memory: MemBuffer,
}

impl SparseCholesky {
    fn new(layout: &Layout) -> Self {
        let pattern = lower_pattern(layout);
        let symbolic = factorize_symbolic_cholesky(
            pattern.as_ref(),
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .expect("the pattern is a valid square matrix that fits in memory");
        let factorize = symbolic.factorize_numeric_llt_scratch::<f64>(SEQUENTIAL, Default::default());
        let solve = symbolic.solve_in_place_scratch::<f64>(1, SEQUENTIAL);
        Self {
            values: vec![0.0; pattern.row_idx().len()],
            factor: vec![0.0; symbolic.len_val()],
            memory: MemBuffer::new(StackReq::any_of(&[factorize, solve])),
            pattern,
            symbolic,
        }
    }

    fn factorize(&mut self, layout: &Layout, system: &[f64]) -> Result<(), NotPositiveDefinite> {
        let mut filled = 0;
        for (index, column) in layout.reduced.iter().enumerate() {
            for c in 0..column.dim {
                let diagonal = &system[column.diagonal + c * column.dim..][c..column.dim];
                self.values[filled..filled + diagonal.len()].copy_from_slice(diagonal);
                filled += diagonal.len();
                for at in layout.below(index) {
                    let rows = layout.reduced[layout.rows[at] as usize].dim;
                    let block = &system[layout.offsets[at] as usize + c * rows..][..rows];
                    self.values[filled..filled + rows].copy_from_slice(block);
                    filled += rows;
                }
            }
        }
        let matrix = SparseColMatRef::new(self.pattern.as_ref(), &self.values[..]);
        let stack = MemStack::new(&mut self.memory);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                matrix,
                Side::Lower,
                Default::default(),
                SEQUENTIAL,
                stack,
                Default::default(),
            )
            .map(|_| ())
            .map_err(|_| NotPositiveDefinite)
    }

    fn solve(&mut self, rhs: &mut [f64]) {
        let stack = MemStack::new(&mut self.memory);
        let n = rhs.len();
        let rhs = MatMut::from_column_major_slice_mut(rhs, n, 1);
        LltRef::new(&self.symbolic, &self.factor).solve_in_place_with_conj(Conj::No, rhs, SEQUENTIAL, stack);
    }
}

/// The scalar pattern of the lower triangle, column by column.
fn lower_pattern(layout: &Layout) -> SymbolicSparseColMat<usize> {
    let n = layout.n_reduced_dims;
    let mut column_ptr = Vec::with_capacity(n + 1);
    let mut row_idx = Vec::new();
    column_ptr.push(0);
    for (index, column) in layout.reduced.iter().enumerate() {
        for c in 0..column.dim {
            row_idx.extend(column.gradient + c..column.gradient + column.dim);
            for &row in &layout.rows[layout.below(index)] {
                let row = &layout.reduced[row as usize];
                row_idx.extend(row.gradient..row.gradient + row.dim);
            }
            column_ptr.push(row_idx.len());
        }
    }
    SymbolicSparseColMat::new_checked(n, n, column_ptr, None, row_idx)
}
