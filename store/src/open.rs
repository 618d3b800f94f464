//! Opening the database, and transactions on it.

use crate::StoreError;
use crate::engine::{Connection, Held, postgres, sqlite};
use crate::images::Objects;
use crate::lease::Leases;
use crate::migrations::SQLITE_MIGRATIONS;
use crate::place::Place;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool, SqlitePoolOptions};
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What a commit outlives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Durability {
    /// The end of the process at any moment, and of the machine: each commit waits until the disk has it.
    /// With PostgreSQL, as long as its own `synchronous_commit` says so.
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
    /// is let through, a second server is not waited for. SQLite only.
    pub busy_timeout: Duration,
    /// Connections that read at the same time. Default 4: one per core of a small server, each holds some
    /// megabytes.
    pub n_readers: u32,
    /// Room the database may take, bytes; a commit beyond it fails with [`StoreError::DiskFull`]. Default no
    /// limit but the disk's. SQLite only.
    pub max_bytes: Option<u64>,
    /// Connections that write at the same time. Default 4: a commit takes some milliseconds of which most is
    /// waiting, and PostgreSQL gets 100 connections by default, for all servers together. SQLite has one.
    pub n_writers: u32,
    /// How long to wait for a connection. Default 5 s: a failover takes longer and is waited for by those who
    /// try again. PostgreSQL only.
    pub connect_timeout: Duration,
    /// How long a statement may take. Default 30 s: a thousand times what any takes. PostgreSQL only.
    pub statement_timeout: Duration,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self {
            durability: Durability::default(),
            busy_timeout: Duration::from_secs(5),
            n_readers: 4,
            max_bytes: None,
            n_writers: 4,
            connect_timeout: Duration::from_secs(5),
            statement_timeout: Duration::from_secs(30),
        }
    }
}

/// The database. Cheap to clone; clones share the connections.
///
/// In SQLite one connection writes, in the order of the calls; a few read beside it, each from the last
/// commit before its question began. In PostgreSQL a few connections write.
#[derive(Clone, Debug)]
pub struct Store {
    engine: Engine,
    place: Place,
    leases: Leases,
    /// Where images are; in the database where there is none.
    pub(crate) objects: Option<Objects>,
}

#[derive(Clone, Debug)]
enum Engine {
    Sqlite { writer: SqlitePool, readers: SqlitePool, path: PathBuf },
    Postgres(postgres::Pools),
}

/// A transaction that writes.
///
/// One that is not committed closes its connection, which undoes it whatever state the database left it in:
/// after some errors, such as a full disk, SQLite has ended the transaction itself, after others it has not.
/// The next writer gets a new connection.
pub(crate) struct WriteTransaction {
    connection: Connection,
    place: Place,
    leases: Leases,
    is_committed: bool,
}

impl WriteTransaction {
    /// What this server has taken.
    pub fn leases(&self) -> &Leases {
        &self.leases
    }

    /// Makes what was written durable.
    ///
    /// # Errors
    /// [`StoreError::Gone`] if it was written into a file that is no longer there. If PostgreSQL was
    /// lost meanwhile nobody knows whether it was written: do it again.
    pub async fn commit(mut self) -> Result<(), StoreError> {
        self.connection.command("COMMIT").await?;
        self.is_committed = true;
        self.place.check_commit()
    }
}

impl Deref for WriteTransaction {
    type Target = Connection;

    fn deref(&self) -> &Connection {
        &self.connection
    }
}

