//! A map in memory, for the sessions whose cameras extend it: mapping, the writer, the lease.
//!
//! Each of those sessions has a worker of its own, which tracks its camera; all of them hold the host. Who
//! leaves last ends it: what is left is saved and the lease given back, and only then may the map be loaded
//! anew.

use super::SessionId;
use super::events::Events;
use super::frame::SentImage;
use super::images::CandidateImages;
use super::queue::FrameQueue;
use super::writer::Outbox;
use crate::error::ApiError;
use slam::map::{CameraId, FrameState};
use slam::{MapUpdate, SharedMap};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use store::{SessionRecord, Store};
use tokio::runtime::Handle;
use tokio::sync::{Mutex as AsyncMutex, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// See the module's documentation.
pub struct MapHost {
    record: SessionRecord,
    map: SharedMap,
    outbox: Outbox,
    /// Held while updates are handed on, so that they stay in order whichever worker takes them.
    images: Mutex<CandidateImages>,
    watchers: Watchers,
    counts: watch::Sender<MapCounts>,
    /// What each camera is streamed through at present.
    streams: Mutex<BTreeMap<CameraId, Arc<FrameQueue>>>,
    /// Cancelled once the map in memory is not to be gone on with.
    over: CancellationToken,
    /// Cancelled once everything is saved and the lease is given back.
    ended: CancellationToken,
    ending: Option<Ending>,
}

/// How much there is in a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapCounts {
    /// Keyframes.
    pub n_keyframes: usize,
    /// Points.
    pub n_points: usize,
    /// Lines.
    pub n_lines: usize,
    /// Global primitives.
    pub n_primitives: usize,
}

/// What is left to do when the last session has left.
pub struct Ending {
    /// Ends when everything is saved.
    pub saving: JoinHandle<()>,
    /// Where the lease is from.
    pub store: Store,
    /// Where that is done.
    pub runtime: Handle,
}

/// Who watches sessions of a map: all are told what happens to it.
#[derive(Clone, Default)]
pub struct Watchers(Arc<Mutex<BTreeMap<String, Events>>>);

impl Watchers {
    /// Adds those of a session.
    pub fn add(&self, id: &str, events: Events) {
        lock(&self.0).insert(id.to_owned(), events);
    }

    /// The map was changed.
    pub fn map(&self, update: &MapUpdate) {
        lock(&self.0).values().for_each(|events| events.map(update));
    }

    /// An update is in the database.
    pub fn saved(&self, update: &MapUpdate) {
        lock(&self.0).values().for_each(|events| events.saved(update));
    }

    fn unloaded(&self) {
        lock(&self.0).values().for_each(Events::unloaded);
    }
}

impl MapHost {
    /// A map that was taken up, and where its updates go; `record` is the session's whose map it is.
    pub fn new(
        record: SessionRecord,
        map: SharedMap,
        outbox: Outbox,
        watchers: Watchers,
        ending: Option<Ending>,
    ) -> Self {
        Self {
            record,
            map,
            outbox,
            images: Mutex::default(),
            watchers,
            counts: watch::Sender::default(),
            streams: Mutex::default(),
            over: CancellationToken::new(),
            ended: CancellationToken::new(),
            ending,
        }
    }

    /// The session whose map it is, as it was when the map was taken up.
    pub fn record(&self) -> &SessionRecord {
        &self.record
    }

    /// The map.
    pub fn map(&self) -> &SharedMap {
        &self.map
    }

    /// Where updates go.
    pub fn outbox(&self) -> &Outbox {
        &self.outbox
    }

    /// Who is told what happens to the map.
    pub fn watchers(&self) -> &Watchers {
        &self.watchers
    }

    /// How much there is in the map, as of the last frame of any camera.
    pub fn counts(&self) -> watch::Receiver<MapCounts> {
        self.counts.subscribe()
    }

