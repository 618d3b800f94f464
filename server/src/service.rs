//! What the server does, once for both interfaces.

mod stored_maps;

use crate::access::{self, Access, Caller, Change};
use crate::budget::Budget;
use crate::config::Config;
use crate::current::{Changes, Current};
use crate::error::{ApiError, ErrorCode};
use crate::localization::Localization;
use crate::maps::{MapQueries, Observed, SceneParts, masks};
use crate::motion::Motion;
use crate::operations::{Operations, Tools};
use crate::options::{
    SessionOptions, camera_to_begin_with, camera_warnings, check_added_options, check_camera, engine_config,
    is_of_size_alone,
};
use crate::page::{Page, PageRequest};
use crate::session::{
    self, FrameQueue, OWNER_END, OpenRequest, Registry, Replies, Reply, SessionId, SessionView, ShownFrame,
};
use crate::soundness::Soundness;
use bytes::Bytes;
use geometry::CameraParameters;
use std::hash::RandomState;
use std::sync::Arc;
use std::time::Duration;
use store::{ServerRecord, SessionChanges, SessionRecord, Store, StoreError, StoredImage};
use tokio::sync::Semaphore;

/// Smallest image side the front end can use, pixels.
const MIN_IMAGE_PX: (u32, u32) = (160, 120);
/// Largest image, pixels: what the memory of a session is sized for.
const MAX_IMAGE_PX: (u32, u32) = (4096, 3072);

/// How long a single image may wait for its turn to be located.
const LOCALIZATION_PATIENCE: Duration = Duration::from_secs(20);

/// Metres a map unit can be: from an insect's flight to a satellite's.
const METRES_PER_UNIT: std::ops::RangeInclusive<f64> = 1e-6..=1e9;

/// The one service behind gRPC and HTTP.
pub struct Service {
    config: Current,
    store: Store,
    maps: MapQueries,
    registry: Arc<Registry>,
    operations: Operations,
    localization: Localization,
    access: Arc<Access>,
    soundness: Arc<Soundness>,
    budget: Arc<Budget>,
    /// Sessions there are. Held while one is made, so that two at once cannot pass the limit.
    n_sessions: tokio::sync::Mutex<u64>,
    /// Single images that may be located at the same time.
    localizations: Arc<Semaphore>,
    /// Seeded by this start of the server.
    tags: RandomState,
}

/// A session to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct NewSession {
    /// Its id; `None` lets the server make one.
    pub id: Option<SessionId>,
    /// The session whose map its camera extends, or one that extends it too; `None` gives it a map of its
    /// own.
    pub map: Option<SessionId>,
    /// Its camera; may be left out where it extends a map and is like the map's own.
    pub camera: Option<CameraParameters>,
    /// The session's options.
    pub options: SessionOptions,
    /// The file of a picture that is dark where nothing of its images is to be used.
    pub mask: Option<Bytes>,
}