impl DerefMut for WriteTransaction {
    fn deref_mut(&mut self) -> &mut Connection {
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

impl Store {
    /// Opens a database file and brings its schema up to date; makes it if there is none.
    ///
    /// Rows of sessions whose deletion was interrupted are cleared away.
    ///
    /// # Errors
    /// [`StoreError::NewerSchema`] if a later version of this program wrote it, and [`StoreError::NotAStore`]
    /// if it is something else; neither is touched.
    pub async fn open(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        Self::open_beside(path, options).await?.cleared().await
    }

    /// As [`Self::open`], also while a server uses the database: what it may be about to delete is left
    /// alone.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub async fn open_beside(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        let path = path.as_ref().to_path_buf();
        if path.exists() {
            sqlite::refuse_unknown_schema(&path, &options).await?;
        }
        let writer = sqlite::writer(&path, &options).await?;
        SQLITE_MIGRATIONS.run(&writer).await.map_err(migration_error)?;
        let readers = sqlite::readers(&path, &options);
        let place = Place::of(&path);
        let engine = Engine::Sqlite { writer, readers, path };
        Ok(Self { engine, place, leases: Leases::default(), objects: None })
    }

    /// Connects to a database of PostgreSQL, such as `postgres://user@host/maps?sslmode=verify-full`, and
    /// brings its schema up to date. Rows of sessions whose deletion was interrupted are cleared away.
    ///
    /// # Errors
    /// [`StoreError::Address`] if the URL is none, [`StoreError::Unreachable`] if nobody answers there, and
    /// [`StoreError::NewerSchema`].
    pub async fn connect(url: &str, options: StoreOptions) -> Result<Self, StoreError> {
        Self::connect_beside(url, options).await?.cleared().await
    }

    /// As [`Self::connect`]; what servers may be about to delete is left alone.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub async fn connect_beside(url: &str, options: StoreOptions) -> Result<Self, StoreError> {
        let pools = postgres::Pools::open(url, &options).await?;
        let engine = Engine::Postgres(pools);
        Ok(Self { engine, place: Place::elsewhere(), leases: Leases::default(), objects: None })
    }

    async fn cleared(self) -> Result<Self, StoreError> {
        match self.clear_deleted_sessions().await {
            // What is damaged in a session that nobody wants any more keeps nobody from the others.
            Err(StoreError::Corrupt(what)) => {
                tracing::error!("a deleted session cannot be cleared away, its rows are damaged: {what}");
            }
            cleared => cleared?,
        }
        Ok(self)
    }

    /// A store whose connections only read, opened when they are needed.
    pub(crate) fn to_read(path: &Path, options: &SqliteConnectOptions) -> Self {
        let n_readers = StoreOptions::default().n_readers;
        let pool = || SqlitePoolOptions::new().max_connections(n_readers).connect_lazy_with(options.clone());
        let engine = Engine::Sqlite { writer: pool(), readers: pool(), path: path.to_owned() };
        Self { engine, place: Place::of(path), leases: Leases::default(), objects: None }
    }

    /// Ends the connections of a store that only reads.
    pub(crate) async fn close_read(&self) {
        match &self.engine {
            Engine::Sqlite { writer, readers, .. } => {
                readers.close().await;
                writer.close().await;
            }
            Engine::Postgres(pools) => {
                pools.readers.close().await;
                pools.writers.close().await;
            }
        }
    }

    /// Gives the room of what was deleted back to the file system: the file is written anew without it, for
    /// which there must be room beside it. Bytes of the file before and after. PostgreSQL does it by itself
    /// (autovacuum); zeros are answered.
    ///
    /// # Errors
    /// [`StoreError::Busy`] if somebody else uses the database, [`StoreError::DiskFull`] if there is no room.
    pub async fn compact(&self) -> Result<[u64; 2], StoreError> {
        let Engine::Sqlite { writer, path, .. } = &self.engine else { return Ok([0, 0]) };
        let file_bytes = || match std::fs::metadata(path) {
            Ok(metadata) => Ok(metadata.len()),
            Err(error) => Err(StoreError::Io(sqlx::Error::Io(error))),
        };
        let mut writer = writer.acquire().await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        let before = file_bytes()?;
        sqlx::query("VACUUM").execute(&mut *writer).await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        Ok([before, file_bytes()?])
    }

