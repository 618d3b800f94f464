//! The sessions that are in memory, and who writes into them.

mod starting;

use super::SessionId;
use super::events::{Events, SessionEvent};
use super::gallery::ShownFrame;
use super::host::{Hosts, MapCounts};
use super::journal::{Revision, Since};
use super::occupancy::Occupancy;
use super::queue::{FrameQueue, Policy};
use super::slots::{self, Resident, Slots};
use super::view::{Live, LoadedView};
use super::worker::{Mode, Replies, Stream};
use crate::current::Current;
use crate::error::{ApiError, ErrorCode};
use slam::Cores;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use store::{Store, StoreError};
use tokio::sync::{broadcast, mpsc, watch};
use tokio_util::sync::CancellationToken;

/// What a client asks of a stream.
#[derive(Clone, Debug)]
pub struct OpenRequest {
    /// The session.
    pub id: SessionId,
    /// Whether frames may change the map.
    pub mode: Mode,
    /// What happens when frames come faster than they are tracked.
    pub policy: Policy,
    /// End the stream of the present writer, if there is one.
    pub take_over: bool,
    /// The first new frame begins a new segment.
    pub new_segment: bool,
}

/// See the module's documentation.
pub struct Registry {
    config: Current,
    store: Store,
    /// What lasts while a session comes and goes is who watches it.
    slots: Slots<SessionId, Loaded, Events>,
    /// The maps that those in memory extend.
    hosts: Hosts,
    /// Sessions that an operation works on. Whoever wants one of them is told instead of waiting for long.
    occupied: Occupancy,
    /// What sessions work with.
    cores: Cores,
    /// Cancelled before the server stops: it takes no further sessions then and hands over those it has.
    leaving: CancellationToken,
    /// Ends what watches sessions.
    closed: CancellationToken,
}

/// The right to take one session into memory or out of it.
type Held = slots::Held<Loaded, Events>;

/// A session in memory.
struct Loaded {
    streams: mpsc::Sender<Stream>,
    live: watch::Receiver<Live>,
    counts: watch::Receiver<MapCounts>,
    unload: CancellationToken,
    /// Cancelled when the worker is gone and the writer has saved what it could.
    ended: CancellationToken,
    writer: Mutex<Option<Writer>>,
    scale: watch::Sender<Option<f64>>,
    /// A stream that is not used for this long may have to make way.
    idle_stream: Duration,
}

/// The stream that is being served.
#[derive(Clone)]
struct Writer {
    queue: Arc<FrameQueue>,
    ending_soon: CancellationToken,
    served: CancellationToken,
}

impl Registry {
    /// A registry without sessions.
    pub fn new(config: Current, store: Store) -> Self {
        let slots = Slots::new(config.get().limits.max_loaded_sessions);
        let occupied = Occupancy::default();
        let (leaving, closed) = (CancellationToken::new(), CancellationToken::new());
        let start = Instant::now();
        let cores = Cores::new(config.get().sessions.n_cores(), move || start.elapsed());
        Self { config, store, slots, hosts: Hosts::default(), occupied, cores, leaving, closed }
    }

    /// What sessions, and what adjusts maps, work with.
    pub fn cores(&self) -> &Cores {
        &self.cores
    }

    /// Gives a client the session to write into, loading it if it is not in memory. Answers go to `replies`.
    ///
    /// # Errors
    /// If the session cannot be loaded, has a writer, or the server is closing.
    pub async fn open_stream(
        &self,
        request: OpenRequest,
        replies: Replies,
    ) -> Result<Arc<FrameQueue>, ApiError> {
        self.occupied.check(&request.id)?;
        self.check_taking()?;
        let held = self.slots.hold(&request.id).await;
        let capacity = match request.policy {
            Policy::Lossless => self.config.get().sessions.lossless_queue_frames,
            Policy::Realtime => self.config.get().sessions.realtime_queue_frames,
        };
        let queue = Arc::new(FrameQueue::new(request.policy, capacity));
        let mut stream = Stream {
            mode: request.mode,
            policy: request.policy,
            new_segment: request.new_segment,
            queue: queue.clone(),
            replies,
            ending_soon: CancellationToken::new(),
            served: CancellationToken::new(),
        };
        let writer = Writer {
            queue: queue.clone(),
            ending_soon: stream.ending_soon.clone(),
            served: stream.served.clone(),
        };
        loop {
            self.check_open()?;
            let loaded = self.load(&held, &request.id).await?;
            loaded.make_way(&request).await?;
            match loaded.streams.send(stream).await {
                Ok(()) => {
                    *lock(&loaded.writer) = Some(writer);
                    // A shutdown that came in between has not seen this writer.
                    if self.check_open().is_err() {
                        loaded.end();
                    }
                    return Ok(queue);
                }
                // The session was about to leave memory: load it anew.
                Err(mpsc::error::SendError(unsent)) => {
                    stream = unsent;
                    loaded.ended().await;
                }
            }
        }
    }

