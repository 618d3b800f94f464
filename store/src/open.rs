//! Opening the database: settings of the connections, and the schema's version.

use crate::StoreError;
use crate::error::is_not_a_database;
use crate::migrations::MIGRATIONS;
use crate::place::Place;
use sqlx::pool::PoolConnection;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, Sqlite, SqliteConnection, Transaction};
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What a commit outlives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Durability {
    /// The end of the process at any moment, and of the machine: each commit waits until the disk has it.
    #[default]
    PowerLoss,
    /// The end of the process at any moment. When the machine stops, the last commits may be lost; the
    /// database stays whole all the same. Spares slow disks.
    ProcessEnd,
}

/// How the database is used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreOptions {
    /// What a commit outlives. Default power loss: `durable_sequence` is a promise to the client, and waiting
    /// for the disk happens on the writer's thread, where tracking does not notice it.
    pub durability: Durability,
    /// How long to wait for a lock that another program holds. Default 5 s: a backup or an inspecting shell
    /// is let through, a second server is not waited for.
    pub busy_timeout: Duration,
    /// Connections that read at the same time. Default 4: one per core of a small server, each holds some
    /// megabytes.
    pub n_readers: u32,
    /// Room the database may take, bytes; a commit beyond it fails with [`StoreError::DiskFull`]. Default no
    /// limit but the disk's.
    pub max_bytes: Option<u64>,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self {
            durability: Durability::default(),
            busy_timeout: Duration::from_secs(5),
            n_readers: 4,
            max_bytes: None,
        }
    }
}

/// The database. Cheap to clone; clones share the connections.
///
/// One connection writes, in the order of the calls; a few read beside it, each from the last commit before
/// its question began.
#[derive(Clone, Debug)]
pub struct Store {
    writer: SqlitePool,
    readers: SqlitePool,
    path: PathBuf,
    place: Place,
}

/// A transaction on the writing connection.
///
/// One that is not committed closes its connection, which undoes it whatever state SQLite left it in: after
/// some errors, such as a full disk, SQLite has ended the transaction itself, after others it has not. The
/// next writer gets a new connection.
pub(crate) struct WriteTransaction {
    connection: PoolConnection<Sqlite>,
    place: Place,
    is_committed: bool,
}

impl WriteTransaction {
    /// Makes what was written durable.
    ///
    /// # Errors
    /// [`StoreError::Gone`] if it was written into a file that is no longer there.
    pub async fn commit(mut self) -> Result<(), StoreError> {
        sqlx::query("COMMIT").execute(&mut *self.connection).await?;
        self.is_committed = true;
        self.place.check_commit()
    }
}

impl Deref for WriteTransaction {
    type Target = SqliteConnection;

    fn deref(&self) -> &SqliteConnection {
        &self.connection
    }
}

impl DerefMut for WriteTransaction {
    fn deref_mut(&mut self) -> &mut SqliteConnection {
        &mut self.connection
    }
}

impl Drop for WriteTransaction {
    fn drop(&mut self) {
        if !self.is_committed {
            self.connection.close_on_drop();
        }
    }
}

/// Bytes in a page of the file. Twice SQLite's default: a keyframe's features fill six of them.
const PAGE_BYTES: u32 = 8192;

/// Pages after which the log is folded into the file, 8 MB: a dozen keyframes and what they move.
const CHECKPOINT_PAGES: u32 = 1000;

/// The log is cut back to this after a long reader made it grow, bytes.
const MAX_IDLE_LOG_BYTES: u32 = 64 << 20;

/// A writer that waits longer than this for its turn reports that the database is busy.
const WRITER_TURN_TIMEOUT: Duration = Duration::from_secs(120);

impl Store {
    /// Opens a database and brings its schema up to date; makes it if there is none.
    ///
    /// Rows of sessions whose deletion was interrupted are cleared away.
    ///
    /// # Errors
    /// [`StoreError::NewerSchema`] if a later version of this program wrote it, and [`StoreError::NotAStore`]
    /// if it is something else; neither is touched.
    pub async fn open(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        let store = Self::open_beside(path, options).await?;
        match store.clear_deleted_sessions().await {
            // What is damaged in a session that nobody wants any more keeps nobody from the others.
            Err(StoreError::Corrupt(what)) => {
                tracing::error!("a deleted session cannot be cleared away, its rows are damaged: {what}");
            }
            cleared => cleared?,
        }
        Ok(store)
    }

