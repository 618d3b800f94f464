//! Databases of maps made by hand.

use std::path::Path;

use slam::SlamConfig;
use slam::map::{FrameState, MapParts};
use store::{NewSession, SessionOptions, SessionStatus, Store, StoreOptions};

use crate::world::camera;

/// A session of the camera of all maps.
pub fn new_session(id: &str) -> NewSession {
    let options = SessionOptions { seed: Some(7), deterministic: Some(true), ..SessionOptions::default() };
    NewSession {
        id: id.into(),
        camera: camera(),
        options,
        created_at_ns: 1_700_000_000_000_000_000,
        mask: None,
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