    /// How a session is doing, if it is in memory.
    pub fn view(&self, id: &SessionId) -> Option<LoadedView> {
        let loaded = self.slots.resident(id)?;
        let (live, counts) = (loaded.live.borrow().clone(), *loaded.counts.borrow());
        let view = LoadedView { live, counts, has_writer: loaded.is_busy() };
        Some(view)
    }

    /// Sessions in memory, and how many of them have a writer.
    pub fn n_loaded(&self) -> (usize, usize) {
        let loaded = self.slots.residents();
        (loaded.len(), loaded.iter().filter(|session| session.is_busy()).count())
    }

    /// How busy this server is, as others may know it.
    pub fn own_load(&self) -> store::Load {
        let (n_loaded, n_streams) = self.n_loaded();
        let is_leaving = self.is_leaving();
        // A session that nobody streams into makes way for another.
        let n_free = self.config.get().limits.max_loaded_sessions.saturating_sub(n_streams);
        let n_free = if is_leaving { 0 } else { n_free };
        let [n_loaded, n_streams, n_free] = [n_loaded, n_streams, n_free].map(|n| n as u64);
        store::Load { n_loaded, n_streams, n_free, is_leaving }
    }

    /// Whether this server hands its sessions over to others.
    pub fn is_leaving(&self) -> bool {
        self.leaving.is_cancelled()
    }

    /// Takes a session out of memory and runs `delete` while nobody can load it.
    ///
    /// # Errors
    /// If a writer is connected, or what `delete` says.
    pub async fn delete(
        &self,
        id: &SessionId,
        delete: impl Future<Output = Result<(), ApiError>>,
    ) -> Result<(), ApiError> {
        self.occupied.check(id)?;
        let held = self.slots.hold(id).await;
        unload(&held, id, "deleting the session").await?;
        delete.await?;
        self.slots.remove(id, held);
        Ok(())
    }

    /// Takes a session out of memory and runs `change` while nobody can load it, so that its next stream runs
    /// with what was changed.
    ///
    /// # Errors
    /// If a writer is connected, or what `change` says.
    pub async fn change<T>(
        &self,
        id: &SessionId,
        change: impl Future<Output = Result<T, ApiError>>,
    ) -> Result<T, ApiError> {
        self.occupied.check(id)?;
        let ids = self.all_on_map_of(id).await?;
        let held = self.unload_all(&ids, "changing its options").await?;
        let changed = change.await?;
        held.iter().for_each(|held| held.lasting().settings());
        Ok(changed)
    }

    /// Takes sessions out of memory and runs `work` on what is stored of them, for as long as it takes.
    /// Whoever wants one of them meanwhile is refused.
    ///
    /// # Errors
    /// If a writer is connected to one, another operation works on it, or what `work` says.
    pub async fn occupy<T, Working: Future<Output = Result<T, ApiError>>>(
        &self,
        ids: &BTreeSet<SessionId>,
        purpose: &str,
        work: impl FnOnce() -> Working,
    ) -> Result<T, ApiError> {
        self.check_open()?;
        let mut all = BTreeSet::new();
        for id in ids {
            all.extend(self.all_on_map_of(id).await?);
        }
        let ids = &all;
        let _occupied = self.occupied.mark(ids)?;
        let _held = self.unload_all(ids, purpose).await?;
        let mut taken = Ok(());
        for id in ids {
            taken = self.store.take(id.as_str()).await;
            if taken.is_err() {
                break;
            }
        }
        let outcome = match taken {
            Ok(()) => work().await,
            Err(error) => Err(error.into()),
        };
        for id in ids {
            self.store.give_back(id.as_str()).await;
        }
        outcome
    }

