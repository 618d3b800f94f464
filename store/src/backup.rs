//! Copies of a database file, by SQLite; PostgreSQL has its own programs for it (`pg_dump`, `pg_basebackup`).
//! Made while others use it, and looked at without being changed.

use crate::engine::query;
use crate::engine::sqlite::{reading, schema_of, whole_file};
use crate::error::{is_damage, is_interrupted};
use crate::{Finding, Objects, Store, StoreError};
use sqlx::{Connection, Row, SqliteConnection};
use std::path::{Path, PathBuf};

/// Steps of SQLite's machine, or pages, after which a look at the file asks whether to go on: some
/// milliseconds.
const STEPS_BETWEEN_LOOKS: i32 = 1000;

/// What was found in a database that was only read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verified {
    /// What is wrong; empty is good news.
    pub findings: Vec<Finding>,
    /// Sessions there are.
    pub n_sessions: u64,
    /// Version of its schema.
    pub schema: i64,
    /// Whether the sessions were looked at, and not the file alone: those of an earlier schema cannot be
    /// before they are brought up to date.
    pub are_sessions_checked: bool,
    /// Bytes in its log that were left out, because the log cannot be read without being written.
    pub n_log_bytes_left_out: u64,
    /// Images that lie in an object store, and not in the file.
    pub n_image_objects: u64,
}

impl Store {
    /// Writes a database, as of its last commit, to a new file, which may be there if it is empty. Others may
    /// read and write the database meanwhile; none of them waits.
    ///
    /// By `VACUUM INTO` and not by SQLite's backup interface: that begins anew each time another process
    /// commits, which beside streams is several times a second, so that it would never end. This reads one
    /// commit from beginning to end. What it writes has no room of deleted sessions, and what cannot be read
    /// is met here and not when the copy is needed. The log of the database grows until it has ended.
    ///
    /// The bytes are on the disk when it returns, except for the name of the file.
    ///
    /// # Errors
    /// If the database cannot be read or is none of ours, or the file cannot be written.
    pub async fn back_up(from: &Path, into: &Path) -> Result<(), StoreError> {
        let options = reading(from, &crate::StoreOptions::default());
        let supported = Self::schema_version();
        match schema_of(from, &options).await? {
            Some(found) if found > supported => return Err(StoreError::NewerSchema { found, supported }),
            Some(_) => {}
            None => return Err(StoreError::NotAStore { path: from.display().to_string() }),
        }
        let mut connection = SqliteConnection::connect_with(&options).await?;
        let path = into.to_string_lossy().into_owned();
        sqlx::query("VACUUM INTO ?").bind(path).execute(&mut connection).await?;
        connection.close().await?;
        let into = into.to_owned();
        let synced = tokio::task::spawn_blocking(move || std::fs::File::open(into)?.sync_all()).await;
        let synced = synced.unwrap_or_else(|error| Err(std::io::Error::other(error)));
        synced.map_err(|error| StoreError::Io(sqlx::Error::Io(error)))
    }