impl Service {
    /// A service over a database.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn new(config: Arc<Config>, store: Store) -> Result<Self, ApiError> {
        Self::of_sound(config, store, Arc::default()).await
    }

    /// As [`Self::new`], with what is known of damage in the database.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(crate) async fn of_sound(
        config: Arc<Config>,
        store: Store,
        soundness: Arc<Soundness>,
    ) -> Result<Self, ApiError> {
        let current = Current::new(config.clone());
        let registry = Arc::new(Registry::new(current.clone(), store.clone()));
        let tools = Tools { registry: registry.clone(), store: store.clone() };
        let operations = Operations::new(tools, config.sessions.n_operations, config.limits.max_operations);
        let localization =
            Localization::new(store.clone(), registry.clone(), config.decode_limits(), &config.sessions);
        let access = Access::new(config.access.clone(), config.quotas.clone(), store.clone()).await;
        let access = access.map_err(|error| ApiError::internal(format!("{error:#}")))?;
        let n_sessions = tokio::sync::Mutex::new(store.count_sessions_of("").await?);
        let localizations = Arc::new(Semaphore::new(config.sessions.n_localizations));
        let maps = MapQueries::new(store.clone(), config.data_dir.clone(), config.decode_limits());
        let budget = Arc::new(Budget::new(config.limits.max_bytes_in_flight));
        Ok(Self {
            config: current,
            store,
            maps,
            registry,
            operations,
            localization,
            access,
            soundness,
            budget,
            n_sessions,
            localizations,
            tags: RandomState::new(),
        })
    }

    /// The configuration as it is now.
    pub fn config(&self) -> Arc<Config> {
        self.config.get()
    }

    /// Takes over what differs between the configuration as it was read before and as it is read now, as far
    /// as that can change while the server runs.
    ///
    /// # Errors
    /// As [`Current::change`].
    pub(crate) fn reconfigure(&self, before: &Config, now: &Config) -> anyhow::Result<Changes> {
        let changes = self.config.change(before, now)?;
        let config = self.config();
        self.access.reconfigure(&config.access, &config.quotas);
        Ok(changes)
    }

    /// What can be asked of maps.
    pub fn maps(&self) -> &MapQueries {
        &self.maps
    }

    /// What the motion sensors of sessions' devices measured.
    pub fn motion(&self) -> Motion {
        Motion::new(self.store.clone())
    }

    /// Who may do what.
    pub fn access(&self) -> &Arc<Access> {
        &self.access
    }

    /// The sessions in memory.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// Makes a session, with a map of its own or one more camera on another's.
    ///
    /// # Errors
    /// If the camera or an option cannot be used, the id is taken, there are too many sessions, or the map
    /// cannot be extended.
    pub async fn create_session(&self, caller: &Caller, new: NewSession) -> Result<SessionView, ApiError> {
        self.registry.check_open()?;
        let NewSession { id, map, camera, options, mask } = new;
        let map = match map {
            Some(other) => Some((other.clone(), self.store.map_of(other.as_str()).await?)),
            None => None,
        };
        let (camera, options) = match &map {
            Some((_, map)) => added_camera(map, camera, options)?,
            None => {
                let camera = camera.ok_or_else(|| ApiError::invalid("camera", "a session needs a camera"))?;
                camera_to_begin_with(camera, options)
            }
        };
        check_image_size(&camera, self.config().limits.max_image_pixels)?;
        let camera = check_camera(camera)?;
        engine_config(&options)?;
        let mask = match mask {
            Some(file) => Some(masks::read(file, camera.parameters(), self.config().decode_limits()).await?),
            None => None,
        };
        let limit = self.config().limits.max_sessions;
        let mut n_sessions = self.n_sessions.lock().await;
        if *n_sessions >= limit {
            let sentence =
                format!("there are {limit} sessions, as many as this server keeps; delete one first");
            return Err(ApiError::new(ErrorCode::TooManySessions, sentence));
        }
        self.check_room_for_session(caller).await?;
        let owner = match &map {
            Some((other, _)) => owner_of(other.as_str()),
            None => caller.owner(),
        };
        let id = id.unwrap_or_else(|| SessionId::generate(owner));
        if map.is_some() && owner_of(id.as_str()) != owner {
            return Err(ApiError::invalid(
                "map",
                "is another owner's: only sessions of one owner share a map",
            ));
        }
        let created_at_ns = crate::clock::since_1970_ns();
        let (id_text, options) = (id.as_str().to_owned(), options.into());
        let camera = camera.parameters().clone();
        let new = store::NewSession {
            id: id_text,
            camera,
            options,
            created_at_ns,
            mask,
            map: map.map(|(_, map)| map.id),
        };
        let record = self.store.create_session(&new).await?;
        *n_sessions += 1;
        access::record(caller, Change::Created, &id);
        for warning in camera_warnings(&record.camera) {
            tracing::warn!(session.id = %id, "session {id}: {warning}");
        }
        Ok(self.view(&id, record))
    }

    /// A session.
    ///
    /// # Errors
    /// If there is none of this id.
    pub async fn get_session(&self, id: &SessionId) -> Result<SessionView, ApiError> {
        Ok(self.view(id, self.store.get_session(id.as_str()).await?))
    }

    /// A page of sessions in the order of their ids.
    ///
    /// # Errors
    /// If the page token is none of ours.
    pub async fn list_sessions(
        &self,
        caller: &Caller,
        page: &PageRequest,
    ) -> Result<Page<SessionView>, ApiError> {
        // A token is the last id of the page before.
        let after = page.token().map(|token| caller.session(token, "page_token")).transpose()?;
        let after = after.as_ref().map(SessionId::as_str);
        let stored = self.store.list_sessions_of(&caller.prefix(), after, page.size()).await?;
        let next = stored.next.map(|key| caller.stored(key));
        let view = |record: SessionRecord| self.view(&caller.stored(record.id.clone()), record);
        Ok(Page::of(store::Page { items: stored.items, next }, view))
    }

    /// Deletes a session with its map, or, where it extends another's, with its trajectory: what it has put
    /// into that map stays.
    ///
    /// # Errors
    /// If there is none of this id, a writer is connected, or others extend its map.
    pub async fn delete_session(&self, caller: &Caller, id: &SessionId) -> Result<(), ApiError> {
        self.store.get_session(id.as_str()).await?;
        // Before it is taken out of memory; in the database it is looked at once more.
        if let Some(by) = self.store.cameras_of(id.as_str()).await?.into_iter().next() {
            return Err(StoreError::MapInUse { id: id.as_str().to_owned(), by }.into());
        }
        let delete = async { Ok(self.store.delete_session(id.as_str()).await?) };
        self.registry.delete(id, delete).await?;
        self.soundness.forget(id.as_str());
        let mut n_sessions = self.n_sessions.lock().await;
        *n_sessions = n_sessions.saturating_sub(1);
        access::record(caller, Change::Deleted, id);
        Ok(())
    }

    /// Changes a session's options; what is `None` stays. They hold from its next stream on.
    ///
    /// # Errors
    /// If there is none of this id, a writer is connected, or an option cannot be used.
    pub async fn update_session(
        &self,
        caller: &Caller,
        id: &SessionId,
        options: SessionOptions,
    ) -> Result<SessionView, ApiError> {
        self.registry.check_open()?;
        self.store.get_session(id.as_str()).await?;
        let change = async {
            let record = self.store.get_session(id.as_str()).await?;
            let before = SessionOptions::from(record.options);
            let options = before.changed(options);
            if record.map.is_some() {
                check_added_options(&options)?;
            }
            engine_config(&options)?;
            let changes = SessionChanges { options: Some(options.into()), ..SessionChanges::default() };
            Ok(self.store.update_session(id.as_str(), &changes).await?)
        };
        let record = self.registry.change(id, change).await?;
        access::record(caller, Change::Updated, id);
        Ok(self.view(id, record))
    }

    /// What of a session's images is left out, as a gray picture in a PNG file: white where the scene is,
    /// black where nothing is used.
    ///
    /// # Errors
    /// If there is none of this id, or nothing is left out.
    pub async fn mask(&self, id: &SessionId) -> Result<Bytes, ApiError> {
        let camera = self.store.get_session(id.as_str()).await?.checked_camera()?;
        let known = self.store.mask(id.as_str()).await?;
        masks::picture(known, camera).await?.ok_or_else(|| masks::none_of(id))
    }

    /// Gives what of a session's images is to be left out, or, with `None`, lets that be found. It holds from
    /// its next stream on.
    ///
    /// # Errors
    /// If there is none of this id, a writer is connected, or the picture cannot be used.
    pub async fn set_mask(
        &self,
        caller: &Caller,
        id: &SessionId,
        file: Option<Bytes>,
    ) -> Result<SessionView, ApiError> {
        self.registry.check_open()?;
        let camera = self.store.get_session(id.as_str()).await?.camera;
        let mask = match file {
            Some(file) => Some(masks::read(file, &camera, self.config().decode_limits()).await?),
            None => None,
        };
        let change = async {
            self.store.set_mask(id.as_str(), mask.as_ref()).await?;
            Ok(self.store.get_session(id.as_str()).await?)
        };
        let record = self.registry.change(id, change).await?;
        access::record(caller, Change::Updated, id);
        Ok(self.view(id, record))
    }

    /// The map as a viewer draws it: what changed since a revision, or, where that is not known any more,
    /// all.
    ///
    /// # Errors
    /// If there is none of this id.
    pub async fn scene(&self, id: &SessionId, since: Option<&str>) -> Result<SceneParts, ApiError> {
        // Looked up first: asking what changed makes a place for the session.
        self.store.get_session(id.as_str()).await?;
        let known = since.and_then(|text| text.parse().ok());
        self.maps.scene(id, self.registry.since(id, known)).await
    }

    /// The image of one of the last frames of a session that is watched.
    ///
    /// # Errors
    /// If there is none of this id, or the frame is not kept.
    pub async fn frame_image(&self, id: &SessionId, sequence: u64) -> Result<StoredImage, ApiError> {
        let frame = self.shown_frame(id, sequence).await?;
        let file = tokio::task::spawn_blocking(move || session::as_file(&frame.image)).await;
        file.map_err(ApiError::internal)?.ok_or_else(|| no_frame(id, sequence))
    }

    /// What was measured and recognized in one of the last frames of a session that is watched.
    ///
    /// # Errors
    /// If there is none of this id, or the frame is not kept.
    pub async fn frame_observed(&self, id: &SessionId, sequence: u64) -> Result<Observed, ApiError> {
        let frame = self.shown_frame(id, sequence).await?;
        self.maps.observed_frame(id, &frame).await
    }

    async fn shown_frame(&self, id: &SessionId, sequence: u64) -> Result<Arc<ShownFrame>, ApiError> {
        self.store.get_session(id.as_str()).await?;
        self.registry.shown_frame(id, sequence).ok_or_else(|| no_frame(id, sequence))
    }

    /// Opens a stream of frames into a session; the answers go to `replies`, the session's state first.
    ///
    /// # Errors
    /// If there is no such session, it has a writer, or it cannot be loaded.
    pub async fn open_stream(
        &self,
        caller: &Caller,
        request: OpenRequest,
        replies: Replies,
    ) -> Result<Arc<FrameQueue>, ApiError> {
        let id = request.id.clone();
        self.store.get_session(id.as_str()).await?;
        self.soundness.require_sound(id.as_str())?;
        check_stored_bytes(&self.store, caller).await?;
        let queue = self.registry.open_stream(request, replies.clone()).await;
        let queue = queue.inspect_err(|error| self.note_damage(&id, error))?;
        if let Err(error) = caller.count_stream(&queue) {
            queue.abort(Err(error.clone()));
            return Err(error);
        }
        access::record(caller, Change::Streamed, &id);
        tokio::spawn(watch_over(self.store.clone(), caller.clone(), queue.clone(), self.quota_check()));
        // Read again: a writer that had to make way has saved its last frames meanwhile.
        let opened = self.get_session(&id).await;
        if let Err(error) = &opened {
            queue.abort(Err(error.clone()));
        }
        // The channel is new and has room; if the client has gone, the worker notices.
        let _ = replies.send(Ok(Reply::Opened(Box::new(opened?)))).await;
        Ok(queue)
    }

    /// Whether the database answers, and what is saved lasts.
    ///
    /// # Errors
    /// Why not. Nothing is logged: whoever asks does so again and again.
    pub async fn check_storage(&self) -> Result<(), StoreError> {
        self.store.check_saving()?;
        self.store.list_sessions(None, 1).await?;
        Ok(())
    }

    /// The servers that share the database, as they reported themselves; none where this one is alone.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn fleet(&self) -> Result<Vec<ServerRecord>, ApiError> {
        Ok(self.store.servers().await?)
    }

    /// Room for what clients send.
    pub(crate) fn budget(&self) -> &Arc<Budget> {
        &self.budget
    }

    /// What is known of damage in the database.
    pub(crate) fn soundness(&self) -> &Soundness {
        &self.soundness
    }

    /// A session that cannot be loaded for damage is closed, so that lists say so.
    fn note_damage(&self, id: &SessionId, error: &ApiError) {
        if error.code == ErrorCode::SessionDamaged {
            self.soundness.close(id.as_str(), "its map cannot be loaded");
        }
    }

    async fn check_room_for_session(&self, caller: &Caller) -> Result<(), ApiError> {
        let Some(limit) = caller.quotas().max_sessions else { return Ok(()) };
        if self.store.count_sessions_of(&caller.prefix()).await? < limit {
            return Ok(());
        }
        let sentence =
            format!("there are {limit} sessions, as many as may be made with this token; delete one first");
        Err(ApiError::new(ErrorCode::QuotaExceeded, sentence))
    }

    fn quota_check(&self) -> Duration {
        Duration::from_secs_f64(self.config().quotas.check_s)
    }

    fn view(&self, id: &SessionId, record: SessionRecord) -> SessionView {
        let loaded = self.registry.view(id);
        let damage = self.soundness.damage(id.as_str());
        let map = record.map.as_ref().map(|map| id.beside(map).to_string());
        SessionView { id: id.to_string(), damage, map, ..SessionView::of(record, loaded) }
    }
}

