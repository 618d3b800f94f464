//! The thread that owns a session. Nothing else touches its pipeline.
//!
//! It serves one stream at a time: a decoding thread beside it takes frames from the stream's queue, this
//! thread tracks them, answers go back through a bounded channel, and map updates go to the session's writer.
//! At the end of a stream everything is flushed before the client sees the end.

use super::SessionId;
use super::decoder::{self, Decoded};
use super::events::Events;
use super::frame::{Answer, Before, FrameOutcome, Rejection, Reply, SentImage};
use super::gallery::ShownFrame;
use super::images::CandidateImages;
use super::leaps::{self, Leaps};
use super::load::History;
use super::queue::{Ending, FrameQueue, Policy};
use super::recent::RecentAnswers;
use super::view::Live;
use super::writer::Outbox;
use crate::error::{ApiError, ErrorCode};
use slam::map::FrameState;
use slam::{FrameReport, Pipeline, SceneMask, TrackingOutcome};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use vision::decode::{DecodeLimits, SampleDepth};

/// Decoded frames that wait for tracking: one, so that decoding overlaps tracking. The decoder waits when it
/// is full.
const DECODED_AHEAD: usize = 1;
/// How long an answer may wait for a client once its stream is to end.
const LAST_ANSWERS_PATIENCE: Duration = Duration::from_secs(1);

/// Whether a stream may change the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Frames extend the map.
    MapAndLocalize,
    /// Frames are only located in it.
    LocalizeOnly,
}

/// Messages to the client of a stream; the last may be the error that ended it.
pub type Replies = mpsc::Sender<Result<Reply, ApiError>>;

/// A stream to be served.
#[derive(Debug)]
pub struct Stream {
    /// Whether it may change the map.
    pub mode: Mode,
    /// What happens when frames come faster than they are tracked.
    pub policy: Policy,
    /// The first new frame begins a new segment.
    pub new_segment: bool,
    /// Its frames.
    pub queue: Arc<FrameQueue>,
    /// Where the answers go. When it is full the session waits for the client.
    pub replies: Replies,
    /// Cancelled when the stream is to end soon, so that a client that does not read cannot hold it up.
    pub ending_soon: CancellationToken,
    /// Cancelled by the worker when the stream has been served.
    pub served: CancellationToken,
}

/// The worker's ends of what ties it to the registry.
pub struct Ends {
    /// Streams to serve, one after the other.
    pub streams: mpsc::Receiver<Stream>,
    /// Cancelled when the session is to end once its stream has.
    pub unload: CancellationToken,
    /// The registry's view of the session.
    pub live: watch::Sender<Live>,
    /// Metres per map unit; `None` while the scale is free.
    pub scale: watch::Receiver<Option<f64>>,
    /// Who watches the session.
    pub events: Events,
}

/// What ties a worker to the database.
pub struct Persistence {
    /// Where updates go.
    pub outbox: Outbox,
    /// What is stored of earlier frames.
    pub history: History,
    /// Number and time of the last stored frame.
    pub last_frame: Option<(u64, i64)>,
    /// By how much the engine's times are ahead of the client's, nanoseconds.
    pub ahead_ns: i64,
}

/// What a worker runs with.
#[derive(Clone, Copy, Debug)]
pub struct WorkerConfig {
    /// How far frames may leap.
    pub leaps: Leaps,
    /// What images are accepted.
    pub decode_limits: DecodeLimits,
    /// Keep the images of keyframes.
    pub keep_images: bool,
    /// Time without a stream after which the session ends.
    pub idle_unload: Duration,
}

/// Owns a session.
pub struct Worker {
    id: SessionId,
    config: WorkerConfig,
    pipeline: Pipeline,
    outbox: Outbox,
    history: History,
    ends: Ends,
    /// Number and time of the last frame, stored or not.
    last_frame: Option<(u64, i64)>,
    /// By how much the engine's times are ahead of the client's, nanoseconds.
    ahead_ns: i64,
    /// The next new frame begins a segment.
    begins_segment: bool,
    recent: RecentAnswers,
    images: CandidateImages,
    /// What is known of samples of 16 bits.
    depth: SampleDepth,
    /// Frames tracked since the session was loaded.
    n_frames: u64,
    /// What of the images is left out, as it was saved last.
    saved_mask: Option<SceneMask>,
    /// That is being saved.
    mask_saving: Option<JoinHandle<()>>,
    runtime: Handle,
}