    /// Ends a session that this server could not keep, by its key: another may have it by now.
    pub fn lose(&self, key: &str) {
        let id = SessionId::stored(None, key.to_owned());
        let error = ApiError::from(StoreError::LeaseLost { id: key.to_owned() });
        // Whoever extends its map must not go on either.
        self.hosts.give_up(&id, &error);
        let Some(loaded) = self.slots.resident(&id) else { return };
        if !loaded.unload.is_cancelled() {
            tracing::error!(session.id = key, "session {key} is given up: its lease could not be renewed");
        }
        loaded.lose(error);
    }

    /// Where a session's events go.
    pub fn events_of(&self, id: &SessionId) -> Events {
        self.slots.lasting(id)
    }

    /// How new a session's map is; `None` if it was not in memory since the server began.
    pub fn revision(&self, id: &SessionId) -> Option<Revision> {
        Some(self.slots.known(id)?.journal().since(None).revision)
    }

    /// Runs `store`, which stores a new scale, and tells the session if it is in memory.
    ///
    /// # Errors
    /// What `store` says.
    pub async fn set_scale<T>(
        &self,
        id: &SessionId,
        metres_per_unit: Option<f64>,
        store: impl Future<Output = Result<T, ApiError>>,
    ) -> Result<T, ApiError> {
        self.occupied.check(id)?;
        // Whoever loads the session meanwhile would read the old scale.
        let held = self.slots.hold(id).await;
        let stored = store.await?;
        if let Some(loaded) = held.resident() {
            loaded.scale.send_replace(metres_per_unit);
        }
        held.lasting().settings();
        for other in self.store.cameras_of(id.as_str()).await? {
            let other = id.beside(&other);
            if let Some(loaded) = self.slots.resident(&other) {
                loaded.scale.send_replace(metres_per_unit);
            }
            self.slots.known(&other).iter().for_each(Events::settings);
        }
        Ok(stored)
    }

    /// What happens in a session from now on; ends when the session is deleted.
    pub fn events(&self, id: &SessionId) -> broadcast::Receiver<SessionEvent> {
        self.slots.lasting(id).watch()
    }

    /// What changed in a session's map since a revision. The session must be there: asking makes a place for
    /// it.
    pub fn since(&self, id: &SessionId, known: Option<Revision>) -> Since {
        self.slots.lasting(id).journal().since(known)
    }

    /// One of the last frames of a session that is watched.
    pub fn shown_frame(&self, id: &SessionId, sequence: u64) -> Option<Arc<ShownFrame>> {
        self.slots.known(id)?.gallery().frame(sequence)
    }

    /// Ends when the server shuts down.
    pub fn closed(&self) -> CancellationToken {
        self.closed.clone()
    }

    /// Takes no further sessions, and lets go of those in memory, one after the other, so that each is away
    /// for no longer than its own last frames take to be saved. Their streams end after the frames they have
    /// sent; opened again, they go on with another server.
    pub async fn hand_over(&self) {
        self.leaving.cancel();
        for resident in self.slots.residents() {
            resident.end();
            resident.ended().await;
        }
    }

    /// Cancelled when sessions begin to be handed over.
    pub fn leaving(&self) -> CancellationToken {
        self.leaving.clone()
    }

    /// Takes no new streams, ends the present ones, and waits until every session is saved and gone.
    pub async fn shut_down(&self) {
        self.closed.cancel();
        self.slots.shut_down().await;
    }

    /// Whether streams are taken.
    ///
    /// # Errors
    /// If the server is closing.
    pub fn check_open(&self) -> Result<(), ApiError> {
        self.slots.check_open().map_err(|slots::Closing| shutting_down())
    }

    /// Whether sessions are taken.
    ///
    /// # Errors
    /// If the server hands over those it has, or is closing.
    pub fn check_taking(&self) -> Result<(), ApiError> {
        self.check_open()?;
        if self.is_leaving() { Err(shutting_down()) } else { Ok(()) }
    }

    /// The session in memory.
    async fn load(&self, held: &Held, id: &SessionId) -> Result<Arc<Loaded>, ApiError> {
        if let Some(loaded) = held.resident() {
            return Ok(loaded);
        }
        let room = self.slots.make_room().await.map_err(|slots::Full| {
            let limit = self.config.get().limits.max_loaded_sessions;
            let sentence =
                format!("{limit} sessions are in use, as many as this server takes; try again later");
            ApiError::new(ErrorCode::TooManyLoadedSessions, sentence)
        })?;
        let loaded = Arc::new(self.start(id, held.lasting().clone(), room).await?);
        held.settle(loaded.clone());
        Ok(loaded)
    }