/// Whose session it is, as its key says.
fn owner_of(key: &str) -> Option<&str> {
    key.split_once(OWNER_END).map(|(owner, _)| owner)
}

/// Ends a stream when its client's token is revoked, or what its owner stores is as much as it may be.
async fn watch_over(store: Store, caller: Caller, queue: Arc<FrameQueue>, check_every: Duration) {
    loop {
        tokio::select! {
            () = queue.closed() => return,
            () = caller.revoked().cancelled() => {
                let sentence = "the token has run out or was revoked";
                return queue.abort(Err(ApiError::new(ErrorCode::Unauthenticated, sentence)));
            }
            () = tokio::time::sleep(check_every), if caller.quotas().max_stored_bytes.is_some() => {
                if let Err(error) = check_stored_bytes(&store, &caller).await {
                    return queue.close(Err(error));
                }
            }
        }
    }
}

async fn check_stored_bytes(store: &Store, caller: &Caller) -> Result<(), ApiError> {
    let Some(limit) = caller.quotas().max_stored_bytes else { return Ok(()) };
    let n_bytes = store.stored_bytes_of(&caller.prefix()).await?;
    if n_bytes < limit {
        return Ok(());
    }
    let sentence = format!(
        "the sessions hold {n_bytes} bytes, and {limit} is what this token may store; delete some first"
    );
    Err(ApiError::new(ErrorCode::QuotaExceeded, sentence))
}

