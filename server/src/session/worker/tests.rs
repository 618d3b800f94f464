//! A session whose engine fails.

use super::*;
use crate::session::frame::{Encoding, SentFrame};
use crate::session::host::Watchers;
use crate::session::queue::Queued;
use crate::session::writer;
use geometry::{Camera, CameraModel, CameraParameters};
use slam::map::{CameraId, MapCamera, MapParts};
use slam::{Clock, JoinState, MapUpdate, SharedMap, SlamConfig};
use std::sync::atomic::{AtomicBool, Ordering};
use store::KeyframeImage;
use vision::decode::PixelFormat;

const WIDTH: u32 = 160;
const HEIGHT: u32 = 120;

/// A clock that panics once it is told to: the only part of the engine a test can make fail.
#[derive(Default)]
struct FragileClock(AtomicBool);

impl Clock for FragileClock {
    fn wall_ns(&self) -> u64 {
        assert!(!self.0.load(Ordering::SeqCst), "the clock fell down");
        0
    }
    fn thread_cpu_ns(&self) -> u64 {
        0
    }
}

struct NoDisk;

impl writer::Sink for NoDisk {
    async fn commit(&self, _: &MapUpdate, _: &[KeyframeImage]) -> Result<(), ApiError> {
        Ok(())
    }
}

fn frame(sequence: u64) -> Queued {
    let data = vec![128; (WIDTH * HEIGHT) as usize].into();
    let encoding = Encoding::Raw(PixelFormat::Gray8);
    let image = SentImage { encoding, width: WIDTH, height: HEIGHT, row_stride: 0, data };
    Queued::Frame(SentFrame {
        sequence,
        timestamp_ns: sequence as i64,
        image,
        arrived: Instant::now(),
        charge: None,
    })
}

fn camera() -> Camera {
    let (model, distortion) = (CameraModel::Pinhole, Vec::new());
    let (fx, fy, cx, cy) = (160.0, 160.0, 79.5, 59.5);
    Camera::new(CameraParameters { model, width: WIDTH, height: HEIGHT, fx, fy, cx, cy, distortion }).unwrap()
}

/// A session's thread, and what it is given streams through.
struct Session {
    streams: mpsc::Sender<Stream>,
    thread: std::thread::JoinHandle<()>,
    _folder: Arc<tempfile::TempDir>,
}

/// A map in memory, and the database that it is not saved in.
struct Map {
    host: Arc<MapHost>,
    store: store::Store,
    folder: Arc<tempfile::TempDir>,
}

impl Map {
    async fn new() -> Self {
        let map = SharedMap::resume(SlamConfig::default(), &camera(), MapParts::default()).unwrap();
        let (outbox, _saving) =
            writer::start(NoDisk, writer::Pace::of(&crate::config::SessionConfig::default(), false));
        let folder = tempfile::tempdir().unwrap();
        let options = store::StoreOptions::default();
        let store = store::Store::open(folder.path().join("maps"), options).await.unwrap();
        let new = store::NewSession {
            id: "s".to_owned(),
            camera: camera().parameters().clone(),
            options: store::SessionOptions::default(),
            created_at_ns: 0,
            mask: None,
            map: None,
        };
        let record = store.create_session(&new).await.unwrap();
        let host = Arc::new(MapHost::new(record, map, outbox, Watchers::default(), None));
        Self { host, store, folder: Arc::new(folder) }
    }
}

impl Session {
    async fn start(clock: Arc<FragileClock>) -> Self {
        Self::start_on(&Map::new().await, 0, clock)
    }

    /// A session of one of the map's cameras.
    fn start_on(map: &Map, number: u32, clock: Arc<FragileClock>) -> Self {
        let Map { host, store, folder } = map;
        let of_map = MapCamera { id: CameraId(number), is_refined: true };
        let config = (SlamConfig::default(), camera());
        let pipeline = Pipeline::join(host.map(), of_map, config, clock, JoinState::default()).unwrap();
        let id = SessionId::parse("s", "id").unwrap();
        let (streams, receiver) = mpsc::channel(1);
        let history = crate::session::load::LoadContext { store, id: &id }.history("s");
        let (host, camera) = (host.clone(), of_map.id);
        let persistence = Persistence { host, camera, history, last_frame: None, ahead_ns: 0 };
        let config = WorkerConfig {
            leaps: Leaps::of(&crate::config::SessionConfig::default()),
            decode_limits: DecodeLimits::default(),
            realtime_max_wait: Duration::from_millis(500),
            keep_images: true,
            idle_unload: Duration::from_secs(60),
        };
        let ends = Ends {
            streams: receiver,
            unload: CancellationToken::new(),
            live: watch::channel(Live::default()).0,
            scale: watch::channel(None).1,
            events: Events::default(),
        };
        let worker = Worker::new(id, config, pipeline, persistence, ends, Handle::current());
        let thread = std::thread::spawn(move || worker.run());
        Self { streams, thread, _folder: folder.clone() }
    }