    /// Tells how much there is in the map now.
    pub fn publish(&self) {
        let map = self.map.map();
        self.counts.send_replace(MapCounts {
            n_keyframes: map.n_keyframes(),
            n_points: map.n_points(),
            n_lines: map.n_lines(),
            n_primitives: map.n_primitives(),
        });
    }

    /// Holds a frame's image if the frame is or may yet become a keyframe.
    pub fn offer_image(
        &self,
        frame: (CameraId, u64),
        image: SentImage,
        state: FrameState,
        is_keyframe: bool,
    ) {
        lock(&self.images).offer(frame, image, state, is_keyframe);
    }

    /// Hands on what `take` takes from the map, to be saved.
    pub fn hand_over(&self, take: impl FnOnce() -> Vec<MapUpdate>) {
        let mut images = lock(&self.images);
        for update in take() {
            self.watchers.map(&update);
            let images = images.take_for(&update);
            self.outbox.push(update, images);
        }
    }

    /// A camera is streamed through this queue from now on, or through none.
    pub fn stream_through(&self, camera: CameraId, queue: Option<Arc<FrameQueue>>) {
        let mut streams = lock(&self.streams);
        match queue {
            Some(queue) => streams.insert(camera, queue),
            None => streams.remove(&camera),
        };
    }

    /// Ends every stream into the map, which is not to be gone on with: what is stored holds.
    pub fn give_up(&self, error: &ApiError) {
        self.over.cancel();
        lock(&self.streams).values().for_each(|queue| queue.abort(Err(error.clone())));
        self.outbox.close();
    }

    /// Whether it was given up.
    pub fn is_over(&self) -> bool {
        self.over.is_cancelled()
    }

    /// Lets go of the host. Who was the last waits until it has ended; not on a thread of the runtime.
    pub fn leave(self: Arc<Self>, runtime: &Handle) {
        let ended = self.ended.clone();
        if let Some(host) = Arc::into_inner(self) {
            drop(host);
            runtime.block_on(ended.cancelled());
        }
    }
}

impl Drop for MapHost {
    fn drop(&mut self) {
        self.outbox.close();
        let (watchers, ended) = (self.watchers.clone(), self.ended.clone());
        let Some(Ending { saving, store, runtime }) = self.ending.take() else { return ended.cancel() };
        let key = self.record.id.clone();
        runtime.spawn(async move {
            if let Err(error) = saving.await {
                tracing::error!(error = %error, "a map's writer failed: {error}");
            }
            store.give_back(&key).await;
            watchers.unloaded();
            ended.cancel();
        });
    }
}

/// The maps in memory: each once at most.
#[derive(Default)]
pub struct Hosts(Mutex<BTreeMap<SessionId, Place>>);

type Place = Arc<AsyncMutex<Option<Present>>>;

/// A map that is or was in memory.
struct Present {
    host: Weak<MapHost>,
    ended: CancellationToken,
}

impl Hosts {
    /// The map of a session, in memory. `load` takes it up where it is not, and nobody else does meanwhile.
    ///
    /// # Errors
    /// What `load` says.
    pub async fn get<Loading: Future<Output = Result<MapHost, ApiError>>>(
        &self,
        id: &SessionId,
        load: impl FnOnce() -> Loading,
    ) -> Result<Arc<MapHost>, ApiError> {
        let place = self.place(id);
        let mut present = place.lock().await;
        if let Some(Present { host, ended }) = &*present {
            match host.upgrade() {
                Some(host) if !host.is_over() => return Ok(host),
                // Its workers see that it is over, and leave.
                over => drop(over),
            }
            ended.cancelled().await;
        }
        *present = None;
        let host = Arc::new(load().await?);
        *present = Some(Present { host: Arc::downgrade(&host), ended: host.ended.clone() });
        Ok(host)
    }

