//! A session whose engine fails.

use super::*;
use crate::config::SessionConfig;
use crate::session::frame::{Encoding, SentFrame};
use crate::session::queue::Queued;
use crate::session::writer;
use geometry::{Camera, CameraModel, CameraParameters};
use slam::{Clock, MapUpdate, SlamConfig};
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
    _folder: tempfile::TempDir,
}

impl Session {
    async fn start(clock: Arc<FragileClock>) -> Self {
        let pipeline = Pipeline::new(SlamConfig::default(), camera(), clock).unwrap();
        let (outbox, _saving) =
            writer::start(NoDisk, None, writer::Pace::of(&SessionConfig::default(), false));
        let folder = tempfile::tempdir().unwrap();
        let options = store::StoreOptions::default();
        let store = store::Store::open(folder.path().join("maps"), options).await.unwrap();
        let id = SessionId::parse("s", "id").unwrap();
        let (streams, receiver) = mpsc::channel(1);
        let history = crate::session::load::LoadContext { store: &store, id: &id }.history();
        let persistence = Persistence { outbox, history, last_frame: None, ahead_ns: 0 };
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
        Self { streams, thread, _folder: folder }
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
    let Session { streams, thread, _folder } = session;
    tokio::task::spawn_blocking(move || thread.join()).await.unwrap().expect("the panic was caught");
    assert!(streams.is_closed());
}
