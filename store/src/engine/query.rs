//! Statements for either database.

use super::row::{Column, Row};
use super::{Connection, Value, postgres};
use crate::StoreError;
use futures_util::stream::{BoxStream, StreamExt, TryStreamExt};
use sqlx::postgres::PgArguments;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, AssertSqlSafe, Postgres, Sqlite};
use std::borrow::Cow;
use std::fmt::Write;

/// A statement with its values. Its text is made of constants: values are bound, never written into it.
pub(crate) struct Query {
    sql: Cow<'static, str>,
    values: Vec<Value>,
}

/// A statement of this text; see the module's documentation for what may be in it.
pub(crate) fn query(sql: impl Into<Cow<'static, str>>) -> Query {
    Query { sql: sql.into(), values: Vec::new() }
}

type SqliteQuery = sqlx::query::Query<'static, Sqlite, SqliteArguments>;
type PostgresQuery = sqlx::query::Query<'static, Postgres, PgArguments>;

impl Query {
    /// Binds the next value.
    pub fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// Adds to the text.
    pub fn push(&mut self, text: &str) -> &mut Self {
        self.sql.to_mut().push_str(text);
        self
    }

    /// Binds the next value and adds its number to the text.
    pub fn push_bind(&mut self, value: impl Into<Value>) -> &mut Self {
        self.values.push(value.into());
        let n_values = self.values.len();
        // Writing to a string cannot fail.
        let _ = write!(self.sql.to_mut(), "${n_values}");
        self
    }

    /// Every row.
    pub async fn fetch_all(self, connection: &mut Connection) -> Result<Vec<Row>, StoreError> {
        Ok(match connection {
            Connection::Sqlite(held) => {
                let rows = self.for_sqlite()?.fetch_all(&mut **held).await?;
                rows.into_iter().map(Row::Sqlite).collect()
            }
            Connection::Postgres(held, patience) => {
                let rows = postgres::limited(*patience, self.for_postgres()?.fetch_all(&mut **held)).await;
                let rows = rows.inspect_err(|_| held.close_on_drop())?;
                rows.into_iter().map(Row::Postgres).collect()
            }
        })
    }

    /// The first row, if there is one.
    pub async fn fetch_optional(self, connection: &mut Connection) -> Result<Option<Row>, StoreError> {
        Ok(match connection {
            Connection::Sqlite(held) => {
                self.for_sqlite()?.fetch_optional(&mut **held).await?.map(Row::Sqlite)
            }
            Connection::Postgres(held, patience) => {
                let row =
                    postgres::limited(*patience, self.for_postgres()?.fetch_optional(&mut **held)).await;
                row.inspect_err(|_| held.close_on_drop())?.map(Row::Postgres)
            }
        })
    }

    /// The row there must be.
    pub async fn fetch_one(self, connection: &mut Connection) -> Result<Row, StoreError> {
        let row = self.fetch_optional(connection).await?;
        row.ok_or(StoreError::Database(sqlx::Error::RowNotFound))
    }

    /// The first column of the first row, if there is one.
    pub async fn scalar<T>(self, connection: &mut Connection) -> Result<Option<T>, StoreError>
    where
        T: for<'r> Column<'r>,
    {
        self.fetch_optional(connection).await?.map(|row| row.try_get(0)).transpose()
    }

    /// The first column of the row there must be.
    pub async fn only<T>(self, connection: &mut Connection) -> Result<T, StoreError>
    where
        T: for<'r> Column<'r>,
    {
        self.fetch_one(connection).await?.try_get(0)
    }

    /// The first column of every row.
    pub async fn scalars<T>(self, connection: &mut Connection) -> Result<Vec<T>, StoreError>
    where
        T: for<'r> Column<'r>,
    {
        self.fetch_all(connection).await?.iter().map(|row| row.try_get(0)).collect()
    }

    /// Runs it; how many rows it wrote.
    pub async fn execute(self, connection: &mut Connection) -> Result<u64, StoreError> {
        Ok(match connection {
            Connection::Sqlite(held) => self.for_sqlite()?.execute(&mut **held).await?.rows_affected(),
            Connection::Postgres(held, patience) => {
                let done = postgres::limited(*patience, self.for_postgres()?.execute(&mut **held)).await;
                done.inspect_err(|_| held.close_on_drop())?.rows_affected()
            }
        })
    }

    /// The rows as they come.
    pub fn fetch(self, connection: &mut Connection) -> BoxStream<'_, Result<Row, StoreError>> {
        match connection {
            Connection::Sqlite(held) => match self.for_sqlite() {
                Ok(query) => query.fetch(&mut **held).map_ok(Row::Sqlite).map_err(StoreError::from).boxed(),
                Err(error) => failed(error),
            },
            // However long it takes in all: PostgreSQL itself limits it.
            Connection::Postgres(held, _) => match self.for_postgres() {
                Ok(query) => query.fetch(&mut **held).map_ok(Row::Postgres).map_err(postgres::error).boxed(),
                Err(error) => failed(error),
            },
        }
    }

    fn for_sqlite(self) -> Result<SqliteQuery, StoreError> {
        let mut arguments = SqliteArguments::default();
        arguments.reserve(self.values.len(), 0);
        self.values.into_iter().try_for_each(|value| value.add_to_sqlite(&mut arguments))?;
        let sql = with_lists(
            self.sql,
            ["NOT IN (SELECT value FROM json_each(", "))"],
            ["IN (SELECT value FROM json_each(", "))"],
        );
        // Safe: see the type's documentation.
        Ok(sqlx::query_with(AssertSqlSafe(sql), arguments))
    }

    fn for_postgres(self) -> Result<PostgresQuery, StoreError> {
        let mut arguments = PgArguments::default();
        arguments.reserve(self.values.len(), 0);
        self.values.into_iter().try_for_each(|value| value.add_to_postgres(&mut arguments))?;
        let sql = with_lists(self.sql, ["<> ALL (", ")"], ["= ANY (", ")"]);
        // Safe: see the type's documentation.
        Ok(sqlx::query_with(AssertSqlSafe(sql), arguments))
    }
}

fn failed(error: StoreError) -> BoxStream<'static, Result<Row, StoreError>> {
    futures_util::stream::once(async { Err(error) }).boxed()
}

/// Puts what a database has for lists in the place of `NOT IN IDS($n)` and `IN IDS($n)`.
fn with_lists(sql: Cow<'static, str>, not_in: [&str; 2], is_in: [&str; 2]) -> Cow<'static, str> {
    if !sql.contains("IN IDS(") {
        return sql;
    }
    let mut rest: &str = &sql;
    let mut text = String::with_capacity(rest.len() + 64);
    while let Some((before, after)) = rest.split_once("IN IDS(") {
        let (number, behind) = after.split_once(')').unwrap_or((after, ""));
        let [open, close] = match before.strip_suffix("NOT ") {
            Some(before) => {
                text.push_str(before);
                not_in
            }
            None => {
                text.push_str(before);
                is_in
            }
        };
        text.extend([open, number, close]);
        rest = behind;
    }
    text.push_str(rest);
    Cow::Owned(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_written_as_each_database_has_them() {
        let sql = "DELETE FROM t WHERE a IN IDS($1) AND b NOT IN IDS($2) LIMIT 3";
        assert_eq!(
            with_lists(sql.into(), ["<> ALL (", ")"], ["= ANY (", ")"]),
            "DELETE FROM t WHERE a = ANY ($1) AND b <> ALL ($2) LIMIT 3"
        );
        assert_eq!(with_lists("SELECT 1".into(), ["", ""], ["", ""]), "SELECT 1");
    }
}
