//! From a stored session to an engine that goes on with it.

use super::SessionId;
use super::host::Watchers;
use super::writer::Sink;
use crate::clock::SystemClock;
use crate::error::ApiError;
use crate::options::{engine_config_of, engine_config_of_added};
use crate::soundness::damaged;
use crate::traces::session_span;
use geometry::Camera;
use slam::map::{CameraId, FrameState, MapCamera};
use slam::{JoinState, MapUpdate, Pipeline, ResumeState, SceneMask, SharedMap, SlamConfig};
use std::sync::{Arc, Mutex, PoisonError};
use store::{
    KeyframeImage, LoadedCamera, LoadedSession, Segments, SessionRecord, SessionStatus, Store, StoredFrame,
};
use tracing::Instrument;

/// Which session of which database.
pub struct LoadContext<'a> {
    /// The database.
    pub store: &'a Store,
    /// The session.
    pub id: &'a SessionId,
}

/// A session with a map of its own, as it is stored.
pub struct StoredSession {
    id: SessionId,
    /// The session.
    pub record: SessionRecord,
    /// By how much the engine's times are ahead of the client's, nanoseconds.
    pub ahead_ns: i64,
    /// What its engine runs with.
    pub config: SlamConfig,
    /// Its camera.
    pub camera: Camera,
    /// Its map and its last frame.
    pub state: ResumeState,
}

impl StoredSession {
    /// Number and time of the last stored frame.
    pub fn last_frame(&self) -> Option<(u64, i64)> {
        self.record.last_frame
    }
}

impl LoadContext<'_> {
    /// What is stored of the session's earlier frames; `map` is the key of the session whose map it is.
    pub fn history(&self, map: &str) -> History {
        History { store: self.store.clone(), id: self.id.clone(), map: map.to_owned() }
    }

    /// Where the updates of the session's map are saved; `watchers` are told of each.
    pub fn sink(&self, last_state: FrameState, watchers: Watchers) -> impl Sink + use<> {
        let (store, id) = (self.store.clone(), self.id.clone());
        SessionSink { store, id, last_state: Mutex::new(last_state), watchers }
    }
}

/// Reads a session from the database.
///
/// # Errors
/// If there is none, or what is stored cannot be used.
pub async fn read(context: &LoadContext<'_>) -> Result<StoredSession, ApiError> {
    let record = context.store.get_session(context.id.as_str()).await?;
    let config = engine_config_of(&record)?;
    let loaded = context.store.load_session(context.id.as_str(), &config).await;
    let LoadedSession { record, resume: state, segments } = loaded.map_err(|error| {
        if error.is_of_damage() { cannot_be_taken_up(context.id, &error) } else { error.into() }
    })?;
    let camera = record.checked_camera()?;
    let ahead_ns = ahead_of_next(&record, &segments);
    Ok(StoredSession { id: context.id.clone(), record, ahead_ns, config, camera, state })
}

/// By how much the engine's times are ahead of the client's at the next frame, nanoseconds.
fn ahead_of_next(record: &SessionRecord, segments: &Segments) -> i64 {
    segments.ahead_ns(record.last_frame.map_or(0, |(sequence, _)| sequence.saturating_add(1)))
}

fn cannot_be_taken_up(id: &SessionId, error: &dyn std::error::Error) -> ApiError {
    tracing::error!(session.id = id.as_str(), "session {id} cannot be taken up: {error}");
    damaged(&error.to_string())
}

/// Makes the engine of a map; takes as long as the map is large, so not on a runtime's thread.
///
/// # Errors
/// If the stored map is inconsistent.
pub fn shared_map(stored: StoredSession) -> Result<SharedMap, ApiError> {
    let StoredSession { id, config, camera, state, .. } = stored;
    SharedMap::resume(config, &camera, state.map).map_err(|error| cannot_be_taken_up(&id, &error))
}