    /// The sessions whose cameras extend a session's map, and that one: all of them where it has a map of its
    /// own, it alone where it extends another's.
    async fn all_on_map_of(&self, id: &SessionId) -> Result<BTreeSet<SessionId>, ApiError> {
        let others = self.store.cameras_of(id.as_str()).await?;
        Ok(others.iter().map(|other| id.beside(other)).chain([id.clone()]).collect())
    }

    /// Takes sessions out of memory in the order of their ids, so that two who want the same do not wait for
    /// each other, and holds their places.
    async fn unload_all(&self, ids: &BTreeSet<SessionId>, purpose: &str) -> Result<Vec<Held>, ApiError> {
        let mut all_held = Vec::with_capacity(ids.len());
        for id in ids {
            let held = self.slots.hold(id).await;
            unload(&held, id, purpose).await?;
            all_held.push(held);
        }
        Ok(all_held)
    }
}

/// Waits until the session is out of memory; `purpose` says what for.
async fn unload(held: &Held, id: &SessionId, purpose: &str) -> Result<(), ApiError> {
    let Some(loaded) = held.resident() else { return Ok(()) };
    if loaded.is_busy() {
        let sentence = format!("a client streams into session {id}; end its stream before {purpose}");
        return Err(ApiError::new(ErrorCode::WriterConnected, sentence));
    }
    loaded.leave();
    loaded.ended().await;
    Ok(())
}

impl Resident for Loaded {
    fn is_busy(&self) -> bool {
        self.writer().is_some()
    }

    fn leave(&self) {
        self.unload.cancel();
    }

    /// The frames that are queued are served before.
    fn end(&self) {
        self.end_with(shutting_down());
    }

    fn is_dormant(&self) -> bool {
        self.writer().is_some_and(|writer| writer.queue.idle_for() > self.idle_stream)
    }

    fn give_way(&self) {
        let sentence = format!(
            "nothing came in this stream for {} s, and another session needed its place; open it again to go on",
            self.idle_stream.as_secs_f64()
        );
        self.end_with(ApiError::new(ErrorCode::IdleStream, sentence));
    }

    fn has_ended(&self) -> bool {
        self.ended.is_cancelled()
    }

    async fn ended(&self) {
        self.ended.cancelled().await;
    }
}

impl Loaded {
    fn end_with(&self, error: ApiError) {
        if let Some(writer) = self.writer() {
            writer.queue.close(Err(error));
            writer.ending_soon.cancel();
        }
        self.unload.cancel();
    }

    /// As [`Self::end_with`], without serving the frames that are queued.
    fn lose(&self, error: ApiError) {
        if let Some(writer) = self.writer() {
            writer.queue.abort(Err(error));
            writer.ending_soon.cancel();
        }
        self.unload.cancel();
    }

    /// The stream that is being served, if there is one.
    fn writer(&self) -> Option<Writer> {
        lock(&self.writer).clone().filter(|writer| !writer.served.is_cancelled())
    }

    /// Waits until nobody writes: for a stream that is about to end anyway, or, taking over, by ending it.
    async fn make_way(&self, request: &OpenRequest) -> Result<(), ApiError> {
        let Some(writer) = self.writer() else { return Ok(()) };
        if !writer.queue.is_closed() {
            let id = &request.id;
            if !request.take_over {
                let sentence =
                    format!("another client streams into session {id}; set take_over to end its stream");
                return Err(ApiError::new(ErrorCode::WriterConnected, sentence));
            }
            let sentence = format!("another client took over session {id}");
            writer.queue.abort(Err(ApiError::new(ErrorCode::TakenOver, sentence)));
        }
        if request.take_over {
            writer.ending_soon.cancel();
        }
        // Also ends when the session fails meanwhile.
        tokio::select! {
            () = writer.served.cancelled() => {}
            () = self.ended() => {}
        }
        Ok(())
    }
}

fn shutting_down() -> ApiError {
    let sentence = "the server is shutting down; reconnect and go on from next_sequence";
    ApiError::new(ErrorCode::ShuttingDown, sentence)
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
