//! Points: their rows, and where in space they are.

pub(crate) mod cell;
mod query;
mod row;

pub use query::{Bounds, PointPage, PointQuery};
pub(crate) use row::{POINT_COLUMNS, PointRow, parse_point};
