//! The thread that owns a session. Nothing else touches its pipeline; the map it extends is its host's.
//!
//! It serves one stream at a time: a decoding thread beside it takes frames from the stream's queue, this
//! thread tracks them, answers go back through a bounded channel, and map updates go to the session's writer.
//! At the end of a stream everything is flushed before the client sees the end.

#[cfg(test)]
mod tests;

use super::SessionId;
use super::decoder::{self, Decoded};
use super::events::Events;
use super::frame::{Answer, Before, FrameOutcome, Rejection, Reply, SentImage};
use super::gallery::ShownFrame;
use super::host::MapHost;
use super::leaps::{EngineTimes, Leaps};
use super::load::History;
use super::mask_keeper::MaskKeeper;
use super::queue::{Ending, FrameQueue, Policy};
use super::recent::RecentAnswers;
use super::view::Live;
use crate::error::{ApiError, ErrorCode};
use crate::traces;
use slam::map::{CameraId, FrameState};
use slam::{FrameReport, Pipeline, TrackingOutcome};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};
use store::StoreError;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;
use tracing::Span;
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
    /// The map, and where its updates go.
    pub host: Arc<MapHost>,
    /// Which of the map's cameras the session's is.
    pub camera: CameraId,
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
    /// Frames of a REALTIME stream that waited longer are dropped, if newer ones wait.
    pub realtime_max_wait: Duration,
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
    host: Arc<MapHost>,
    camera: CameraId,
    history: History,
    ends: Ends,
    /// Number and time of the last frame, stored or not.
    last_frame: Option<(u64, i64)>,
    /// Every frame up to this one was saved when the session was loaded.
    durable_sequence: Option<u64>,
    times: EngineTimes,
    recent: RecentAnswers,
    /// What is known of samples of 16 bits.
    depth: SampleDepth,
    /// Frames tracked since the session was loaded.
    n_frames: u64,
    mask_keeper: MaskKeeper,
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
        let Persistence { host, camera, history, last_frame, ahead_ns } = persistence;
        let recent = RecentAnswers::default();
        let durable_sequence = last_frame.map(|(sequence, _)| sequence);
        let (depth, n_frames) = (SampleDepth::default(), 0);
        let times = EngineTimes::new(config.leaps, ahead_ns);
        let mask_keeper = MaskKeeper::new(history.clone(), runtime.clone(), pipeline.mask().cloned());
        Self {
            id,
            config,
            pipeline,
            host,
            camera,
            history,
            ends,
            last_frame,
            durable_sequence,
            times,
            recent,
            depth,
            n_frames,
            mask_keeper,
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
            self.host.stream_through(self.camera, Some(queue.clone()));
            let outcome = catch_unwind(AssertUnwindSafe(|| self.serve(stream)));
            self.host.stream_through(self.camera, None);
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
        // What the engine holds cannot be trusted any more, and is not saved: nor is it for other cameras.
        self.host.give_up(&error);
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
                    () = self.host.outbox().ended() => break,
                    // A session that cannot be saved stays: its frames are in no other place.
                    () = tokio::time::sleep(self.config.idle_unload) => if self.host.outbox().is_idle() { break },
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
        self.times.begin_stream(stream.new_segment);
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
                if let Some(failure) = self.host.outbox().failure() {
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
            Decoded::Frame { frame, arrived, .. } if self.is_stale(stream, arrived) => {
                dropped(frame.sequence)
            }
            Decoded::Frame { frame, brightest, sent, arrived } => self.track(frame, brightest, sent, arrived),
            Decoded::Dropped(sequence) => dropped(sequence),
            Decoded::Rejected(rejection) => rejected(rejection),
        };
        if !self.history.is_ours() {
            // The process stood still, or the database was away: another server may have gone on by now.
            let id = self.id.as_str().to_owned();
            stream.queue.abort(Err(StoreError::LeaseLost { id }.into()));
            return Err(ClientGone);
        }
        self.send(stream, Ok(reply))
    }

    /// Whether a frame shows what was, while what is waits.
    fn is_stale(&self, stream: &Stream, arrived: Instant) -> bool {
        stream.policy == Policy::Realtime
            && arrived.elapsed() > self.config.realtime_max_wait
            && stream.queue.n_frames() > 0
    }

    fn track(&mut self, frame: slam::Frame, brightest: u8, sent: SentImage, arrived: Instant) -> Reply {
        let (sequence, timestamp_ns) = (frame.sequence, frame.timestamp_ns);
        if self.last_frame.is_some_and(|(last, _)| sequence <= last) {
            return self.repeat(sequence, timestamp_ns);
        }
        let queued_ns = arrived.elapsed().as_nanos() as u64;
        let span = traces::frame(self.id.as_str(), sequence).entered();
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
            self.host.offer_image((self.camera, sequence), sent.clone(), state, report.is_keyframe);
        }
        self.hand_over_updates();
        self.mask_keeper.offer(self.pipeline.mask());
        self.publish(Some(state));
        let metres_per_unit = *self.ends.scale.borrow();
        // Where images are not to be kept, they are not shown either.
        let keep_images = self.config.keep_images;
        let shown = || {
            let observed = self.pipeline.observed().filter(|_| keep_images)?;
            Some(ShownFrame { image: sent, observed })
        };
        self.ends.events.frame(&report, metres_per_unit, shown);
        record_frame(&report, queued_ns, &span);
        self.recent.remember(report.clone());
        let durable_sequence = self.durable_sequence();
        Reply::Answered(Box::new(Answer { report, durable_sequence, queued_ns, metres_per_unit }))
    }

    /// The engine's time of a new frame; begins a segment where one is to begin.
    fn engine_time(&mut self, sequence: u64, timestamp_ns: i64) -> Result<i64, Rejection> {
        let Self { runtime, history, id, .. } = self;
        self.times.of(self.last_frame, sequence, timestamp_ns, |ahead_ns| {
            runtime.block_on(history.begin_segment(sequence, ahead_ns))?;
            tracing::info!(session.id = id.as_str(), "session {id}: frame {sequence} begins a new segment");
            Ok(())
        })
    }

    /// The answer to a frame that was answered before.
    fn repeat(&self, sequence: u64, timestamp_ns: i64) -> Reply {
        let before = match self.recent.get(sequence) {
            Some(report) => Some(Before::Recent(Box::new(report.clone()))),
            None => self.runtime.block_on(self.history.frame(sequence)).map(Before::Stored),
        };
        let (durable_sequence, metres_per_unit) = (self.durable_sequence(), *self.ends.scale.borrow());
        Reply::Repeated { sequence, timestamp_ns, before, durable_sequence, metres_per_unit }
    }

    /// Finishes what mapping has begun and waits until everything is saved.
    fn flush(&mut self) -> Result<(), ApiError> {
        self.pipeline.settle();
        self.hand_over_updates();
        self.mask_keeper.finish(self.pipeline.mask());
        let state = self.ends.live.borrow().state;
        self.publish(state);
        self.runtime.block_on(self.host.outbox().flush())
    }

    /// Every frame up to this one is saved.
    fn durable_sequence(&self) -> Option<u64> {
        self.host.outbox().durable_sequence(self.camera).max(self.durable_sequence)
    }

    fn hand_over_updates(&mut self) {
        self.host.hand_over(|| self.pipeline.take_updates());
        for judgement in self.pipeline.take_line_judgements() {
            let verdict = judgement.verdict.name();
            metrics::counter!("monoslam_line_candidates_total", "verdict" => verdict).increment(1);
        }
    }

    fn publish(&self, state: Option<FrameState>) {
        self.host.publish();
        let live = Live {
            state,
            last_frame: self.last_frame,
            n_frames: self.n_frames,
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

fn dropped(sequence: u64) -> Reply {
    metrics::counter!("monoslam_frames_total", "outcome" => "dropped").increment(1);
    Reply::Dropped(sequence)
}

fn rejected(rejection: Rejection) -> Reply {
    metrics::counter!("monoslam_frames_total", "outcome" => "rejected").increment(1);
    Reply::Rejected(rejection)
}

fn record_frame(report: &FrameReport, queued_ns: u64, span: &Span) {
    let outcome = match report.outcome {
        TrackingOutcome::Initialising(_) => "initialising",
        TrackingOutcome::Tracked => "tracked",
        TrackingOutcome::Weak { .. } | TrackingOutcome::CalibrationContradicted => "weak",
        TrackingOutcome::Lost(_) => "lost",
    };
    traces::describe_frame(span, report, outcome, queued_ns);
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
