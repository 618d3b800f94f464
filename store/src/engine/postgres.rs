//! PostgreSQL: settings of the connections, and what its errors mean.

use crate::migrations::POSTGRES_MIGRATIONS;
use crate::{Durability, StoreError, StoreOptions};
use sqlx::ConnectOptions;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use std::future::Future;
use std::str::FromStr;
use std::time::Duration;

/// A connection that is not needed for so long is closed: servers that are asked now and then hold none.
const IDLE_TIMEOUT: Duration = Duration::from_secs(300);

/// How much longer than PostgreSQL itself we wait for a statement: it ends one that takes too long, unless
/// it, or the way to it, is gone.
const GRACE: Duration = Duration::from_secs(5);

/// A transaction that writes and is asked nothing for so long is ended: a server takes milliseconds between
/// its statements.
const WRITER_IDLE: Duration = Duration::from_secs(5);

/// Begins a transaction in which every question is answered from the same commit.
pub(crate) const BEGIN_READ: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";

/// Connections of a store.
#[derive(Clone, Debug)]
pub(crate) struct Pools {
    pub writers: PgPool,
    pub readers: PgPool,
    /// How long we wait for a statement.
    pub patience: Duration,
}

impl Pools {
    /// Connects to the database that a URL names, and brings its schema up to date unless a later version of
    /// this program wrote it.
    pub async fn open(url: &str, options: &StoreOptions) -> Result<Self, StoreError> {
        let connect = connect_options(url, options)?;
        let timeout = |span: Duration| span.as_millis().to_string();
        // Ends the transaction of a server that stands still, so that another may write the session.
        let idle = |span| ("idle_in_transaction_session_timeout", timeout(span));
        let pool = |n_connections: u32| {
            PgPoolOptions::new()
                .max_connections(n_connections.max(1))
                .acquire_timeout(options.connect_timeout)
                .idle_timeout(IDLE_TIMEOUT)
        };
        let writers = pool(options.n_writers).connect_lazy_with(connect.clone().options([idle(WRITER_IDLE)]));
        refuse_newer_schema(&writers).await?;
        POSTGRES_MIGRATIONS.run(&writers).await.map_err(migration_error)?;
        let readers = connect.options([idle(options.statement_timeout)]);
        let readers = pool(options.n_readers).connect_lazy_with(readers);
        Ok(Self { writers, readers, patience: options.statement_timeout + GRACE })
    }
}

fn connect_options(url: &str, options: &StoreOptions) -> Result<PgConnectOptions, StoreError> {
    let mut parsed = PgConnectOptions::from_str(url).map_err(|error| {
        // Without the URL: it may hold a password.
        StoreError::Address(error.to_string())
    })?;
    if parsed.get_application_name().is_none() {
        parsed = parsed.application_name("monoslam");
    }
    let timeout = options.statement_timeout.as_millis().to_string();
    parsed = parsed.options([("statement_timeout", timeout.as_str()), ("lock_timeout", timeout.as_str())]);
    // That a table is there already is no news.
    parsed = parsed.options([("client_min_messages", "warning")]);
    if options.durability == Durability::ProcessEnd {
        parsed = parsed.options([("synchronous_commit", "off")]);
    }
    Ok(parsed.disable_statement_logging())
}

/// Looks at the schema's version before anything is written.
async fn refuse_newer_schema(pool: &PgPool) -> Result<(), StoreError> {
    let has_table = sqlx::query_scalar("SELECT to_regclass('_sqlx_migrations') IS NOT NULL");
    if !has_table.fetch_one(pool).await.map_err(error)? {
        return Ok(());
    }
    let newest = sqlx::query_scalar("SELECT coalesce(max(version), 0) FROM _sqlx_migrations");
    let found: i64 = newest.fetch_one(pool).await.map_err(error)?;
    let supported = POSTGRES_MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
    if found > supported { Err(StoreError::NewerSchema { found, supported }) } else { Ok(()) }
}

fn migration_error(migration: sqlx::migrate::MigrateError) -> StoreError {
    match migration {
        sqlx::migrate::MigrateError::Execute(cause)
        | sqlx::migrate::MigrateError::ExecuteMigration(cause, _) => error(cause),
        other => other.into(),
    }
}

/// Waits for what PostgreSQL is asked as long as there is hope.
pub(crate) async fn limited<T>(
    patience: Duration,
    asking: impl Future<Output = Result<T, sqlx::Error>>,
) -> Result<T, StoreError> {
    match tokio::time::timeout(patience, asking).await {
        Ok(answer) => answer.map_err(error),
        Err(_) => Err(StoreError::Unreachable(sqlx::Error::Io(std::io::ErrorKind::TimedOut.into()))),
    }
}

/// What an error means for the caller, by its SQLSTATE
/// <https://www.postgresql.org/docs/current/errcodes-appendix.html>.
pub(crate) fn error(error: sqlx::Error) -> StoreError {
    let code = error.as_database_error().and_then(|error| error.code()).map(|code| code.into_owned());
    let Some(code) = code else {
        return match error {
            sqlx::Error::Io(_)
            | sqlx::Error::Tls(_)
            | sqlx::Error::PoolTimedOut
            | sqlx::Error::Protocol(_) => StoreError::Unreachable(error),
            other => other.into(),
        };
    };
    match code.as_str() {
        // Full disk.
        "53100" => StoreError::DiskFull(error),
        // It shuts down, starts or has no room for more connections; or it is a copy that only answers, as
        // after a failover: the next connection may reach the one that writes.
        "57P01" | "57P02" | "57P03" | "53200" | "53300" | "53400" | "25006" | "25P03" => {
            StoreError::Unreachable(error)
        }
        // Transactions that met, and statements that took too long.
        "40001" | "40P01" | "55P03" | "57014" => StoreError::Busy(error),
        "XX001" | "XX002" => StoreError::Corrupt(error.to_string()),
        code if code.starts_with("08") => StoreError::Unreachable(error),
        code if code.starts_with("58") => StoreError::Io(error),
        code if code.starts_with("23") => StoreError::Inconsistent(error),
        _ => StoreError::Database(error),
    }
}

/// Whether transactions met, of which the one that failed can be tried again at once.
pub(crate) fn is_conflict(error: &StoreError) -> bool {
    let StoreError::Busy(error) = error else { return false };
    let code = error.as_database_error().and_then(|error| error.code());
    matches!(code.as_deref(), Some("40001" | "40P01"))
}
