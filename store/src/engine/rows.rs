//! Statements that write many rows each: a row then costs a microsecond instead of twenty.

use super::{Connection, Value, postgres};
use crate::StoreError;
use sqlx::postgres::PgArguments;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, AssertSqlSafe};

/// Rows per statement of SQLite, greatest first. Few sizes, so that each statement is prepared once and kept;
/// the largest binds well under SQLite's 32766 values and takes the caller's thread a tenth of a millisecond
/// to fill.
const CHUNK_SIZES: [usize; 4] = [128, 32, 8, 1];

/// Rows per statement of PostgreSQL, some two megabytes: one question and one answer for most updates.
/// Columns are sent as arrays, so that the text is the same for any number of rows.
const POSTGRES_ROWS: usize = 4096;

/// An insertion of rows, whatever their number.
pub(crate) struct MultiRow<'a> {
    pub table: &'static str,
    /// Their names in the order of the values, with a comma between.
    pub columns: &'a str,
    /// What follows the rows: what becomes of one that is there.
    pub conflict: &'static str,
    /// SQLite's virtual tables know nothing of that: there the row is replaced.
    pub is_virtual: bool,
}

impl MultiRow<'_> {
    /// Writes one row for each item, in their order.
    pub async fn write<T>(
        &self,
        connection: &mut Connection,
        items: &[T],
        mut bind: impl FnMut(&mut Columns, &T) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let n_columns = self.columns.split(',').count();
        match connection {
            Connection::Sqlite(held) => {
                let mut rest = items;
                for size in CHUNK_SIZES {
                    if rest.len() < size {
                        continue;
                    }
                    let sql = self.for_sqlite(n_columns, size);
                    while rest.len() >= size {
                        let (chunk, after) = rest.split_at(size);
                        rest = after;
                        let mut columns = Columns::Sqlite(SqliteArguments::default());
                        chunk.iter().try_for_each(|item| bind(&mut columns, item))?;
                        let Columns::Sqlite(arguments) = columns else { continue };
                        debug_assert_eq!(arguments.len(), size * n_columns, "{}", self.table);
                        // Safe: the text is made of constants.
                        let query = sqlx::query_with(AssertSqlSafe(sql.as_str()), arguments);
                        query.execute(&mut **held).await?;
                    }
                }
            }
            Connection::Postgres(held, patience) => {
                for chunk in items.chunks(POSTGRES_ROWS) {
                    let mut columns =
                        Columns::Postgres { arrays: Vec::with_capacity(n_columns), n_values: 0, n_columns };
                    chunk.iter().try_for_each(|item| bind(&mut columns, item))?;
                    let Columns::Postgres { arrays, n_values, .. } = columns else { continue };
                    debug_assert_eq!(n_values, chunk.len() * n_columns, "{}", self.table);
                    let mut arguments = PgArguments::default();
                    arrays.into_iter().try_for_each(|array| array.add_to(&mut arguments))?;
                    // Safe: the text is made of constants.
                    let query = sqlx::query_with(AssertSqlSafe(self.for_postgres(n_columns)), arguments);
                    let done = postgres::limited(*patience, query.execute(&mut **held)).await;
                    done.inspect_err(|_| held.close_on_drop())?;
                }
            }
        }
        Ok(())
    }

    fn for_sqlite(&self, n_columns: usize, n_rows: usize) -> String {
        let Self { table, columns, conflict, is_virtual } = self;
        let row = format!("({})", vec!["?"; n_columns].join(","));
        let rows = vec![row; n_rows].join(",");
        let (verb, conflict) = if *is_virtual { ("INSERT OR REPLACE", "") } else { ("INSERT", *conflict) };
        format!("{verb} INTO {table} ({columns}) VALUES {rows} {conflict}")
    }

    fn for_postgres(&self, n_columns: usize) -> String {
        let Self { table, columns, conflict, .. } = self;
        let arrays: Vec<String> = (1..=n_columns).map(|number| format!("${number}")).collect();
        format!("INSERT INTO {table} ({columns}) SELECT * FROM unnest({}) {conflict}", arrays.join(","))
    }
}