    /// As [`Self::open`], also while a server uses the database: what it may be about to delete is left
    /// alone.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub async fn open_beside(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        let path = path.as_ref().to_path_buf();
        if path.exists() {
            refuse_unknown_schema(&path, &options).await?;
        }
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .acquire_timeout(WRITER_TURN_TIMEOUT)
            .idle_timeout(None::<Duration>)
            .max_lifetime(None::<Duration>)
            .connect_with(writing(&path, &options))
            .await?;
        MIGRATIONS.run(&writer).await.map_err(migration_error)?;
        let readers = SqlitePoolOptions::new()
            .max_connections(options.n_readers.max(1))
            .max_lifetime(None::<Duration>)
            .connect_lazy_with(reading(&path, &options));
        let place = Place::of(&path);
        Ok(Self { writer, readers, path, place })
    }

    /// A store whose connections only read, opened when they are needed.
    pub(crate) fn to_read(path: &Path, options: &SqliteConnectOptions) -> Self {
        let n_readers = StoreOptions::default().n_readers;
        let pool = || SqlitePoolOptions::new().max_connections(n_readers).connect_lazy_with(options.clone());
        Self { writer: pool(), readers: pool(), path: path.to_owned(), place: Place::of(path) }
    }

    /// Ends the connections of a store that only reads.
    pub(crate) async fn close_read(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }

    /// Gives the room of what was deleted back to the file system: the file is written anew without it, for
    /// which there must be room beside it. Bytes of the file before and after.
    ///
    /// # Errors
    /// [`StoreError::Busy`] if somebody else uses the database, [`StoreError::DiskFull`] if there is no room.
    pub async fn compact(&self) -> Result<[u64; 2], StoreError> {
        let mut writer = self.writer.acquire().await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        let before = self.file_bytes()?;
        sqlx::query("VACUUM").execute(&mut *writer).await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        Ok([before, self.file_bytes()?])
    }

    fn file_bytes(&self) -> Result<u64, StoreError> {
        let metadata =
            std::fs::metadata(&self.path).map_err(|error| StoreError::Io(sqlx::Error::Io(error)))?;
        Ok(metadata.len())
    }

    /// Folds the log into the database file.
    pub async fn checkpoint(&self) -> Result<(), StoreError> {
        let mut writer = self.writer.acquire().await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        Ok(())
    }

    /// Ends every connection after what it is doing; the log is folded into the file. Further calls fail.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.readers.close().await;
        let checkpointed = self.checkpoint().await;
        self.writer.close().await;
        checkpointed
    }

    pub(crate) fn place(&self) -> &Place {
        &self.place
    }

    /// The database file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Version of the schema this program writes.
    pub fn schema_version() -> i64 {
        MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
    }

    /// Begins a transaction that may write; undone unless committed. The lock is taken at once, so that it
    /// cannot fail half-way for want of it.
    pub(crate) async fn begin_write(&self) -> Result<WriteTransaction, StoreError> {
        // Made before the statement runs, so that giving up in the middle of it closes the connection too.
        let mut transaction = WriteTransaction {
            connection: self.writer.acquire().await?,
            place: self.place.clone(),
            is_committed: false,
        };
        sqlx::query("BEGIN IMMEDIATE").execute(&mut *transaction).await?;
        Ok(transaction)
    }

    /// A connection that reads.
    pub(crate) async fn reader(&self) -> Result<PoolConnection<Sqlite>, StoreError> {
        Ok(self.readers.acquire().await?)
    }

    /// Begins a transaction in which every question is answered from the same commit. Keep it short: the log
    /// cannot be folded into the file while it lasts.
    pub(crate) async fn begin_read(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.readers.begin().await?)
    }
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
async fn refuse_unknown_schema(path: &Path, options: &StoreOptions) -> Result<(), StoreError> {
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

/// A full disk while migrating is a full disk.
fn migration_error(error: sqlx::migrate::MigrateError) -> StoreError {
    match error {
        sqlx::migrate::MigrateError::Execute(error)
        | sqlx::migrate::MigrateError::ExecuteMigration(error, _) => StoreError::from(error),
        other => other.into(),
    }
}
