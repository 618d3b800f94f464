//! What can go wrong with the database, sorted by what the caller can do about it.

use crate::Owner;
use slam::map::MapError;
use sqlx::error::DatabaseError as _;
use sqlx::sqlite::SqliteError;

/// Why the store could not do what it was asked. Each message is a plain sentence.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database was written by a later version of this program; nothing in it was touched.
    #[error(
        "the database has schema version {found}, but this program knows versions up to {supported}: update the program"
    )]
    NewerSchema {
        /// Version of the file.
        found: i64,
        /// Highest version known here.
        supported: i64,
    },
    /// The file is a database of something else, or no database at all.
    #[error("{path} is not a map database")]
    NotAStore {
        /// The file.
        path: String,
    },
    /// There is no such session.
    #[error("there is no session {id:?}")]
    SessionNotFound {
        /// The name asked for.
        id: String,
    },
    /// The name is taken.
    #[error("there is already a session {id:?}")]
    SessionExists {
        /// The name asked for.
        id: String,
    },
    /// Other sessions' cameras extend the session's map.
    #[error("session {by:?} has its camera extend the map of session {id:?}; delete that one first")]
    MapInUse {
        /// The session whose map it is.
        id: String,
        /// One of the others.
        by: String,
    },
    /// The name of a token is taken.
    #[error("there is already a token {name:?}; tokens that were revoked keep their names")]
    TokenExists {
        /// The name asked for.
        name: String,
    },
    /// There is no such token.
    #[error("there is no token {name:?}")]
    TokenNotFound {
        /// The name asked for.
        name: String,
    },
    /// A number does not fit the database.
    #[error("{what} {value} is too large to be stored")]
    OutOfRange {
        /// Which number, such as `sequence`.
        what: &'static str,
        /// Its value.
        value: u64,
    },
    /// A number of the map is not finite; nothing of the update was stored.
    #[error("{0} has a number that is not finite")]
    NotFinite(String),
    /// The stored keyframes were measured with other settings than those they should be taken up with.
    #[error("the session's keyframes were made with other settings: {0}")]
    OtherSettings(String),
    /// The disk, or the room allowed to the database, is used up. The last commit is intact and the update
    /// can be tried again.
    #[error("there is no room left for the database; nothing of the last update was stored")]
    DiskFull(#[source] sqlx::Error),
    /// Reading or writing the file failed. The last commit is intact.
    #[error("reading or writing the database failed")]
    Io(#[source] sqlx::Error),
    /// The file, or its log, was deleted or replaced while it was open: what is written now is lost with this
    /// process.
    #[error(
        "{path} was removed or replaced while the server uses it, so nothing more is saved: stop the server, put the \
         database back or a backup in its place, and start it again"
    )]
    Gone {
        /// The file.
        path: String,
    },
    /// What was to be saved last could not be.
    #[error("saving fails: {0}")]
    Failing(String),
    /// Somebody else kept the database locked for longer than the time allowed.
    #[error("the database is in use by another program")]
    Busy(#[source] sqlx::Error),
    /// PostgreSQL does not answer, does not take connections, or ended this one. The last commit is intact
    /// and the update can be tried again.
    #[error("PostgreSQL cannot be reached or used at present: {0}")]
    Unreachable(#[source] sqlx::Error),
    /// The object store of images does not answer or cannot be used. The last commit is intact and the update
    /// can be tried again.
    #[error("the object store of the images cannot be used at present: {0}")]
    Objects(String),
    /// Another server works with the session.
    #[error("another server works with session {id:?}: {}", owner.grpc_url)]
    OwnedElsewhere {
        /// The session.
        id: String,
        /// That server.
        owner: Owner,
    },
    /// This server worked with the session and does not any more: it was not heard of for too long. Nothing
    /// of the update was stored.
    #[error("this server stood still for too long to go on with session {id:?}; what was not saved is lost")]
    LeaseLost {
        /// The session.
        id: String,
    },
    /// Where the database should be is no address.
    #[error("the address of the database cannot be used: {0}")]
    Address(String),
    /// What is stored cannot be understood.
    #[error("the database is damaged: {0}")]
    Corrupt(String),
    /// A stored map contradicts itself.
    #[error(transparent)]
    Map(#[from] MapError),
    /// It was told not to go on.
    #[error("it was stopped before it ended")]
    Stopped,
    /// The update contradicts what is stored; nothing of it was stored.
    #[error("the update contradicts the stored map")]
    Inconsistent(#[source] sqlx::Error),
    /// The migrations did not run.
    #[error("the database could not be brought up to date")]
    Migrate(#[from] sqlx::migrate::MigrateError),
    /// Anything else the database reports.
    #[error("the database failed")]
    Database(#[source] sqlx::Error),
}

impl StoreError {
    /// Whether it says that nothing can be saved at present, not something about what was to be saved.
    pub(crate) fn is_of_storage(&self) -> bool {
        // What one session has damaged is not the others' concern.
        matches!(
            self,
            Self::DiskFull(_)
                | Self::Io(_)
                | Self::Busy(_)
                | Self::Gone { .. }
                | Self::Unreachable(_)
                | Self::Database(_)
        )
    }

    /// Whether it says that what is stored is damaged.
    pub fn is_of_damage(&self) -> bool {
        matches!(self, Self::Corrupt(_) | Self::Map(_))
    }

    /// Whether the database, or the folder that its log belongs in, cannot be written.
    pub fn is_unwritable(&self) -> bool {
        let error = match self {
            Self::Io(error) | Self::Database(error) => error,
            Self::Migrate(sqlx::migrate::MigrateError::Execute(error)) => error,
            _ => return false,
        };
        matches!(primary_code(error), Some(code::READONLY | code::CANTOPEN))
    }
}

/// Primary result codes of SQLite, the low byte of an extended one <https://www.sqlite.org/rescode.html>.
mod code {
    pub const BUSY: i32 = 5;
    pub const READONLY: i32 = 8;
    pub const INTERRUPT: i32 = 9;
    pub const IOERR: i32 = 10;
    pub const CORRUPT: i32 = 11;
    pub const FULL: i32 = 13;
    pub const CANTOPEN: i32 = 14;
    pub const CONSTRAINT: i32 = 19;
    pub const NOTADB: i32 = 26;
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        match primary_code(&error) {
            Some(code::FULL) => Self::DiskFull(error),
            Some(code::IOERR | code::CANTOPEN) => Self::Io(error),
            Some(code::BUSY) => Self::Busy(error),
            Some(code::CORRUPT | code::NOTADB) => Self::Corrupt(error.to_string()),
            Some(code::CONSTRAINT) => Self::Inconsistent(error),
            _ => match error {
                sqlx::Error::Io(_) => Self::Io(error),
                sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_) => Self::Corrupt(error.to_string()),
                _ => Self::Database(error),
            },
        }
    }
}

/// SQLite's result code without its extension; `None` of other databases' errors.
pub(crate) fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let error = error.as_database_error()?.try_downcast_ref::<SqliteError>()?;
    let extended: i32 = error.code()?.parse().ok()?;
    Some(extended & 0xff)
}

/// Whether the error says that what is stored is damaged.
pub(crate) fn is_damage(error: &sqlx::Error) -> bool {
    matches!(primary_code(error), Some(code::CORRUPT | code::NOTADB))
}

/// Whether the error says that it was told to stop.
pub(crate) fn is_interrupted(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(code::INTERRUPT)
}

/// Whether the error says that the file is no database.
pub(crate) fn is_not_a_database(error: &sqlx::Error) -> bool {
    primary_code(error) == Some(code::NOTADB)
}
