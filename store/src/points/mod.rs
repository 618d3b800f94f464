//! Points: their rows, and where in space they are.

pub(crate) mod cell;
mod query;
mod row;

pub use query::{Bounds, PointQuery};
pub(crate) use query::{push_cell_keys, region, select_points};
pub use row::PlacedPoint;
use row::{Form, PLACED};
pub(crate) use row::{POINT_COLUMNS, PointRow, WHOLE, parse_point};