/// The camera that is to extend a map, and its options.
fn added_camera(
    map: &SessionRecord,
    camera: Option<CameraParameters>,
    options: SessionOptions,
) -> Result<(CameraParameters, SessionOptions), ApiError> {
    if map.options.deterministic == Some(true) {
        let sentence = "is deterministic: in which order frames of several cameras come is chance, so that nothing would \
                        repeat";
        return Err(ApiError::invalid("map", sentence));
    }
    check_added_options(&options)?;
    let Some(camera) = camera else {
        let readout_ms = options.readout_ms.or(map.options.readout_ms);
        return Ok((map.camera.clone(), SessionOptions { readout_ms, ..options }));
    };
    if is_of_size_alone(&camera) {
        let sentence = "a camera that extends another's map needs its calibration (fx, fy, cx, cy), or is left out where it \
                        is like the map's own";
        return Err(ApiError::invalid("camera", sentence));
    }
    Ok((camera, options))
}

fn no_frame(id: &SessionId, sequence: u64) -> ApiError {
    let sentence = format!("frame {sequence} of session {id} is not kept, or no longer");
    ApiError::new(ErrorCode::FrameNotFound, sentence)
}

fn check_image_size(camera: &CameraParameters, max_pixels: u64) -> Result<(), ApiError> {
    let sides = [
        ("camera.width", camera.width, MIN_IMAGE_PX.0, MAX_IMAGE_PX.0),
        ("camera.height", camera.height, MIN_IMAGE_PX.1, MAX_IMAGE_PX.1),
    ];
    for (field, side, least, most) in sides {
        if !(least..=most).contains(&side) {
            return Err(ApiError::invalid(field, format!("is {side} but must be {least} to {most} pixels")));
        }
    }
    if u64::from(camera.width) * u64::from(camera.height) > max_pixels {
        return Err(ApiError::invalid(
            "camera.width",
            format!("images of more than {max_pixels} pixels are refused"),
        ));
    }
    Ok(())
}