/// What one session's pipeline is taken up with.
pub struct StoredCamera {
    /// The session.
    pub record: SessionRecord,
    /// By how much the engine's times are ahead of the client's, nanoseconds.
    pub ahead_ns: i64,
    config: SlamConfig,
    camera: Camera,
    map_camera: MapCamera,
    join: JoinState,
}

/// Reads what the pipeline of a session's camera is taken up with; `map` is the session's whose map it is.
///
/// # Errors
/// If there is no such session, or what is stored cannot be used.
pub async fn read_camera(context: &LoadContext<'_>, map: &SessionRecord) -> Result<StoredCamera, ApiError> {
    let LoadedCamera { record, join, segments } = context.store.load_camera(context.id.as_str()).await?;
    let config = match &record.map {
        None => engine_config_of(&record)?,
        Some(_) => engine_config_of_added(map, &record)?,
    };
    let map_camera = MapCamera { id: record.camera_id, is_refined: record.camera == map.camera };
    let (camera, ahead_ns) = (record.checked_camera()?, ahead_of_next(&record, &segments));
    Ok(StoredCamera { record, ahead_ns, config, camera, map_camera, join })
}

/// Has the camera join its map; takes as long as the map is large, so not on a runtime's thread.
///
/// # Errors
/// If the configuration cannot be used.
pub fn join(id: &SessionId, stored: StoredCamera, map: &SharedMap) -> Result<Pipeline, ApiError> {
    let StoredCamera { config, camera, map_camera, join, .. } = stored;
    Pipeline::join(map, map_camera, (config, camera), Arc::new(SystemClock::new()), join)
        .map_err(|error| cannot_be_taken_up(id, &error))
}

/// The stored frames of one session.
#[derive(Clone)]
pub struct History {
    store: Store,
    id: SessionId,
    map: String,
}

impl History {
    /// Begins a segment with a frame that is new: from there on the engine's times are ahead of the client's
    /// by so much.
    ///
    /// # Errors
    /// If it cannot be stored.
    pub async fn begin_segment(&self, sequence: u64, ahead_ns: i64) -> Result<(), ApiError> {
        Ok(self.store.begin_segment(self.id.as_str(), sequence, ahead_ns).await?)
    }

    /// Whether the session and its map are this server's: what it computes of them may be told.
    pub fn is_ours(&self) -> bool {
        self.store.keeps(self.id.as_str()) && self.store.keeps(&self.map)
    }

    /// Saves what of the images is left out.
    pub async fn save_mask(&self, mask: Option<SceneMask>) {
        if let Err(error) = self.store.set_mask(self.id.as_str(), mask.as_ref()).await {
            tracing::warn!(session.id = self.id.as_str(), "the mask that was found cannot be saved: {error}");
        }
    }

    /// What came of a frame; `None` if it is not stored or cannot be read.
    pub async fn frame(&self, sequence: u64) -> Option<StoredFrame> {
        match self.store.frame(self.id.as_str(), sequence).await {
            Ok(frame) => frame,
            Err(error) => {
                tracing::warn!(session.id = self.id.as_str(), "a stored frame cannot be read: {error}");
                None
            }
        }
    }
}

/// Saves the updates of one map.
struct SessionSink {
    store: Store,
    id: SessionId,
    /// How tracking the last frame of the map's own camera ended, for updates without frames of it.
    last_state: Mutex<FrameState>,
    watchers: Watchers,
}

impl Sink for SessionSink {
    async fn commit(&self, update: &MapUpdate, images: &[KeyframeImage]) -> Result<(), ApiError> {
        let state = {
            let mut last_state = self.last_state.lock().unwrap_or_else(PoisonError::into_inner);
            let own = update.frames.iter().filter(|frame| frame.camera == CameraId::default());
            if let Some(last) = own.filter(|frame| !frame.backfilled).max_by_key(|frame| frame.sequence) {
                *last_state = last.state;
            }
            *last_state
        };
        let saving = self.store.save_update(self.id.as_str(), update, SessionStatus { state }, images);
        saving.instrument(session_span!("commit", self.id.as_str())).await?;
        self.watchers.saved(update);
        Ok(())
    }
}
