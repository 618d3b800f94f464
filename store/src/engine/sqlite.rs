//! SQLite: settings of the connections, and the schema's version of a file.

use crate::error::is_not_a_database;
use crate::{Durability, Store, StoreError, StoreOptions};
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::path::Path;
use std::time::Duration;

/// Bytes in a page of the file. Twice SQLite's default: a keyframe's features fill six of them.
const PAGE_BYTES: u32 = 8192;

/// Pages after which the log is folded into the file, 8 MB: a dozen keyframes and what they move.
const CHECKPOINT_PAGES: u32 = 1000;

/// The log is cut back to this after a long reader made it grow, bytes.
const MAX_IDLE_LOG_BYTES: u32 = 64 << 20;

/// A writer that waits longer than this for its turn reports that the database is busy.
const WRITER_TURN_TIMEOUT: Duration = Duration::from_secs(120);

/// The one connection that writes; made at once, with the file if there is none.
pub(crate) async fn writer(path: &Path, options: &StoreOptions) -> Result<SqlitePool, StoreError> {
    let pool = SqlitePoolOptions::new()
        .max_connections(1)
        .acquire_timeout(WRITER_TURN_TIMEOUT)
        .idle_timeout(None::<Duration>)
        .max_lifetime(None::<Duration>);
    Ok(pool.connect_with(writing(path, options)).await?)
}

/// The connections that read, made when they are needed.
pub(crate) fn readers(path: &Path, options: &StoreOptions) -> SqlitePool {
    SqlitePoolOptions::new()
        .max_connections(options.n_readers.max(1))
        .max_lifetime(None::<Duration>)
        .connect_lazy_with(reading(path, options))
}

fn writing(path: &Path, options: &StoreOptions) -> SqliteConnectOptions {
    let synchronous = match options.durability {
        // In WAL mode FULL waits for the log at each commit; NORMAL only when the log is folded into the
        // file.
        Durability::PowerLoss => SqliteSynchronous::Full,
        Durability::ProcessEnd => SqliteSynchronous::Normal,
    };
    let base = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .page_size(PAGE_BYTES)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(synchronous)
        .foreign_keys(true)
        .busy_timeout(options.busy_timeout)
        .pragma("wal_autocheckpoint", CHECKPOINT_PAGES.to_string())
        .pragma("journal_size_limit", MAX_IDLE_LOG_BYTES.to_string());
    let base = match options.max_bytes {
        Some(max_bytes) => {
            base.pragma("max_page_count", (max_bytes / u64::from(PAGE_BYTES)).max(1).to_string())
        }
        None => base,
    };
    quiet(base)
}

/// To read the file as it is, without its log, and without a trace beside it.
pub(crate) fn whole_file(path: &Path) -> SqliteConnectOptions {
    reading(path, &StoreOptions::default()).immutable(true)
}

pub(crate) fn reading(path: &Path, options: &StoreOptions) -> SqliteConnectOptions {
    quiet(SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(options.busy_timeout))
}

/// Statements are not worth a log line each; the callers log what they do.
fn quiet(options: SqliteConnectOptions) -> SqliteConnectOptions {
    options.disable_statement_logging()
}

/// Looks at the schema's version before anything is written.
pub(crate) async fn refuse_unknown_schema(path: &Path, options: &StoreOptions) -> Result<(), StoreError> {
    let found = schema_of(path, &reading(path, options)).await?.unwrap_or(0);
    let supported = Store::schema_version();
    if found > supported { Err(StoreError::NewerSchema { found, supported }) } else { Ok(()) }
}

/// The schema's version; `None` of an empty file.
pub(crate) async fn schema_of(
    path: &Path,
    options: &SqliteConnectOptions,
) -> Result<Option<i64>, StoreError> {
    let not_a_store = || StoreError::NotAStore { path: path.display().to_string() };
    let mut connection = match SqliteConnection::connect_with(options).await {
        Ok(connection) => connection,
        Err(error) if is_not_a_database(&error) => return Err(not_a_store()),
        Err(error) => return Err(error.into()),
    };
    let tables: Vec<String> = match sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table'")
        .fetch_all(&mut connection)
        .await
    {
        Ok(tables) => tables,
        Err(error) if is_not_a_database(&error) => return Err(not_a_store()),
        Err(error) => return Err(error.into()),
    };
    if !tables.iter().any(|name| name == "_sqlx_migrations") {
        // A crash before the first migration leaves an empty file, which is as good as none.
        return if tables.is_empty() { Ok(None) } else { Err(not_a_store()) };
    }
    let found: Option<i64> =
        sqlx::query_scalar("SELECT max(version) FROM _sqlx_migrations").fetch_one(&mut connection).await?;
    connection.close().await?;
    Ok(found)
}
