//! The board, and where its corners are seen.

use geometry::nalgebra::{Vector2, Vector3};

/// Boards have no more corners than this in a row.
const MAX_CORNERS: usize = 60;

/// A chessboard by its inner corners, where four squares meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    columns: usize,
    rows: usize,
    square: f64,
}

/// Why a board cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct BoardError(String);

impl Board {
    /// By the numbers of inner corners, 3 to 60 either way, and the side of a square, meters.
    ///
    /// # Errors
    /// A sentence that says what is wrong.
    pub fn new(columns: usize, rows: usize, square: f64) -> Result<Self, BoardError> {
        if !(3..=MAX_CORNERS).contains(&columns) || !(3..=MAX_CORNERS).contains(&rows) {
            return Err(BoardError(format!(
                "a board has 3 to {MAX_CORNERS} inner corners, where four squares meet, in a row, not {columns}x{rows}"
            )));
        }
        if !(square.is_finite() && square > 0.0) {
            return Err(BoardError(format!("the side of a square must be a length in meters, not {square}")));
        }
        Ok(Self { columns, rows, square })
    }

    /// Inner corners in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Rows of inner corners.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// How many inner corners there are.
    pub fn n_corners(&self) -> usize {
        self.columns * self.rows
    }

    /// Where the corners are on the board, meters, row by row; z is zero.
    pub fn corners(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        (0..self.n_corners()).map(|idx| {
            let (column, row) = (idx % self.columns, idx / self.columns);
            Vector3::new(column as f64 * self.square, row as f64 * self.square, 0.0)
        })
    }
}

/// The corners of the board in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Pixels, in the order of [`Board::corners`]. Boards that look the same turned by half a turn may begin
    /// at either end.
    pub corners: Vec<Vector2<f64>>,
}
