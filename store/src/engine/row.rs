//! A row of either database.

use crate::StoreError;
use sqlx::postgres::PgRow;
use sqlx::sqlite::SqliteRow;
use sqlx::{ColumnIndex, Decode, Postgres, Row as _, Sqlite, Type, TypeInfo, ValueRef};

/// A row that was answered.
pub(crate) enum Row {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

/// What a column can be read as.
pub(crate) trait Column<'r>:
    Decode<'r, Sqlite> + Type<Sqlite> + Decode<'r, Postgres> + Type<Postgres>
{
}

impl<'r, T: Decode<'r, Sqlite> + Type<Sqlite> + Decode<'r, Postgres> + Type<Postgres>> Column<'r> for T {}

/// What a column holds, of whichever type.
pub(crate) enum Held<'r> {
    Null,
    Int(i64),
    Real(f64),
    Text(&'r str),
    Bytes(&'r [u8]),
}

impl Row {
    /// The value of a column.
    pub fn try_get<'r, T: Column<'r>, I>(&'r self, column: I) -> Result<T, StoreError>
    where
        I: ColumnIndex<SqliteRow> + ColumnIndex<PgRow>,
    {
        Ok(match self {
            Self::Sqlite(row) => row.try_get(column)?,
            Self::Postgres(row) => row.try_get(column)?,
        })
    }

    /// How many columns it has.
    pub fn len(&self) -> usize {
        match self {
            Self::Sqlite(row) => row.len(),
            Self::Postgres(row) => row.len(),
        }
    }

    /// The value of a column whose type is not known beforehand; truth values are 0 and 1.
    pub fn any(&self, column: usize) -> Result<Held<'_>, StoreError> {
        let (is_null, kind) = match self {
            Self::Sqlite(row) => {
                let value = row.try_get_raw(column)?;
                (value.is_null(), value.type_info().name().to_owned())
            }
            Self::Postgres(row) => {
                let value = row.try_get_raw(column)?;
                (value.is_null(), value.type_info().name().to_owned())
            }
        };
        if is_null {
            return Ok(Held::Null);
        }
        Ok(match kind.as_str() {
            "REAL" | "FLOAT8" => Held::Real(self.try_get(column)?),
            "TEXT" => Held::Text(self.try_get(column)?),
            "BLOB" | "BYTEA" => Held::Bytes(self.try_get(column)?),
            "BOOL" => Held::Int(i64::from(self.try_get::<bool, _>(column)?)),
            _ => Held::Int(self.try_get(column)?),
        })
    }
}