    /// Bytes that [`Self::back_up`] will write, about.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn used_bytes(path: &Path) -> Result<u64, StoreError> {
        let options = reading(path, &crate::StoreOptions::default());
        let mut connection = SqliteConnection::connect_with(&options).await?;
        let mut pragma = async |statement| -> Result<u64, StoreError> {
            let n: i64 = sqlx::query_scalar(statement).fetch_one(&mut connection).await?;
            Ok(u64::try_from(n).unwrap_or(0))
        };
        let n_pages = pragma("PRAGMA page_count").await? - pragma("PRAGMA freelist_count").await?;
        let n_bytes = n_pages * pragma("PRAGMA page_size").await?;
        connection.close().await?;
        Ok(n_bytes)
    }

    /// Looks at everything in a database, also while others use it, and changes nothing: neither the file nor
    /// its schema. Where its log cannot be read without being written, as on a medium that cannot be, the
    /// file is read as it is.
    ///
    /// # Errors
    /// If it is no database of ours, or cannot be read at all.
    pub async fn verify(path: &Path) -> Result<Verified, StoreError> {
        Self::verify_with(path, None).await
    }

    /// As [`Self::verify`]; whether images are in the object store that the database has there is looked up
    /// as well.
    ///
    /// # Errors
    /// As [`Self::verify`], and [`StoreError::Objects`].
    pub async fn verify_with(path: &Path, objects: Option<Objects>) -> Result<Verified, StoreError> {
        let log = PathBuf::from(format!("{}-wal", path.display()));
        let n_log_bytes = log.metadata().map_or(0, |log| log.len());
        let options = reading(path, &crate::StoreOptions::default());
        let with_log = match n_log_bytes {
            // Without a log there is nothing to share, and no file has to be made to read this one.
            0 => None,
            _ => match schema_of(path, &options).await {
                Ok(schema) => Some(schema),
                Err(error) if error.is_unwritable() => None,
                Err(error) => return Err(error),
            },
        };
        let (options, schema, n_log_bytes_left_out) = match with_log {
            Some(schema) => (options, schema, 0),
            None => {
                let options = whole_file(path);
                let schema = schema_of(path, &options).await?;
                (options, schema, n_log_bytes)
            }
        };
        let supported = Self::schema_version();
        let schema = schema.ok_or_else(|| StoreError::NotAStore { path: path.display().to_string() })?;
        if schema > supported {
            return Err(StoreError::NewerSchema { found: schema, supported });
        }
        let are_sessions_checked = schema == supported;
        let store = Self::to_read(path, &options);
        let mut findings =
            if are_sessions_checked { store.check().await? } else { store.check_file_alone().await? };
        // Of an earlier schema none does.
        let n_image_objects = store.n_image_objects().await.unwrap_or(0);
        let store = store.with_objects(objects);
        if are_sessions_checked && store.objects.is_some() {
            findings.extend(store.check_objects().await?);
        }
        let n_sessions = store.count_named().await.unwrap_or(0);
        store.close_read().await;
        Ok(Verified {
            findings,
            n_sessions,
            schema,
            are_sessions_checked,
            n_log_bytes_left_out,
            n_image_objects,
        })
    }

    /// Looks for damaged pages: every page is read and its structure checked, without the contents of
    /// indexes. PostgreSQL does that itself (data checksums, amcheck), and nothing is found. What is wrong
    /// with the file; then each session is looked at and what is wrong there is told too. It is asked now and
    /// then whether to `go_on`.
    ///
    /// # Errors
    /// If the database cannot be read at all, and [`StoreError::Stopped`] if it was not to go on.
    pub async fn find_damage(
        &self,
        go_on: impl FnMut() -> bool + Send + 'static,
    ) -> Result<Vec<Finding>, StoreError> {
        // Not one of the readers: it is in use for as long as the file is large.
        let Some(path) = self.path() else { return Ok(Vec::new()) };
        let options = reading(path, &crate::StoreOptions::default());
        let mut connection = SqliteConnection::connect_with(&options).await?;
        connection.lock_handle().await?.set_progress_handler(STEPS_BETWEEN_LOOKS, go_on);
        let lines = sqlx::query("PRAGMA quick_check(100)").fetch_all(&mut connection).await;
        let lines = match lines {
            Ok(rows) => rows.iter().map(|row| row.try_get(0)).collect::<Result<Vec<String>, _>>()?,
            Err(error) if is_damage(&error) => vec![error.to_string()],
            Err(error) if is_interrupted(&error) => return Err(StoreError::Stopped),
            Err(error) => return Err(error.into()),
        };
        connection.close().await?;
        let problems = lines.into_iter().filter(|line| line != "ok");
        let mut found: Vec<_> = problems.map(|what| Finding { session: None, what }).collect();
        if !found.is_empty() {
            found.extend(self.check_sessions().await?);
        }
        Ok(found)
    }

    async fn count_named(&self) -> Result<u64, StoreError> {
        let mut reader = self.reader().await?;
        let n: i64 = query("SELECT count(*) FROM sessions WHERE id IS NOT NULL").only(&mut reader).await?;
        Ok(u64::try_from(n).unwrap_or(0))
    }
}
