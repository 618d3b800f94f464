//! Where mapping runs: on the caller's thread, or on one of its own beside tracking.
//!
//! Either way requests are carried out in order, and tracking sees the result as immutable snapshots. Several
//! cameras may have the same map extended, each with a stage of its own.

mod cameras;

use super::{InitialMap, Mapper, NewKeyframe};
use crate::cores::{self, Share};
use crate::map::{CameraId, FrameRecord, KeyframeId, Map, MapUpdate, SubmapId};
use crate::report::{LineJudgement, MapEvent};
use crate::submaps::SubmapNumbers;
use cameras::{Cameras, OneCamera};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Keyframes that may wait for mapping. When it is full a lossless session waits, a real-time one makes no
/// keyframe.
const QUEUE_LENGTH: usize = 1;
/// Updates that may wait to be fetched; beyond it the newest two are joined.
const MAX_WAITING_UPDATES: usize = 16;
/// Judgements of lines that may wait to be fetched; beyond it the oldest go: they are for statistics only.
const MAX_WAITING_JUDGEMENTS: usize = 4096;
/// Mapping that has nothing to do answers at once: who waits longer lets others work meanwhile.
const AT_ONCE: Duration = Duration::from_millis(1);

/// Mapping as one camera's pipeline sees it.
pub(crate) struct MappingStage {
    camera: Arc<OneCamera>,
    core: MappingCore,
}

/// Mapping of one map, whichever cameras it is for. Clones are of the same map.
#[derive(Clone)]
pub(crate) struct MappingCore {
    runner: Arc<Runner>,
    shared: Shared,
}

enum Runner {
    Inline(Mutex<Box<Mapper>>),
    Background(Background),
}

/// What mapping hands to tracking, and what cameras share besides.
#[derive(Clone)]
struct Shared {
    newest: Arc<Mutex<Arc<Map>>>,
    updates: Arc<Mutex<Vec<MapUpdate>>>,
    line_judgements: Arc<Mutex<VecDeque<LineJudgement>>>,
    cameras: Arc<Cameras>,
    n_keyframe_ids: Arc<AtomicU64>,
    submaps: Arc<SubmapNumbers>,
}

/// The mapping thread's other end.
struct Background {
    requests: Option<SyncSender<Request>>,
    n_pending: Arc<AtomicUsize>,
    abort: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

enum Request {
    Begin(Box<InitialMap>),
    AddKeyframe(Box<NewKeyframe>),
    Discard(SubmapId),
    Record(Vec<FrameRecord>),
    /// Waits for global bundle adjustment.
    Settle,
    /// Goes on with this mapper, unless there is a map already; answered with whether it does.
    Replace(Box<Mapper>, SyncSender<bool>),
    /// Answered when everything before it is done.
    Barrier(SyncSender<()>),
}

impl MappingCore {
    pub fn inline(mapper: Mapper) -> Self {
        let shared = Shared::new(mapper.map());
        Self { runner: Arc::new(Runner::Inline(Mutex::new(Box::new(mapper)))), shared }
    }

    pub fn background(mapper: Mapper) -> std::io::Result<Self> {
        let shared = Shared::new(mapper.map());
        // Full: the sender waits (see `QUEUE_LENGTH`).
        let (requests, incoming) = sync_channel(QUEUE_LENGTH);
        let (n_pending, abort) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
        let worker =
            Worker { mapper, n_pending: n_pending.clone(), abort: abort.clone(), shared: shared.clone() };
        let share = Share::of_this_thread();
        let thread = std::thread::Builder::new().name("slam-mapping".into()).spawn(move || {
            let _joined = share.map(Share::enter);
            worker.run(incoming);
        })?;
        let background = Background { requests: Some(requests), n_pending, abort, thread: Some(thread) };
        Ok(Self { runner: Arc::new(Runner::Background(background)), shared })
    }

    /// Mapping as this camera sees it.
    pub fn stage_of(&self, camera: CameraId) -> MappingStage {
        MappingStage { camera: self.shared.cameras.add(camera), core: self.clone() }
    }

    /// The newest consistent map.
    pub fn newest_map(&self) -> Arc<Map> {
        lock(&self.shared.newest).clone()
    }

