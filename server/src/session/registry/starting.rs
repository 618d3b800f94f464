//! Starting sessions: a map is taken into memory unless it is there, and a session's thread begun on it.

use super::super::SessionId;
use super::super::events::Events;
use super::super::host::{Ending, MapHost, Watchers};
use super::super::leaps::Leaps;
use super::super::load::{self, LoadContext, StoredCamera};
use super::super::slots::Room;
use super::super::view::Live;
use super::super::worker::{Ends, Persistence, Worker, WorkerConfig};
use super::super::writer;
use super::{Loaded, Registry};
use crate::error::ApiError;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use store::{SessionRecord, Store};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::{CancellationToken, DropGuard};

impl Registry {
    pub(super) async fn start(&self, id: &SessionId, events: Events, room: Room) -> Result<Loaded, ApiError> {
        let record = self.store.get_session(id.as_str()).await?;
        let Some(map) = record.map else {
            // The lease is its map's.
            return self.start_on(id, id, events, room).await;
        };
        self.store.take(id.as_str()).await?;
        let started = self.start_on(id, &id.beside(&map), events, room).await;
        if started.is_err() {
            self.store.give_back(id.as_str()).await;
        }
        started
    }

    /// Starts a session whose camera extends the map of the session `map`, which may be itself.
    async fn start_on(
        &self,
        id: &SessionId,
        map: &SessionId,
        events: Events,
        room: Room,
    ) -> Result<Loaded, ApiError> {
        let host = self.hosts.get(map, || self.take_up(map)).await?;
        let started = self.start_with(id, &host, events, room).await;
        if started.is_err() {
            // Who is the last waits, which no thread of the runtime may.
            let runtime = Handle::current();
            let _ = tokio::task::spawn_blocking(move || host.leave(&runtime)).await;
        }
        started
    }

    async fn start_with(
        &self,
        id: &SessionId,
        host: &Arc<MapHost>,
        events: Events,
        room: Room,
    ) -> Result<Loaded, ApiError> {
        let context = LoadContext { store: &self.store, id };
        let stored = load::read_camera(&context, host.record()).await?;
        host.watchers().add(id.as_str(), events.clone());
        let last_frame = stored.record.last_frame;
        let (history, ahead_ns) = (context.history(&host.record().id), stored.ahead_ns);
        let camera = stored.record.camera_id;
        let persistence = Persistence { host: host.clone(), camera, history, last_frame, ahead_ns };
        let leaps = Leaps::of(&self.config.get().sessions);
        let config = WorkerConfig {
            leaps,
            decode_limits: self.config.get().decode_limits(),
            realtime_max_wait: Duration::from_secs_f64(self.config.get().sessions.realtime_max_wait_s),
            keep_images: self.config.get().sessions.keep_keyframe_images,
            idle_unload: self.config.get().sessions.idle_unload(),
        };
        let (loaded, ends) = channels(&stored.record, host, events, self.config.get().sessions.idle_stream());
        let stay = Stay { _room: room, _ended: loaded.ended.clone().drop_guard() };
        let store = self.store.clone();
        spawn(Beginning { id: id.clone(), config, stored, persistence, ends, stay, store }).await?;
        Ok(loaded)
    }

    /// Takes the map of a session into memory.
    async fn take_up(&self, id: &SessionId) -> Result<MapHost, ApiError> {
        self.store.take(id.as_str()).await?;
        let host = self.take_up_taken(id).await;
        if host.is_err() {
            self.store.give_back(id.as_str()).await;
        }
        host
    }

    /// As [`Self::take_up`], of a map that no other server works with.
    async fn take_up_taken(&self, id: &SessionId) -> Result<MapHost, ApiError> {
        let context = LoadContext { store: &self.store, id };
        let stored = load::read(&context).await?;
        let record = stored.record.clone();
        let cores = self.cores.clone();
        let resumed = tokio::task::spawn_blocking(move || {
            // What works for the map has a share of its own.
            let _joined = cores.join();
            load::shared_map(stored)
        });
        let map = resumed.await.map_err(ApiError::internal)??;
        let watchers = Watchers::default();
        watchers.add(id.as_str(), self.slots.lasting(id));
        for other in self.store.cameras_of(id.as_str()).await? {
            watchers.add(&other, self.slots.lasting(&id.beside(&other)));
        }
        let (outbox, saving) = writer::start(
            context.sink(record.state, watchers.clone()),
            writer::Pace::of(&self.config.get().sessions, record.options.deterministic == Some(true)),
        );
        let ending = Ending { saving, store: self.store.clone(), runtime: Handle::current() };
        Ok(MapHost::new(record, map, outbox, watchers, Some(ending)))
    }
}

/// The ends of what ties the registry to a worker, and the worker's.
fn channels(record: &SessionRecord, host: &MapHost, events: Events, idle_stream: Duration) -> (Loaded, Ends) {
    // One stream may wait for the one before it to end; whoever brings another waits for the room.
    let (streams, streams_receiver) = mpsc::channel(1);
    let (live_sender, live) = watch::channel(Live::default());
    let (scale, scale_receiver) = watch::channel(record.metres_per_unit);
    let (unload, ended) = (CancellationToken::new(), CancellationToken::new());
    let ends = Ends {
        streams: streams_receiver,
        unload: unload.clone(),
        live: live_sender,
        scale: scale_receiver,
        events,
    };
    let counts = host.counts();
    (Loaded { streams, live, counts, unload, ended, writer: Mutex::default(), scale, idle_stream }, ends)
}

/// What a session's thread begins with.
struct Beginning {
    id: SessionId,
    config: WorkerConfig,
    stored: StoredCamera,
    persistence: Persistence,
    ends: Ends,
    /// Dropped when the thread ends, however that comes.
    stay: Stay,
    store: Store,
}

/// A session's stay in memory: its room is free before anybody learns that it has ended.
struct Stay {
    _room: Room,
    _ended: DropGuard,
}

/// Starts a session's thread; returns once its engine is there.
async fn spawn(beginning: Beginning) -> Result<(), ApiError> {
    let (ready_sender, ready) = oneshot::channel();
    let runtime = Handle::current();
    let thread = std::thread::Builder::new().name(format!("session-{}", beginning.id));
    let run = move || {
        let Beginning { id, config, stored, persistence, ends, stay: _stay, store } = beginning;
        let host = persistence.host.clone();
        let _joined = host.map().enter();
        let is_added = stored.record.map.is_some();
        let pipeline = match load::join(&id, stored, host.map()) {
            Ok(pipeline) => pipeline,
            Err(error) => {
                let _ = ready_sender.send(Err(error));
                return;
            }
        };
        let _ = ready_sender.send(Ok(()));
        tracing::info!(session.id = id.as_str(), "session {id} is in memory");
        let (events, key) = (ends.events.clone(), id.as_str().to_owned());
        Worker::new(id, config, pipeline, persistence, ends, runtime.clone()).run();
        host.leave(&runtime);
        if is_added {
            runtime.block_on(store.give_back(&key));
        }
        crate::memory::give_back();
        events.unloaded();
    };
    thread.spawn(run).map_err(ApiError::internal)?;
    ready.await.map_err(ApiError::internal)?
}
