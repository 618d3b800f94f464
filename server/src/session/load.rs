//! From a stored session to an engine that goes on with it.

use super::SessionId;
use super::events::Events;
use super::writer::Sink;
use crate::clock::SystemClock;
use crate::error::ApiError;
use crate::options::engine_config_of;
use crate::soundness::damaged;
use crate::traces::session_span;
use geometry::Camera;
use slam::map::FrameState;
use slam::{MapUpdate, Pipeline, ResumeState, SceneMask, SlamConfig};
use std::sync::{Arc, Mutex, PoisonError};
use store::{KeyframeImage, LoadedSession, SessionStatus, Store, StoredFrame};
use tracing::Instrument;

/// Which session of which database.
pub struct LoadContext<'a> {
    /// The database.
    pub store: &'a Store,
    /// The session.
    pub id: &'a SessionId,
}

/// What a session is taken up with.
pub struct StoredSession {
    id: SessionId,
    /// Its options ask for repeatable results.
    pub deterministic: bool,
    /// How tracking the last stored frame ended.
    pub last_state: FrameState,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// By how much the engine's times are ahead of the client's, nanoseconds.
    pub ahead_ns: i64,
    last_frame: Option<(u64, i64)>,
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
        self.last_frame
    }
}

impl LoadContext<'_> {
    /// What is stored of the session's earlier frames.
    pub fn history(&self) -> History {
        History { store: self.store.clone(), id: self.id.clone() }
    }

    /// Where the session's updates are saved; `events` is told of each.
    pub fn sink(&self, last_state: FrameState, events: Events) -> impl Sink + use<> {
        let (store, id) = (self.store.clone(), self.id.clone());
        SessionSink { store, id, last_state: Mutex::new(last_state), events }
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
    let (deterministic, last_state) = (record.options.deterministic == Some(true), record.state);
    let metres_per_unit = record.metres_per_unit;
    let (id, last_frame) = (context.id.clone(), record.last_frame);
    let ahead_ns = segments.ahead_ns(last_frame.map_or(0, |(sequence, _)| sequence.saturating_add(1)));
    Ok(StoredSession {
        id,
        deterministic,
        last_state,
        metres_per_unit,
        ahead_ns,
        last_frame,
        config,
        camera,
        state,
    })
}

fn cannot_be_taken_up(id: &SessionId, error: &dyn std::error::Error) -> ApiError {
    tracing::error!(session.id = id.as_str(), "session {id} cannot be taken up: {error}");
    damaged(&error.to_string())
}

/// Makes the engine; takes as long as the map is large, so not on a runtime's thread.
///
/// # Errors
/// If the stored map is inconsistent.
pub fn resume(stored: StoredSession) -> Result<Pipeline, ApiError> {
    let StoredSession { id, config, camera, state, .. } = stored;
    Pipeline::resume(config, camera, Arc::new(SystemClock::new()), state)
        .map_err(|error| cannot_be_taken_up(&id, &error))
}

/// The stored frames of one session.
#[derive(Clone)]
pub struct History {
    store: Store,
    id: SessionId,
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

/// Saves the updates of one session.
struct SessionSink {
    store: Store,
    id: SessionId,
    /// How tracking the last frame ended, for updates without frames.
    last_state: Mutex<FrameState>,
    events: Events,
}

impl Sink for SessionSink {
    async fn commit(&self, update: &MapUpdate, images: &[KeyframeImage]) -> Result<(), ApiError> {
        let state = {
            let mut last_state = self.last_state.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(last) =
                update.frames.iter().filter(|frame| !frame.backfilled).max_by_key(|frame| frame.sequence)
            {
                *last_state = last.state;
            }
            *last_state
        };
        let saving = self.store.save_update(self.id.as_str(), update, SessionStatus { state }, images);
        saving.instrument(session_span!("commit", self.id.as_str())).await?;
        self.events.saved(update);
        Ok(())
    }
}
