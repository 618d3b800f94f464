//! Databases of maps made by hand.

use std::path::Path;

use slam::SlamConfig;
use slam::map::{FrameState, MapParts};
use store::{NewSession, SessionOptions, SessionStatus, Store, StoreOptions};

use crate::world::camera;
use tempfile::TempDir;

/// Where a test's database is: the contract of the store is the same in either.
pub enum Home {
    /// In a file of SQLite.
    File(TempDir),
    /// On the server of PostgreSQL that all tests share.
    Postgres(String),
}

impl Home {
    /// An empty one, in a file.
    pub fn file() -> Self {
        Self::File(tempfile::tempdir().unwrap())
    }

    /// An empty one of PostgreSQL.
    ///
    /// # Panics
    /// If PostgreSQL is not installed.
    pub fn postgres() -> Self {
        Self::Postgres(crate::postgres::shared_database())
    }

    /// Opens the database, as often as one wants.
    pub async fn open(&self) -> Store {
        match self {
            Self::File(folder) => Store::open(folder.path().join("maps.db"), StoreOptions::default()).await,
            Self::Postgres(url) => Store::connect(url, StoreOptions::default()).await,
        }
        .unwrap()
    }

    /// Opens it and makes one session, `s`.
    pub async fn store_with_session(&self) -> Store {
        let store = self.open().await;
        store.create_session(&new_session("s")).await.unwrap();
        store
    }
}

/// A session of the camera of all maps.
pub fn new_session(id: &str) -> NewSession {
    let options = SessionOptions { seed: Some(7), deterministic: Some(true), ..SessionOptions::default() };
    NewSession {
        id: id.into(),
        camera: camera(),
        options,
        created_at_ns: 1_700_000_000_000_000_000,
        mask: None,
        map: None,
    }
}

/// What updates say of the session.
pub const TRACKED: SessionStatus = SessionStatus { state: FrameState::Tracked };

/// A database in a folder of its own with one session, `s`.
pub async fn store_with_session(folder: &Path) -> Store {
    let store = Store::open(folder.join("maps.db"), StoreOptions::default()).await.unwrap();
    store.create_session(&new_session("s")).await.unwrap();
    store
}

/// What is stored of the session `s`.
pub async fn load(store: &Store) -> MapParts {
    store.load_session("s", &SlamConfig::default()).await.unwrap().resume.map
}
