//! Statements that write many rows each: a row then costs a microsecond instead of twenty.

use crate::StoreError;
use sqlx::sqlite::{SqliteArguments, SqliteConnection};
use sqlx::{Arguments, AssertSqlSafe, Encode, Sqlite, Type};
use std::fmt::Write;

/// Rows per statement, greatest first. Few sizes, so that each statement is prepared once and kept; the
/// largest binds well under SQLite's 32766 values and takes the caller's thread a tenth of a millisecond to
/// fill.
const CHUNK_SIZES: [usize; 4] = [128, 32, 8, 1];

/// An insertion of rows, whatever their number.
pub(super) struct MultiRow {
    /// Up to and including `VALUES `.
    pub insert: &'static str,
    pub n_columns: usize,
    /// What follows the rows.
    pub conflict: &'static str,
}

impl MultiRow {
    /// Writes one row for each item, in their order.
    pub async fn write<T>(
        &self,
        connection: &mut SqliteConnection,
        items: &[T],
        mut bind: impl FnMut(&mut Columns, &T) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut rest = items;
        for size in CHUNK_SIZES {
            let sql = self.sql(size);
            while rest.len() >= size {
                let (chunk, after) = rest.split_at(size);
                rest = after;
                let mut columns = Columns(SqliteArguments::default());
                columns.0.reserve(size * self.n_columns, 0);
                chunk.iter().try_for_each(|item| bind(&mut columns, item))?;
                debug_assert_eq!(columns.0.len(), size * self.n_columns, "{}", self.insert);
                // Safe: the text is made of constants.
                sqlx::query_with(AssertSqlSafe(sql.as_str()), columns.0).execute(&mut *connection).await?;
            }
        }
        Ok(())
    }

    fn sql(&self, n_rows: usize) -> String {
        let row = format!("({})", vec!["?"; self.n_columns].join(","));
        format!("{}{}{}", self.insert, vec![row; n_rows].join(","), self.conflict)
    }
}

/// The values of a statement's rows, one after the other.
pub(super) struct Columns(SqliteArguments);

impl Columns {
    pub fn add<'t, T: Encode<'t, Sqlite> + Type<Sqlite>>(&mut self, value: T) -> Result<(), StoreError> {
        Arguments::add(&mut self.0, value).map_err(|error| StoreError::Database(sqlx::Error::Encode(error)))
    }
}

/// Ids as a JSON array, to be unpacked by `json_each`: one bound value however many they are.
pub(crate) fn id_list(ids: impl IntoIterator<Item = u64>) -> String {
    let mut list = String::from("[");
    for id in ids {
        if list.len() > 1 {
            list.push(',');
        }
        // Writing to a string cannot fail.
        let _ = write!(list, "{id}");
    }
    list.push(']');
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn id_lists_are_json() {
        assert_eq!(id_list([]), "[]");
        assert_eq!(id_list([3]), "[3]");
        assert_eq!(id_list([3, 1, u64::MAX]), "[3,1,18446744073709551615]");
    }

    #[tokio::test]
    async fn any_number_of_rows_is_written_once_each() {
        use sqlx::Connection;
        let mut connection = SqliteConnection::connect("sqlite::memory:").await.unwrap();
        sqlx::query("CREATE TABLE t (a INTEGER PRIMARY KEY, b REAL)").execute(&mut connection).await.unwrap();
        let rows = MultiRow { insert: "INSERT INTO t (a, b) VALUES ", n_columns: 2, conflict: "" };
        let mut first = 0i64;
        for n in [0, 1, 7, 8, 31, 33, 127, 128, 300] {
            let items: Vec<i64> = (first..first + n).collect();
            first += n;
            let bind = |columns: &mut Columns, item: &i64| {
                columns.add(*item)?;
                columns.add(*item as f64)
            };
            rows.write(&mut connection, &items, bind).await.unwrap();
            let count: i64 = sqlx::query_scalar("SELECT count(*) FROM t WHERE a = b")
                .fetch_one(&mut connection)
                .await
                .unwrap();
            assert_eq!(count, first);
        }
    }
}