/// The client of the stream does not listen any more.
struct ClientGone;

impl Worker {
    /// The worker of a session, with a runtime at hand.
    pub fn new(
        id: SessionId,
        config: WorkerConfig,
        pipeline: Pipeline,
        persistence: Persistence,
        ends: Ends,
        runtime: Handle,
    ) -> Self {
        let Persistence { outbox, history, last_frame, ahead_ns } = persistence;
        let (recent, images) = (RecentAnswers::default(), CandidateImages::default());
        let (depth, n_frames) = (SampleDepth::default(), 0);
        let saved_mask = pipeline.mask().cloned();
        Self {
            id,
            config,
            pipeline,
            outbox,
            history,
            ends,
            last_frame,
            ahead_ns,
            begins_segment: false,
            recent,
            images,
            depth,
            n_frames,
            saved_mask,
            mask_saving: None,
            runtime,
        }
    }

    /// Runs the session until it is idle, told to end, or fails. Call on a thread of its own.
    pub fn run(mut self) {
        let id = self.id.clone();
        self.publish(None);
        while let Some(stream) = self.next_stream() {
            let (served, replies, queue) =
                (stream.served.clone(), stream.replies.clone(), stream.queue.clone());
            let outcome = catch_unwind(AssertUnwindSafe(|| self.serve(stream)));
            served.cancel();
            if let Err(panic) = outcome {
                self.fail(panic_message(&*panic), &queue, &replies);
                return;
            }
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| self.flush()));
        if !matches!(outcome, Ok(Ok(()))) {
            tracing::error!(session.id = id.as_str(), "session {id} ends without its last frames saved");
        }
        self.outbox.close();
        tracing::info!(session.id = id.as_str(), "session {id} left memory");
    }

    /// Ends a session whose engine has panicked while it served a stream.
    fn fail(mut self, cause: &str, queue: &FrameQueue, replies: &Replies) {
        let id = &self.id;
        tracing::error!(session.id = id.as_str(), cause, "session {id} failed and is closed: {cause}");
        let sentence = "the session failed and was closed; open it again to go on from its last saved frame";
        let error = ApiError::new(ErrorCode::SessionFailed, sentence);
        queue.abort(Err(error.clone()));
        let _ = replies.try_send(Err(error.clone()));
        metrics::counter!("monoslam_session_failures_total").increment(1);
        // Whoever was let in meanwhile must not wait for an answer that never comes.
        self.ends.streams.close();
        while let Ok(next) = self.ends.streams.try_recv() {
            let _ = next.replies.try_send(Err(error.clone()));
            next.queue.abort(Err(error.clone()));
        }
        // What the engine holds cannot be trusted any more, and is not saved.
        self.outbox.close();
    }

    /// Waits for a stream. `None` once the session is to end: then the channel is closed, and what came just
    /// before that is still served.
    fn next_stream(&mut self) -> Option<Stream> {
        let Ends { streams, unload, .. } = &mut self.ends;
        self.runtime.block_on(async {
            loop {
                tokio::select! {
                    biased;
                    stream = streams.recv() => return stream,
                    () = unload.cancelled() => break,
                    // Nothing can be saved any more: whoever comes next begins with the last commit.
                    () = self.outbox.ended() => break,
                    // A session that cannot be saved stays: its frames are in no other place.
                    () = tokio::time::sleep(self.config.idle_unload) => if self.outbox.is_idle() { break },
                }
            }
            streams.close();
            streams.recv().await
        })
    }

    /// Serves one stream to its end.
    fn serve(&mut self, stream: Stream) {
        self.pipeline.set_mapping(stream.mode == Mode::MapAndLocalize);
        self.pipeline.set_lossless(stream.policy == Policy::Lossless);
        self.begins_segment = stream.new_segment;
        self.track_all(&stream);
        let saved = self.flush();
        let ending: Ending = match stream.queue.ending() {
            Some(Err(error)) => Err(error),
            Some(Ok(())) | None => saved,
        };
        stream.served.cancel();
        if let Err(error) = ending {
            let _ = self.send(&stream, Err(error));
        }
    }

    fn track_all(&mut self, stream: &Stream) {
        let (sender, decoded) = sync_channel(DECODED_AHEAD);
        let limits = self.config.decode_limits;
        let mut depth = self.depth;
        let seen = &mut depth;
        std::thread::scope(|scope| {
            // Dropped before the scope joins the decoder, also in a panic, so that the decoder ends.
            let decoded = decoded;
            let _end_decoder = AbortOnDrop(&stream.queue);
            let decoder = std::thread::Builder::new().name("decode".into());
            let queue = &*stream.queue;
            if let Err(error) =
                decoder.spawn_scoped(scope, move || decoder::run(queue, &limits, seen, &sender))
            {
                queue.abort(Err(ApiError::internal(error)));
                return;
            }
            for item in decoded {
                if let Some(failure) = self.outbox.failure() {
                    stream.queue.abort(Err(failure));
                    break;
                }
                if self.handle(stream, item).is_err() {
                    break;
                }
            }
        });
        self.depth = depth;
    }

    fn handle(&mut self, stream: &Stream, item: Decoded) -> Result<(), ClientGone> {
        let reply = match item {
            Decoded::Frame { frame, brightest, sent, arrived } => self.track(frame, brightest, sent, arrived),
            Decoded::Dropped(sequence) => {
                metrics::counter!("monoslam_frames_total", "outcome" => "dropped").increment(1);
                Reply::Dropped(sequence)
            }
            Decoded::Rejected(rejection) => rejected(rejection),
        };
        self.send(stream, Ok(reply))
    }

    fn track(&mut self, frame: slam::Frame, brightest: u8, sent: SentImage, arrived: Instant) -> Reply {
        let (sequence, timestamp_ns) = (frame.sequence, frame.timestamp_ns);
        if self.last_frame.is_some_and(|(last, _)| sequence <= last) {
            return self.repeat(sequence, timestamp_ns);
        }
        let queued_ns = arrived.elapsed().as_nanos() as u64;
        let engine_ns = match self.engine_time(sequence, timestamp_ns) {
            Ok(engine_ns) => engine_ns,
            Err(rejection) => return rejected(rejection),
        };
        let report = match self.pipeline.process_frame(slam::Frame { timestamp_ns: engine_ns, ..frame }) {
            Ok(report) => FrameOutcome { report: FrameReport { timestamp_ns, ..report }, brightest },
            Err(error) => return rejected(decoder::rejection_of(&error, sequence)),
        };
        self.last_frame = Some((sequence, timestamp_ns));
        self.n_frames += 1;
        let state = report.outcome.state();
        if self.config.keep_images {
            self.images.offer(sequence, sent.clone(), state, report.is_keyframe);
        }
        self.hand_over_updates(Pipeline::take_updates);
        self.save_mask();
        self.publish(Some(state));
        let metres_per_unit = *self.ends.scale.borrow();
        // Where images are not to be kept, they are not shown either.
        let keep_images = self.config.keep_images;
        let shown = || {
            let observed = self.pipeline.observed().filter(|_| keep_images)?;
            Some(ShownFrame { image: sent, observed })
        };
        self.ends.events.frame(&report, metres_per_unit, shown);
        record_frame(&report, queued_ns);
        self.recent.remember(report.clone());
        let durable_sequence = self.outbox.durable_sequence();
        Reply::Answered(Box::new(Answer { report, durable_sequence, queued_ns, metres_per_unit }))
    }

    /// The engine's time of a new frame, which only goes on; begins a segment where one is to begin.
    fn engine_time(&mut self, sequence: u64, timestamp_ns: i64) -> Result<i64, Rejection> {
        let leaps = self.config.leaps;
        leaps.check_sequence(self.last_frame, sequence)?;
        let Some(last_frame) = self.last_frame.filter(|_| self.begins_segment) else {
            leaps.check_time(self.last_frame, sequence, timestamp_ns)?;
            return leaps::engine_time(sequence, timestamp_ns, self.ahead_ns);
        };
        let ahead_ns = leaps::ahead_of_segment(last_frame, self.ahead_ns, sequence, timestamp_ns)?;
        let begun = self.runtime.block_on(self.history.begin_segment(sequence, ahead_ns));
        begun.map_err(|error| leaps::not_begun(sequence, &error))?;
        let id = &self.id;
        tracing::info!(
            session.id = id.as_str(),
            sequence,
            "session {id}: frame {sequence} begins a new segment"
        );
        (self.ahead_ns, self.begins_segment) = (ahead_ns, false);
        leaps::engine_time(sequence, timestamp_ns, ahead_ns)
    }

    /// The answer to a frame that was answered before.
    fn repeat(&self, sequence: u64, timestamp_ns: i64) -> Reply {
        let before = match self.recent.get(sequence) {
            Some(report) => Some(Before::Recent(Box::new(report.clone()))),
            None => self.runtime.block_on(self.history.frame(sequence)).map(Before::Stored),
        };
        let (durable_sequence, metres_per_unit) = (self.outbox.durable_sequence(), *self.ends.scale.borrow());
        Reply::Repeated { sequence, timestamp_ns, before, durable_sequence, metres_per_unit }
    }

    /// Saves what was found not to be the scene, beside everything else, one state at a time: should it be
    /// lost, it is found again.
    fn save_mask(&mut self) {
        let is_busy = self.mask_saving.as_ref().is_some_and(|saving| !saving.is_finished());
        if is_busy || self.pipeline.mask() == self.saved_mask.as_ref() {
            return;
        }
        self.saved_mask = self.pipeline.mask().cloned();
        let (history, mask) = (self.history.clone(), self.saved_mask.clone());
        self.mask_saving = Some(self.runtime.spawn(async move { history.save_mask(mask).await }));
    }

    /// Finishes what mapping has begun and waits until everything is saved.
    fn flush(&mut self) -> Result<(), ApiError> {
        self.hand_over_updates(Pipeline::finish);
        for _ in 0..2 {
            if let Some(saving) = self.mask_saving.take() {
                let _ = self.runtime.block_on(saving);
            }
            self.save_mask();
        }
        let state = self.ends.live.borrow().state;
        self.publish(state);
        self.runtime.block_on(self.outbox.flush())
    }

    fn hand_over_updates(&mut self, take: impl FnOnce(&mut Pipeline) -> Vec<slam::MapUpdate>) {
        for update in take(&mut self.pipeline) {
            self.ends.events.map(&update);
            let images = self.images.take_for(&update);
            self.outbox.push(update, images);
        }
        for judgement in self.pipeline.take_line_judgements() {
            let verdict = judgement.verdict.name();
            metrics::counter!("monoslam_line_candidates_total", "verdict" => verdict).increment(1);
        }
    }

    fn publish(&self, state: Option<FrameState>) {
        let map = self.pipeline.map();
        let live = Live {
            state,
            last_frame: self.last_frame,
            n_frames: self.n_frames,
            n_keyframes: map.n_keyframes(),
            n_points: map.n_points(),
            n_lines: map.n_lines(),
            n_primitives: map.n_primitives(),
            mask: self.pipeline.mask().map(|known| known.into()),
        };
        self.ends.live.send_replace(live);
    }

    /// Sends to the client, waiting for it to read; once the stream is to end, only a little longer.
    fn send(&self, stream: &Stream, message: Result<Reply, ApiError>) -> Result<(), ClientGone> {
        let message = match stream.replies.try_send(message) {
            Ok(()) => return Ok(()),
            Err(mpsc::error::TrySendError::Closed(_)) => return Err(ClientGone),
            Err(mpsc::error::TrySendError::Full(message)) => message,
        };
        self.runtime.block_on(async {
            let patience = async {
                stream.ending_soon.cancelled().await;
                tokio::time::sleep(LAST_ANSWERS_PATIENCE).await;
            };
            tokio::select! {
                sent = stream.replies.send(message) => sent.map_err(|_closed| ClientGone),
                () = patience => Err(ClientGone),
            }
        })
    }
}