    /// Numbers of submaps.
    pub fn submap_numbers(&self) -> &SubmapNumbers {
        &self.shared.submaps
    }

    fn request(&self, request: Request) {
        match &*self.runner {
            Runner::Inline(mapper) => {
                // What a panic left half done must not be gone on with.
                let mut mapper = mapper.lock().expect("mapping has ended by a panic");
                self.shared.carry_out(&mut mapper, request, &AtomicBool::new(false));
            }
            Runner::Background(background) => background.send(request),
        }
    }
}

impl MappingStage {
    /// Mapping of the map, whichever cameras it is for.
    pub fn core(&self) -> &MappingCore {
        &self.core
    }

    /// The newest consistent map.
    pub fn newest_map(&self) -> Arc<Map> {
        self.core.newest_map()
    }

    /// The number of the next keyframe.
    pub fn next_keyframe_id(&self) -> KeyframeId {
        let before = self.core.shared.n_keyframe_ids.fetch_add(1, Ordering::Relaxed);
        KeyframeId::from_index(before as usize)
    }

    /// What there is to store, oldest first, whichever cameras it came from.
    pub fn take_updates(&self) -> Vec<MapUpdate> {
        std::mem::take(&mut *lock(&self.core.shared.updates))
    }

    /// Corrections of the map since this camera's last call, oldest first.
    pub fn take_events(&self) -> Vec<MapEvent> {
        self.camera.take_events()
    }

    /// Judgements of candidate lines since the last call, oldest first.
    pub fn take_line_judgements(&self) -> Vec<LineJudgement> {
        std::mem::take(&mut *lock(&self.core.shared.line_judgements)).into()
    }

    /// Whether a keyframe would be taken in at once.
    pub fn is_idle(&self) -> bool {
        match &*self.core.runner {
            Runner::Inline(_) => true,
            Runner::Background(background) => background.n_pending.load(Ordering::Acquire) == 0,
        }
    }

    /// Notes that the camera has frames processed, until it [settles](Self::settle).
    pub fn begin_frame(&self) {
        self.camera.set_active(true);
    }

    /// Notes that the camera is followed in a submap.
    pub fn visit(&self, submap: SubmapId) {
        self.core.shared.cameras.visit(submap, self.camera.id);
    }

    /// Whether another camera has been in a submap: then it is not this one's to discard.
    pub fn is_shared(&self, submap: SubmapId) -> bool {
        let is_anothers = |other: CameraId| other != self.camera.id;
        let map = self.newest_map();
        let mut keyframes = map.keyframes_of(submap);
        self.core.shared.cameras.were_in(submap).into_iter().any(is_anothers)
            || keyframes.any(|keyframe| is_anothers(keyframe.camera.id))
    }

    /// Begins a map and waits until it is there.
    pub fn begin(&mut self, initial: InitialMap) {
        self.core.request(Request::Begin(Box::new(initial)));
        self.wait();
    }

    /// Takes in a keyframe. In the background, waits only while the queue is full. `hurry` cuts short the
    /// optimization that is under way.
    pub fn add_keyframe(&mut self, new: NewKeyframe, hurry: bool) {
        if let Runner::Background(background) = &*self.core.runner {
            background.abort.fetch_or(hurry, Ordering::Relaxed);
        }
        self.core.request(Request::AddKeyframe(Box::new(new)));
    }

    /// Removes a submap and waits until it is gone.
    pub fn discard(&mut self, submap: SubmapId) {
        self.core.request(Request::Discard(submap));
        self.wait();
    }

    /// Adds frames to the trajectory, after everything requested so far.
    pub fn record(&mut self, frames: Vec<FrameRecord>) {
        self.core.request(Request::Record(frames));
    }

    /// The camera pauses: waits until everything requested so far is done, and, if no other camera goes on,
    /// all that follows from it.
    pub fn settle(&mut self) {
        self.camera.set_active(false);
        if !self.core.shared.cameras.is_any_active() {
            self.core.request(Request::Settle);
        }
        self.wait();
    }

