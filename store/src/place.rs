//! Whether what is committed is in the file that is there, and whether commits succeed.
//!
//! A file that is deleted or replaced while it is open goes on being written, by its open descriptor, and is
//! gone with the process. SQLite does not notice. So the identity of the database is kept from when it was
//! opened and looked at after each commit, and that its log is still there.

use crate::{Store, StoreError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A failed write counts against the storage for so long: what still waits to be saved is tried again within
/// a second or two, and fails again.
const FAILURE_COUNTS_FOR: Duration = Duration::from_secs(15);

/// The files as they were opened, if the database is in files of ours, and how the last write ended. Clones
/// share it.
#[derive(Clone, Debug)]
pub(crate) struct Place(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    files: Option<Files>,
    /// When a write failed, and why, if the last one did.
    failure: Mutex<Option<(Instant, String)>>,
}

#[derive(Debug)]
struct Files {
    path: PathBuf,
    log: PathBuf,
    opened: Option<Identity>,
}

/// Which file it is, whatever it is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Identity {
    device: u64,
    number: u64,
}

impl Identity {
    #[cfg(unix)]
    fn of(path: &Path) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(path).ok()?;
        Some(Self { device: metadata.dev(), number: metadata.ino() })
    }

    /// Elsewhere files that are open cannot be removed.
    #[cfg(not(unix))]
    fn of(_path: &Path) -> Option<Self> {
        None
    }
}

impl Place {
    /// Of a database that is open.
    pub fn of(path: &Path) -> Self {
        let log = PathBuf::from(format!("{}-wal", path.display()));
        let opened = Identity::of(path);
        Self::with(Some(Files { path: path.to_owned(), log, opened }))
    }

    /// Of a database that another program keeps.
    pub fn elsewhere() -> Self {
        Self::with(None)
    }

    fn with(files: Option<Files>) -> Self {
        Self(Arc::new(Shared { files, failure: Mutex::default() }))
    }

    /// Whether the file that was opened is the one that is there.
    pub fn check(&self) -> Result<(), StoreError> {
        let Some(Files { path, opened, .. }) = &self.0.files else { return Ok(()) };
        if Identity::of(path) == *opened { Ok(()) } else { Err(gone(path)) }
    }

    /// The same after a commit, which went into the log. SQLite makes a new log with a new connection, so
    /// that its identity says nothing.
    pub fn check_commit(&self) -> Result<(), StoreError> {
        self.check()?;
        let Some(Files { log, .. }) = &self.0.files else { return Ok(()) };
        if cfg!(not(unix)) || log.exists() { Ok(()) } else { Err(gone(log)) }
    }

    /// Takes note of how a write ended.
    pub fn note<T>(&self, outcome: &Result<T, StoreError>) {
        let mut failure = self.0.failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        match outcome {
            Ok(_) => *failure = None,
            Err(error) if error.is_of_storage() => *failure = Some((Instant::now(), error.to_string())),
            Err(_) => {}
        }
    }

    fn failure(&self) -> Option<String> {
        let failure = self.0.failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let (when, why) = failure.as_ref()?;
        (when.elapsed() < FAILURE_COUNTS_FOR).then(|| why.clone())
    }
}

fn gone(path: &Path) -> StoreError {
    StoreError::Gone { path: path.display().to_string() }
}

impl Store {
    /// Whether what is saved lasts: the files that were opened are those that are there, and what was last to
    /// be saved was.
    ///
    /// # Errors
    /// [`StoreError::Gone`] or [`StoreError::Failing`].
    pub fn check_saving(&self) -> Result<(), StoreError> {
        self.place().check()?;
        self.place().failure().map_or(Ok(()), |why| Err(StoreError::Failing(why)))
    }
}