/// Ends the queue when serving it ends, however that comes.
struct AbortOnDrop<'a>(&'a FrameQueue);

impl Drop for AbortOnDrop<'_> {
    fn drop(&mut self) {
        self.0.abort(Ok(()));
    }
}

fn rejected(rejection: Rejection) -> Reply {
    metrics::counter!("monoslam_frames_total", "outcome" => "rejected").increment(1);
    Reply::Rejected(rejection)
}

fn record_frame(report: &FrameReport, queued_ns: u64) {
    let outcome = match report.outcome {
        TrackingOutcome::Initialising(_) => "initialising",
        TrackingOutcome::Tracked => "tracked",
        TrackingOutcome::Weak { .. } | TrackingOutcome::CalibrationContradicted => "weak",
        TrackingOutcome::Lost(_) => "lost",
    };
    let seconds = |nanoseconds: u64| nanoseconds as f64 * 1e-9;
    metrics::counter!("monoslam_frames_total", "outcome" => outcome).increment(1);
    metrics::histogram!("monoslam_frame_seconds").record(seconds(report.wall_ns));
    metrics::histogram!("monoslam_frame_cpu_seconds").record(seconds(report.cpu_ns));
    metrics::histogram!("monoslam_frame_queued_seconds").record(seconds(queued_ns));
    for stage in &report.stages {
        metrics::histogram!("monoslam_stage_seconds", "stage" => stage.name).record(seconds(stage.wall_ns));
    }
}