/// The values of a statement's rows, one after the other.
pub(crate) enum Columns {
    Sqlite(SqliteArguments),
    /// By column.
    Postgres {
        arrays: Vec<Array>,
        n_values: usize,
        n_columns: usize,
    },
}

impl Columns {
    pub fn add(&mut self, value: impl Into<Value>) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(arguments) => value.into().add_to_sqlite(arguments),
            Self::Postgres { arrays, n_values, n_columns } => {
                let column = *n_values % *n_columns;
                *n_values += 1;
                match arrays.get_mut(column) {
                    Some(array) => array.push(value.into()),
                    None => {
                        arrays.push(Array::of(value.into())?);
                        Ok(())
                    }
                }
            }
        }
    }
}

/// A column's values, of one type each.
pub(crate) enum Array {
    Int(Vec<Option<i64>>),
    Real(Vec<Option<f64>>),
    Bool(Vec<bool>),
    Text(Vec<Option<String>>),
    Bytes(Vec<Option<Vec<u8>>>),
}

impl Array {
    fn of(value: Value) -> Result<Self, StoreError> {
        Ok(match value {
            Value::Int(value) => Self::Int(vec![value]),
            Value::Real(value) => Self::Real(vec![value]),
            Value::Bool(value) => Self::Bool(vec![value]),
            Value::Text(value) => Self::Text(vec![value]),
            Value::Bytes(value) => Self::Bytes(vec![value]),
            Value::Ids(_) | Value::Reals(_) => return Err(mixed()),
        })
    }

    fn push(&mut self, value: Value) -> Result<(), StoreError> {
        match (self, value) {
            (Self::Int(array), Value::Int(value)) => array.push(value),
            (Self::Real(array), Value::Real(value)) => array.push(value),
            (Self::Bool(array), Value::Bool(value)) => array.push(value),
            (Self::Text(array), Value::Text(value)) => array.push(value),
            (Self::Bytes(array), Value::Bytes(value)) => array.push(value),
            _ => return Err(mixed()),
        }
        Ok(())
    }

    fn add_to(self, arguments: &mut PgArguments) -> Result<(), StoreError> {
        let added = match self {
            Self::Int(array) => arguments.add(array),
            Self::Real(array) => arguments.add(array),
            Self::Bool(array) => arguments.add(array),
            Self::Text(array) => arguments.add(array),
            Self::Bytes(array) => arguments.add(array),
        };
        added.map_err(|error| StoreError::Database(sqlx::Error::Encode(error)))
    }
}

fn mixed() -> StoreError {
    StoreError::Database(sqlx::Error::Encode("a column has values of several types".into()))
}

#[cfg(test)]
mod tests {
    use super::super::{Held, query};
    use super::*;

    #[tokio::test]
    async fn any_number_of_rows_is_written_once_each() {
        let pool = sqlx::sqlite::SqlitePoolOptions::new().max_connections(1);
        let pool = pool.connect("sqlite::memory:").await.unwrap();
        let mut connection = Connection::Sqlite(Held::Alone(pool.acquire().await.unwrap()));
        query("CREATE TABLE t (a INTEGER PRIMARY KEY, b REAL)").execute(&mut connection).await.unwrap();
        let rows = MultiRow { table: "t", columns: "a, b", conflict: "", is_virtual: false };
        let mut first = 0i64;
        for n in [0, 1, 7, 8, 31, 33, 127, 128, 300] {
            let items: Vec<i64> = (first..first + n).collect();
            first += n;
            let bind = |columns: &mut Columns, item: &i64| {
                columns.add(*item)?;
                columns.add(*item as f64)
            };
            rows.write(&mut connection, &items, bind).await.unwrap();
            let count: i64 = query("SELECT count(*) FROM t WHERE a = b").only(&mut connection).await.unwrap();
            assert_eq!(count, first);
        }
    }
}