    /// Goes on with another mapper, which has no map, unless there is a map already. Returns whether it does.
    pub fn replace(&mut self, mapper: Mapper) -> bool {
        let (answer, replaced) = sync_channel(1);
        self.core.request(Request::Replace(Box::new(mapper), answer));
        cores::wait(|| replaced.recv()).unwrap_or(false)
    }

    /// Waits until everything requested so far is done.
    pub fn wait(&mut self) {
        if let Runner::Background(background) = &*self.core.runner {
            let (done, wait) = sync_channel(1);
            background.send(Request::Barrier(done));
            if let Err(RecvTimeoutError::Timeout) = wait.recv_timeout(AT_ONCE) {
                let _ = cores::wait(|| wait.recv());
            }
        }
    }
}

impl Background {
    fn send(&self, request: Request) {
        self.n_pending.fetch_add(1, Ordering::AcqRel);
        let sent = self.requests.as_ref().is_some_and(|requests| match requests.try_send(request) {
            Err(TrySendError::Full(request)) => cores::wait(|| requests.send(request).is_ok()),
            sent => sent.is_ok(),
        });
        // The thread ends early only by a panic of its own, which is a defect: it must not pass unnoticed.
        assert!(sent, "the mapping thread has ended by a panic");
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // A closed channel is the stop signal.
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Worker {
    mapper: Mapper,
    n_pending: Arc<AtomicUsize>,
    abort: Arc<AtomicBool>,
    shared: Shared,
}

impl Worker {
    fn run(mut self, incoming: Receiver<Request>) {
        for request in incoming {
            self.abort.store(false, Ordering::Relaxed);
            let Self { mapper, abort, shared, .. } = &mut self;
            match request {
                // Nothing to work on, and somebody waits.
                Request::Barrier(_) => shared.carry_out(mapper, request, abort),
                request => cores::with_turn(|| shared.carry_out(mapper, request, abort)),
            }
            self.n_pending.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

impl Shared {
    fn new(map: &Map) -> Self {
        Self {
            newest: Arc::new(Mutex::new(Arc::new(map.clone()))),
            updates: Arc::default(),
            line_judgements: Arc::default(),
            cameras: Arc::default(),
            n_keyframe_ids: Arc::new(AtomicU64::new(map.last_ids().keyframe)),
            submaps: Arc::new(SubmapNumbers::after(map)),
        }
    }

    fn carry_out(&self, mapper: &mut Mapper, request: Request, abort: &AtomicBool) {
        let update = match request {
            Request::Begin(initial) => mapper.begin(*initial),
            Request::AddKeyframe(new) => mapper.add_keyframe(*new, &mut |map| self.publish(map), abort),
            Request::Discard(submap) => mapper.discard(submap),
            Request::Record(frames) => mapper.record(frames),
            Request::Settle => mapper.settle(),
            Request::Replace(another, answer) => {
                let is_empty = mapper.map().n_keyframes() == 0;
                if is_empty {
                    *mapper = *another;
                }
                let _ = answer.send(is_empty);
                return;
            }
            Request::Barrier(done) => {
                // Whoever waits for mapping would see the camera change at one frame or the next, as chance
                // has it.
                if mapper.settle_intrinsics() {
                    let update = mapper.record(Vec::new());
                    self.hand_out(mapper, update);
                }
                let _ = done.send(());
                return;
            }
        };
        self.hand_out(mapper, update);
    }

    fn hand_out(&self, mapper: &mut Mapper, update: MapUpdate) {
        self.cameras.tell(&mapper.take_events());
        let mut judgements = lock(&self.line_judgements);
        judgements.extend(mapper.take_line_judgements());
        let n_surplus = judgements.len().saturating_sub(MAX_WAITING_JUDGEMENTS);
        judgements.drain(..n_surplus);
        drop(judgements);
        *lock(&self.newest) = update.map.clone();
        let mut updates = lock(&self.updates);
        let is_full = updates.len() >= MAX_WAITING_UPDATES;
        match updates.last_mut().filter(|_| is_full) {
            Some(last) => last.merge(update),
            None => updates.push(update),
        }
    }

    fn publish(&self, map: &Map) {
        *lock(&self.newest) = Arc::new(map.clone());
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every critical section is a single assignment, so a poisoned value is still whole.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
