//! Where every block of the normal equations lies: sparsity pattern and offsets into one flat buffer.
//!
//! Poses `A`, `B`, `C` stay in the reduced system, points `p`, `q` are landmarks; `p` is seen from `A` and
//! `B`, `q` from `B` and `C`. Of the symmetric Hessian these blocks are kept:
//!
//! ```text
//!        A    B    C  |  p    q
//!   A  [ AA           |  Ap      ]     A block named `XY` has the rows of X and the columns of Y.
//!   B  [ BA   BB      |  Bp   Bq ]     Blanks are zero, or the transpose of a block that is there.
//!   C  [      CB   CC |       Cq ]
//!      [--------------+----------]
//!   p  [              |  pp      ]
//!   q  [              |       qq ]
//!
//!   buffer:  AA BA BB CB CC | pp qq | Ap Bp Bq Cq
//!            reduced system   diagonal  cross blocks
//!            by columns       blocks    landmark by landmark
//! ```
//!
//! `BA` is there although no factor ties `A` and `B`: the Schur complement over `p` fills it. `CA` is not,
//! since no landmark and no factor has both. Every block is column-major. The gradient is a second buffer,
//! `A B C | p q`.
//!
//! A landmark's *members* are the reduced variables it is tied to, in their order (`p`: `A`, `B`); its
//! *pairs* say where the product of two members goes in the reduced system (`p`: `BA`). They are listed as
//!
//! ```text
//!   (0,1) (0,2) … (0,n−1)   (1,2) (1,3) … (1,n−1)   …   (n−2,n−1)
//! ```

use std::ops::Range;

/// Marks a fixed variable, or a pair of variables of which at least one is fixed.
pub(crate) const NO_SLOT: u32 = u32::MAX;

/// Set on a pair's offset when the block is stored as (second member) x (first member).
pub(crate) const TRANSPOSED: u32 = 1 << 31;

/// Where a variable's gradient and its diagonal block of the Hessian begin; `NO_SLOT` when it is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct VariableSlot {
    pub gradient: u32,
    pub diagonal: u32,
}

impl VariableSlot {
    pub(crate) const FIXED: Self = Self { gradient: NO_SLOT, diagonal: NO_SLOT };

    #[inline(always)]
    pub(crate) fn is_fixed(self) -> bool {
        self.gradient == NO_SLOT
    }
}

/// Where the products of two different members of a factor go, in the order (0,1), (0,2), (1,2).
pub(crate) type FactorPairs = [u32; 3];

/// A free variable of the reduced system.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReducedVariable {
    pub dim: usize,
    /// Offset in the gradient.
    pub gradient: usize,
    /// Offset of the diagonal block, `dim x dim`.
    pub diagonal: usize,
}

/// A free landmark, to be eliminated.
#[derive(Clone, Debug)]
pub(crate) struct Landmark {
    /// Offset in the gradient.
    pub gradient: usize,
    /// Offset of the diagonal block.
    pub diagonal: usize,
    /// Range in [`Layout::members`].
    pub members: Range<usize>,
    /// Start in [`Layout::pairs`] of the blocks of member pairs `(a, b)`, `a < b`, `b` running fastest.
    pub pairs: usize,
}

impl Landmark {
    /// Number of pairs of `n_members` members.
    pub(crate) fn n_pairs(n_members: usize) -> usize {
        n_members * n_members.saturating_sub(1) / 2
    }

    /// Where in [`Layout::pairs`] those with member `a` as the first begin.
    ///
    /// The members before `a` have `n − 1`, `n − 2`, …, `n − a` pairs, together `a (2n − a − 1) / 2`.
    pub(crate) fn pairs_of(&self, a: usize) -> usize {
        self.pairs + a * (2 * self.members.len() - a - 1) / 2
    }
}

/// A reduced variable that a landmark is tied to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Member {
    /// Index in [`Layout::reduced`].
    pub reduced: u32,
    /// Offset of the block (reduced x landmark).
    pub cross: u32,
}

/// Order, sparsity and layout of the normal equations; offsets are into `NormalEquations`.
#[derive(Default)]
pub(crate) struct Layout {
    pub reduced: Vec<ReducedVariable>,
    pub landmarks: Vec<Landmark>,
    /// Range of `landmarks` per store.
    pub spans: Vec<Range<usize>>,
    pub members: Vec<Member>,
    pub pairs: Vec<u32>,
    /// Blocks strictly below the diagonal, by block columns: rows and offsets of column `c` are at
    /// `column_starts[c]..column_starts[c + 1]`; a block is `dim(row) x dim(column)`.
    pub column_starts: Vec<usize>,
    pub rows: Vec<u32>,
    pub offsets: Vec<u32>,
    /// Scalar dimension of the reduced system.
    pub n_reduced_dims: usize,
    /// Length of the part of the blocks that belongs to the reduced system.
    pub n_reduced_blocks: usize,
    pub n_blocks: usize,
    pub n_gradient: usize,
    /// The most members any landmark has.
    pub max_members: usize,
    pub max_reduced_dim: usize,
    pub max_landmark_dim: usize,
}

impl Layout {
    /// The blocks strictly below the diagonal of a column, as positions in `rows` and `offsets`.
    pub(crate) fn below(&self, column: usize) -> Range<usize> {
        self.column_starts[column]..self.column_starts[column + 1]
    }

    /// The share of the blocks below the diagonal that are there.
    pub(crate) fn fill(&self) -> f64 {
        let n = self.reduced.len();
        self.rows.len() as f64 / (n * n.saturating_sub(1) / 2).max(1) as f64
    }
}
