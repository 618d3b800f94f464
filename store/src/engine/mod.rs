//! The two databases a store can be in, behind one way of asking them.
//!
//! Both take the same statements, with `$1`, `$2`, … for the bound values. Where their SQL differs, a
//! statement says so in one of two ways:
//!
//! - `id IN IDS($2)` and `id NOT IN IDS($2)` with a bound [`Value::Ids`] become what each has for lists;
//! - [`Connection::either`] chooses between two texts.
//!
//! Columns have the same names and the same order in both: whole numbers are `INTEGER` or `BIGINT`, numbers
//! `REAL` or `DOUBLE PRECISION`, blobs `BLOB` or `BYTEA`. So rows are read by the same code.

mod connection;
pub(crate) mod postgres;
mod query;
mod row;
mod rows;
pub(crate) mod sqlite;
mod value;

pub(crate) use connection::{Connection, Held};
pub(crate) use query::{Query, query};
pub(crate) use row::{Held as HeldValue, Row};
pub(crate) use rows::{Columns, MultiRow};
pub(crate) use value::{Value, ids};