    /// Folds the log into the database file. PostgreSQL does it by itself.
    pub async fn checkpoint(&self) -> Result<(), StoreError> {
        let Engine::Sqlite { writer, .. } = &self.engine else { return Ok(()) };
        let mut writer = writer.acquire().await?;
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut *writer).await?;
        Ok(())
    }

    /// Ends every connection after what it is doing; the log is folded into the file. Further calls fail.
    pub async fn close(&self) -> Result<(), StoreError> {
        match &self.engine {
            Engine::Sqlite { writer, readers, .. } => {
                readers.close().await;
                let checkpointed = self.checkpoint().await;
                writer.close().await;
                checkpointed
            }
            Engine::Postgres(_) => {
                self.close_read().await;
                Ok(())
            }
        }
    }

    pub(crate) fn place(&self) -> &Place {
        &self.place
    }

    pub(crate) fn leases(&self) -> &Leases {
        &self.leases
    }

    pub(crate) fn with_leases(self, leases: Leases) -> Self {
        Self { leases, ..self }
    }

    /// The database file; `None` of a database of PostgreSQL.
    pub fn path(&self) -> Option<&Path> {
        match &self.engine {
            Engine::Sqlite { path, .. } => Some(path),
            Engine::Postgres(_) => None,
        }
    }

    /// Version of the schema of files this program writes.
    pub fn schema_version() -> i64 {
        SQLITE_MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
    }

    /// Begins a transaction that may write; undone unless committed. In SQLite the lock is taken at once, so
    /// that it cannot fail half-way for want of it.
    pub(crate) async fn begin_write(&self) -> Result<WriteTransaction, StoreError> {
        let (connection, begin) = match &self.engine {
            Engine::Sqlite { writer, .. } => {
                (Connection::Sqlite(Held::Alone(writer.acquire().await?)), "BEGIN IMMEDIATE")
            }
            Engine::Postgres(pools) => {
                let acquired = pools.writers.acquire().await.map_err(postgres::error)?;
                (Connection::Postgres(Held::Alone(acquired), pools.patience), "BEGIN")
            }
        };
        // Made before the statement runs, so that giving up in the middle of it closes the connection too.
        let (place, leases) = (self.place.clone(), self.leases.clone());
        let mut transaction = WriteTransaction { connection, place, leases, is_committed: false };
        transaction.command(begin).await?;
        Ok(transaction)
    }

    /// A connection that reads.
    pub(crate) async fn reader(&self) -> Result<Connection, StoreError> {
        Ok(match &self.engine {
            Engine::Sqlite { readers, .. } => Connection::Sqlite(Held::Alone(readers.acquire().await?)),
            Engine::Postgres(pools) => {
                let acquired = pools.readers.acquire().await.map_err(postgres::error)?;
                Connection::Postgres(Held::Alone(acquired), pools.patience)
            }
        })
    }

    /// Begins a transaction in which every question is answered from the same commit. Keep it short: while it
    /// lasts, SQLite's log cannot be folded into the file, and PostgreSQL keeps what was replaced.
    pub(crate) async fn begin_read(&self) -> Result<Connection, StoreError> {
        Ok(match &self.engine {
            Engine::Sqlite { readers, .. } => Connection::Sqlite(Held::Reading(readers.begin().await?)),
            Engine::Postgres(pools) => {
                let begun = pools.readers.begin_with(postgres::BEGIN_READ);
                Connection::Postgres(
                    Held::Reading(postgres::limited(pools.patience, begun).await?),
                    pools.patience,
                )
            }
        })
    }
}

/// A full disk while migrating is a full disk.
fn migration_error(error: sqlx::migrate::MigrateError) -> StoreError {
    match error {
        sqlx::migrate::MigrateError::Execute(error)
        | sqlx::migrate::MigrateError::ExecuteMigration(error, _) => StoreError::from(error),
        other => other.into(),
    }
}