    /// [Gives up](MapHost::give_up) the map of a session, if it is in memory; whether it is.
    pub fn give_up(&self, id: &SessionId, error: &ApiError) -> bool {
        let place = lock(&self.0).get(id).cloned();
        // Who holds the place loads it: what it computes nobody is told who lost the lease.
        let Some(place) = place else { return false };
        let Ok(present) = place.try_lock() else { return false };
        let host = present.as_ref().and_then(|present| present.host.upgrade());
        host.is_some_and(|host| {
            host.give_up(error);
            // Where the last worker has left meanwhile, this is the one that ends it.
            drop(host);
            true
        })
    }

    fn place(&self, id: &SessionId) -> Place {
        let mut places = lock(&self.0);
        places.retain(|_, place| {
            let is_held = Arc::strong_count(place) > 1;
            let is_over = |present: &Option<Present>| {
                present.as_ref().is_none_or(|present| present.ended.is_cancelled())
            };
            is_held || place.try_lock().is_ok_and(|present| !is_over(&present))
        });
        places.entry(id.clone()).or_default().clone()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::super::writer::{self, Sink};
    use super::*;
    use crate::error::ErrorCode;
    use geometry::{Camera, CameraModel, CameraParameters};
    use slam::SlamConfig;
    use slam::map::MapParts;
    use std::time::Duration;
    use store::{KeyframeImage, NewSession, SessionOptions, StoreOptions};

    struct NoDisk;

    impl Sink for NoDisk {
        async fn commit(&self, _: &MapUpdate, _: &[KeyframeImage]) -> Result<(), ApiError> {
            Ok(())
        }
    }

    async fn store(folder: &std::path::Path) -> (Store, SessionRecord) {
        let store = Store::open(folder.join("maps.db"), StoreOptions::default()).await.unwrap();
        let (model, distortion) = (CameraModel::Pinhole, Vec::new());
        let (fx, fy, cx, cy) = (160.0, 160.0, 79.5, 59.5);
        let camera = CameraParameters { model, width: 160, height: 120, fx, fy, cx, cy, distortion };
        let (id, options) = ("s".to_owned(), SessionOptions::default());
        let new = NewSession { id, camera, options, created_at_ns: 0, mask: None, map: None };
        let record = store.create_session(&new).await.unwrap();
        (store, record)
    }

    fn host(store: &Store, record: &SessionRecord) -> MapHost {
        let camera = Camera::new(record.camera.clone()).unwrap();
        let map = SharedMap::resume(SlamConfig::default(), &camera, MapParts::default()).unwrap();
        let (outbox, saving) =
            writer::start(NoDisk, writer::Pace::of(&crate::config::SessionConfig::default(), false));
        let ending = Ending { saving, store: store.clone(), runtime: Handle::current() };
        MapHost::new(record.clone(), map, outbox, Watchers::default(), Some(ending))
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_map_is_loaded_once_and_anew_only_when_the_one_before_has_ended() {
        let folder = tempfile::tempdir().unwrap();
        let (store, record) = store(folder.path()).await;
        let (hosts, id) = (Hosts::default(), SessionId::parse("s", "id").unwrap());
        let first = hosts.get(&id, async || Ok(host(&store, &record))).await.unwrap();
        let again = hosts.get(&id, async || Err(ApiError::internal("it is there"))).await.unwrap();
        assert!(Arc::ptr_eq(&first, &again));

        // One that is over is not gone on with, and not loaded beside.
        let error = ApiError::new(ErrorCode::LeaseLost, "lost");
        assert!(hosts.give_up(&id, &error) && first.is_over());
        let ended = first.ended.clone();
        let next = hosts.get(&id, async || {
            assert!(ended.is_cancelled(), "two are in memory");
            Ok(host(&store, &record))
        });
        tokio::pin!(next);
        assert!(
            tokio::time::timeout(Duration::from_millis(50), &mut next).await.is_err(),
            "it does not wait"
        );
        drop(again);
        let runtime = Handle::current();
        tokio::task::spawn_blocking(move || first.leave(&runtime)).await.unwrap();
        let next =
            tokio::time::timeout(Duration::from_secs(5), next).await.expect("it waits for ever").unwrap();
        assert!(!next.is_over());
    }
}