    async fn ended(self) {
        let Self { streams, thread, _folder } = self;
        tokio::task::spawn_blocking(move || thread.join()).await.unwrap().expect("the panic was caught");
        assert!(streams.is_closed());
    }
}

/// A stream of these frames, and where its answers come.
fn stream(queue: &Arc<FrameQueue>) -> (Stream, mpsc::Receiver<Result<Reply, ApiError>>) {
    let (replies, answers) = mpsc::channel(16);
    let stream = Stream {
        mode: Mode::MapAndLocalize,
        policy: queue.policy(),
        new_segment: false,
        queue: queue.clone(),
        replies,
        ending_soon: CancellationToken::new(),
        served: CancellationToken::new(),
    };
    (stream, answers)
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_long_ago_give_way_to_newer_ones_in_real_time() {
    const N: u64 = 8;
    let session = Session::start(Arc::default()).await;
    let long_ago = Instant::now().checked_sub(Duration::from_secs(10)).expect("the machine runs longer");
    for policy in [Policy::Realtime, Policy::Lossless] {
        let queue = Arc::new(FrameQueue::new(policy, N as usize));
        let first = if policy == Policy::Realtime { 0 } else { N };
        for sequence in first..first + N {
            let Queued::Frame(new) = frame(sequence) else { unreachable!("a frame is made") };
            queue.push(Queued::Frame(SentFrame { arrived: long_ago, ..new })).await.unwrap();
        }
        queue.close(Ok(()));
        let (stream, mut answers) = stream(&queue);
        session.streams.send(stream).await.unwrap();
        let (mut dropped, mut answered) = (Vec::new(), Vec::new());
        while let Some(answer) = answers.recv().await {
            match answer.unwrap() {
                Reply::Dropped(sequence) => dropped.push(sequence),
                Reply::Answered(answer) => answered.push(answer.report.sequence),
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(answered.last(), Some(&(first + N - 1)), "the newest is answered");
        assert_eq!(dropped.len() + answered.len(), N as usize);
        assert_eq!(dropped.first(), (policy == Policy::Realtime).then_some(&0));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_ends_the_session_with_a_clear_error_and_lets_nobody_wait() {
    let clock = Arc::new(FragileClock::default());
    let session = Session::start(clock.clone()).await;
    let queue = Arc::new(FrameQueue::new(Policy::Lossless, 4));
    let (stream, mut answers) = stream(&queue);
    let served = stream.served.clone();
    session.streams.send(stream).await.unwrap();
    queue.push(frame(0)).await.unwrap();
    assert!(matches!(answers.recv().await, Some(Ok(Reply::Answered(_)))));
    clock.0.store(true, Ordering::SeqCst);
    queue.push(frame(1)).await.unwrap();
    let error = answers.recv().await.unwrap().unwrap_err();
    assert_eq!(error.code, ErrorCode::SessionFailed);
    assert!(answers.recv().await.is_none(), "the stream goes on after the session failed");
    assert!(served.is_cancelled() && queue.is_closed());
    session.ended().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_one_camera_ends_all_sessions_of_the_map_and_lets_nobody_wait() {
    let (map, clock) = (Map::new().await, Arc::new(FragileClock::default()));
    let (failing, other) =
        (Session::start_on(&map, 0, clock.clone()), Session::start_on(&map, 1, Arc::default()));
    let idle = Session::start_on(&map, 2, Arc::default());
    let queues = [0, 1].map(|_| Arc::new(FrameQueue::new(Policy::Lossless, 4)));
    let [(first, mut first_answers), (second, mut second_answers)] = queues.each_ref().map(stream);
    failing.streams.send(first).await.unwrap();
    other.streams.send(second).await.unwrap();
    for (queue, answers) in [(&queues[0], &mut first_answers), (&queues[1], &mut second_answers)] {
        queue.push(frame(0)).await.unwrap();
        assert!(matches!(answers.recv().await, Some(Ok(Reply::Answered(_)))));
    }
    clock.0.store(true, Ordering::SeqCst);
    queues[0].push(frame(1)).await.unwrap();
    // The other client sends nothing, and is told all the same.
    for answers in [&mut first_answers, &mut second_answers] {
        let error = answers.recv().await.unwrap().unwrap_err();
        assert_eq!(error.code, ErrorCode::SessionFailed);
    }
    assert!(map.host.is_over(), "nobody goes on with what is in memory");
    for session in [failing, other, idle] {
        session.ended().await;
    }
}
