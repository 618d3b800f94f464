//! Lines: their rows, and where in space they are.

mod geometry;
mod query;
mod row;

pub(crate) use query::LineCursor;
pub use query::LineQuery;
pub(crate) use row::{LINE_COLUMNS, LineRow, N_LINE_COLUMNS, parse_line};
