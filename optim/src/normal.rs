//! The normal equations `H δ = −g` in blocks.

use nalgebra::{SMatrix, SVector};

use crate::arithmetic::Arithmetic;
use crate::layout::{NO_SLOT, TRANSPOSED, VariableSlot};

/// Gradient `g = Σ w Jᵀ r` and the blocks of `H = Σ w Jᵀ J`, each column-major, in one flat buffer:
/// first those of the reduced system (whole diagonal blocks, and below them the off-diagonal ones), then the
/// landmarks' diagonal blocks, then the (reduced x landmark) ones.
#[derive(Default)]
pub(crate) struct NormalEquations {
    pub blocks: Vec<f64>,
    pub gradient: Vec<f64>,
}

impl NormalEquations {
    /// All zeros, of the given lengths.
    pub(crate) fn resize(&mut self, n_blocks: usize, n_gradient: usize) {
        self.blocks.clear();
        self.blocks.resize(n_blocks, 0.0);
        self.gradient.clear();
        self.gradient.resize(n_gradient, 0.0);
    }

    /// Adds `(w J)ᵀ J` and `(w J)ᵀ r` at a variable's place.
    #[inline(always)]
    pub(crate) fn add_diagonal<M: Arithmetic, const R: usize, const N: usize>(
        &mut self,
        slot: VariableSlot,
        weighted: &SMatrix<f64, R, N>,
        jacobian: &SMatrix<f64, R, N>,
        residual: &SVector<f64, R>,
    ) {
        if slot.is_fixed() {
            return;
        }
        let gradient = &mut self.gradient[slot.gradient as usize..][..N];
        for (column, sum) in gradient.iter_mut().enumerate() {
            for row in 0..R {
                *sum = M::multiply_add(weighted[(row, column)], residual[row], *sum);
            }
        }
        add_product::<M, _, _, _>(&mut self.blocks, slot.diagonal, weighted, jacobian);
    }

    /// Adds the product of two members' derivatives at their common block.
    #[inline(always)]
    pub(crate) fn add_pair<M: Arithmetic, const R: usize, const NA: usize, const NB: usize>(
        &mut self,
        pair: u32,
        a: &SMatrix<f64, R, NA>,
        b: &SMatrix<f64, R, NB>,
    ) {
        if pair == NO_SLOT {
            return;
        }
        if pair & TRANSPOSED == 0 {
            add_product::<M, _, _, _>(&mut self.blocks, pair, a, b);
        } else {
            add_product::<M, _, _, _>(&mut self.blocks, pair & !TRANSPOSED, b, a);
        }
    }
}

/// `block += aᵀ b`, column-major.
#[inline(always)]
fn add_product<M: Arithmetic, const R: usize, const NA: usize, const NB: usize>(
    blocks: &mut [f64],
    offset: u32,
    a: &SMatrix<f64, R, NA>,
    b: &SMatrix<f64, R, NB>,
) {
    let (columns, _) = blocks[offset as usize..][..NA * NB].as_chunks_mut::<NA>();
    for (index, column) in columns.iter_mut().enumerate() {
        let mut sum = *column;
        for k in 0..R {
            let scale = b[(k, index)];
            for row in 0..NA {
                sum[row] = M::multiply_add(a[(k, row)], scale, sum[row]);
            }
        }
        *column = sum;
    }
}