fn panic_message(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("a panic without a message")
}

#[cfg(test)]
mod tests {
    use super::*;
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
        Camera::new(CameraParameters { model, width: WIDTH, height: HEIGHT, fx, fy, cx, cy, distortion })
            .unwrap()
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_panic_ends_the_session_with_a_clear_error_and_lets_nobody_wait() {
        let clock = Arc::new(FragileClock::default());
        let pipeline = Pipeline::new(SlamConfig::default(), camera(), clock.clone()).unwrap();
        let (outbox, _saving) = writer::start(NoDisk, None, false, Duration::from_secs(1));
        let folder = tempfile::tempdir().unwrap();
        let store =
            store::Store::open(folder.path().join("maps"), store::StoreOptions::default()).await.unwrap();
        let id = SessionId::parse("s", "id").unwrap();
        let (streams, receiver) = mpsc::channel(1);
        let history = crate::session::load::LoadContext { store: &store, id: &id }.history();
        let persistence = Persistence { outbox, history, last_frame: None, ahead_ns: 0 };
        let config = WorkerConfig {
            leaps: Leaps::of(&crate::config::SessionConfig::default()),
            decode_limits: DecodeLimits::default(),
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
        let worker = std::thread::spawn(move || worker.run());

        let queue = Arc::new(FrameQueue::new(Policy::Lossless, 4));
        let (replies, mut answers) = mpsc::channel(4);
        let served = CancellationToken::new();
        let stream = Stream {
            mode: Mode::MapAndLocalize,
            policy: Policy::Lossless,
            new_segment: false,
            queue: queue.clone(),
            replies,
            ending_soon: CancellationToken::new(),
            served: served.clone(),
        };
        streams.send(stream).await.unwrap();
        queue.push(frame(0)).await.unwrap();
        assert!(matches!(answers.recv().await, Some(Ok(Reply::Answered(_)))));
        clock.0.store(true, Ordering::SeqCst);
        queue.push(frame(1)).await.unwrap();
        let error = answers.recv().await.unwrap().unwrap_err();
        assert_eq!(error.code, ErrorCode::SessionFailed);
        assert!(answers.recv().await.is_none(), "the stream goes on after the session failed");
        assert!(served.is_cancelled() && queue.is_closed());
        tokio::task::spawn_blocking(move || worker.join()).await.unwrap().expect("the panic was caught");
        assert!(streams.is_closed());
    }
}
