//! Streams frames into a session until every one of them is answered, across broken connections.

use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use proto::v1;
use proto::v1::stream_frames_response::Message as Received;
use tokio::task::JoinHandle;

use crate::error::ClientError;
use crate::grpc::{Answers, FrameSender, SlamClient};
use crate::pacing::Pacing;
use crate::placement::Placement;
use crate::source::{FrameSource, ReadyFrame, read_ahead};
use crate::summary::{FrameAnswer, StreamSummary};
use crate::tally::Ledger;

/// Attempts at a connection, without a frame being answered in between, before the stream is given up: with
/// the waits below, about a minute, long enough for a server to start again and load a session.
const MAX_ATTEMPTS: u32 = 16;

/// Wait before the first attempt; each further one doubles it.
const FIRST_BACKOFF: Duration = Duration::from_millis(200);

/// Longest wait between attempts.
const MAX_BACKOFF: Duration = Duration::from_secs(5);

/// How long the server may take after the last answer to have everything in its database.
const DURABLE_TIMEOUT: Duration = Duration::from_secs(60);

/// How often it is asked.
const DURABLE_POLL: Duration = Duration::from_millis(20);

/// By how much an answer may be ahead of the one before: frames are answered in turn.
const MAX_AHEAD: usize = 1024;

/// What to stream and how.
#[derive(Clone, Debug)]
pub struct StreamPlan {
    /// The session, which exists.
    pub session_id: String,
    /// What the server does when frames come faster than it tracks.
    pub policy: v1::StreamPolicy,
    /// How fast frames are sent.
    pub pacing: Pacing,
    /// The frames of the source to stream. The end may lie behind that of the source, which ends the stream.
    pub range: Range<usize>,
    /// Their places in the session.
    pub placement: Placement,
    /// Whether to end the stream of a present writer instead of being refused.
    pub take_over: bool,
    /// Whether the first frame begins a new segment, whose times may be any, as after a clock was set.
    pub new_segment: bool,
    /// Whether frames are only located in the map, which stays as it is.
    pub localize_only: bool,
}

impl StreamPlan {
    /// All frames of a source from the session's first on, every one of them, as fast as the server takes
    /// them.
    pub fn lossless(session_id: impl Into<String>, source: &dyn FrameSource) -> Self {
        Self {
            session_id: session_id.into(),
            policy: v1::StreamPolicy::Lossless,
            pacing: Pacing::Unpaced,
            range: 0..source.n_frames().unwrap_or(usize::MAX),
            placement: Placement::AS_RECORDED,
            take_over: false,
            new_segment: false,
            localize_only: false,
        }
    }

    /// All frames of a source at the pace of their times; the server drops those it has no time for.
    pub fn realtime(session_id: impl Into<String>, source: &dyn FrameSource) -> Self {
        Self {
            policy: v1::StreamPolicy::Realtime,
            pacing: Pacing::Recorded,
            ..Self::lossless(session_id, source)
        }
    }
}

/// What there is to see while frames are streamed.
#[derive(Debug)]
pub enum StreamEvent<'a> {
    /// A frame was answered.
    Answered {
        /// Its place in the source.
        frame_idx: usize,
        /// What became of it.
        answer: &'a FrameAnswer,
    },
    /// The connection broke and is tried again after a wait.
    Reconnecting {
        /// Why.
        error: &'a ClientError,
        /// The wait.
        after: Duration,
    },
}

/// Streams the frames of a plan and waits until the server has them in its database.
///
/// When the connection breaks, it is made again; frames from the first that is not answered, or that the
/// server does not have any more, are sent once more. Where another server of the same fleet works with the
/// session, the stream goes there, and back if that is gone.
///
/// # Errors
/// If the server refuses the stream, stays away, or a frame cannot be read.
pub async fn stream_frames(
    client: &mut SlamClient,
    source: &Arc<dyn FrameSource>,
    plan: &StreamPlan,
    mut observe: impl FnMut(StreamEvent<'_>),
) -> Result<StreamSummary, ClientError> {
    let (started, home) = (Instant::now(), client.clone());
    let mut progress = Progress::new(&plan.range);
    let mut n_reconnects = 0;
    let mut n_attempts = 0;
    while progress.next_idx < progress.end_idx {
        let next_before = progress.next_idx;
        let take_over = plan.take_over || n_reconnects > 0;
        let error = match stream_once(client, source, plan, take_over, &mut progress, &mut observe).await {
            Ok(()) => break,
            Err(error) => error,
        };
        n_attempts = if progress.next_idx > next_before { 1 } else { n_attempts + 1 };
        if !error.is_passing() || n_attempts > MAX_ATTEMPTS {
            return Err(error);
        }
        let after = backoff(n_attempts);
        observe(StreamEvent::Reconnecting { error: &error, after });
        tokio::time::sleep(after).await;
        follow(client, &home, &error).await;
        n_reconnects += 1;
    }
    let elapsed_s = started.elapsed().as_secs_f64();
    let session = wait_until_durable(client, plan, progress.last_result).await;
    *client = home;
    let session = session?;
    let mut summary = progress.ledger.finish(progress.end_idx);
    summary.set_session(&session);
    summary.elapsed_s = elapsed_s;
    summary.frames_per_second = summary.frames as f64 / elapsed_s.max(1e-9);
    summary.realtime_factor = summary.recorded_s / elapsed_s.max(1e-9);
    summary.reconnects = n_reconnects;
    Ok(summary)
}

/// Goes to the server that works with the session; where that does not answer, back to the one that was
/// given.
async fn follow(client: &mut SlamClient, home: &SlamClient, error: &ClientError) {
    *client = match error {
        ClientError::OwnedElsewhere { owner, .. } => {
            home.connect_to_owner(owner).await.unwrap_or_else(|_| home.clone())
        }
        ClientError::Unreachable { .. } => home.clone(),
        _ => return,
    };
}

/// Which frames are answered.
struct Progress {
    /// The first frame without an answer.
    next_idx: usize,
    /// The frame to stop before, as far as it is known.
    end_idx: usize,
    /// The answers.
    ledger: Ledger,
    /// The sequence number of the last frame that the server tracked or tried to.
    last_result: Option<u64>,
}

impl Progress {
    fn new(range: &Range<usize>) -> Self {
        let ledger = Ledger::new(range.start);
        Self { next_idx: range.start, end_idx: range.end, ledger, last_result: None }
    }

    /// Notes an answer; `None` if it is to no frame of the plan.
    fn note(&mut self, plan: &StreamPlan, received: Received) -> Option<(usize, FrameAnswer)> {
        let (sequence, answer) = match received {
            Received::Result(result) => (result.sequence, FrameAnswer::Result(Box::new(result))),
            Received::Dropped(dropped) => (dropped.sequence, FrameAnswer::Dropped),
            Received::Rejected(rejected) => {
                let reason = format!("{}: {} ({})", rejected.field, rejected.reason, rejected.code);
                (rejected.sequence, FrameAnswer::Rejected(reason))
            }
            Received::Opened(_) => return None,
        };
        let frame_idx = plan.placement.frame_idx(sequence);
        let is_of_plan = plan.placement.sequence(frame_idx) == sequence && plan.range.contains(&frame_idx);
        if !is_of_plan || frame_idx > self.next_idx.saturating_add(MAX_AHEAD) {
            return None;
        }
        self.next_idx = self.next_idx.max(frame_idx + 1);
        if matches!(answer, FrameAnswer::Result(_)) {
            self.last_result = self.last_result.max(Some(sequence));
        }
        self.ledger.note(frame_idx, answer.clone());
        Some((frame_idx, answer))
    }
}

/// Streams over one connection, from the first frame that the server or we lack.
async fn stream_once(
    client: &mut SlamClient,
    source: &Arc<dyn FrameSource>,
    plan: &StreamPlan,
    take_over: bool,
    progress: &mut Progress,
    observe: &mut impl FnMut(StreamEvent<'_>),
) -> Result<(), ClientError> {
    let open = v1::OpenStream {
        session_id: plan.session_id.clone(),
        mode: if plan.localize_only {
            v1::StreamMode::LocalizeOnly.into()
        } else {
            v1::StreamMode::MapAndLocalize.into()
        },
        policy: plan.policy.into(),
        take_over,
        // Not again on the way.
        new_segment: plan.new_segment && progress.next_idx == plan.range.start,
    };
    let stream = client.open_stream(open).await?;
    let wanted_idx = plan.placement.frame_idx(stream.session.next_sequence);
    // What a camera has not kept is not to be had again.
    let first_idx = progress.next_idx.min(wanted_idx).max(plan.range.start).max(source.first_kept());
    progress.next_idx = first_idx;
    let range = first_idx..progress.end_idx.max(first_idx);
    let sending = tokio::spawn(send(stream.sender, source.clone(), range, plan.clone()));
    let received = receive(stream.answers, client, plan, progress, observe).await;
    if let Some(end_idx) = finish_sending(sending, received.is_err()).await? {
        progress.end_idx = end_idx;
    }
    received?;
    if progress.next_idx < progress.end_idx {
        return Err(ClientError::Unreachable {
            server: client.server(),
            reason: String::from("the stream ended before every frame was answered"),
        });
    }
    Ok(())
}

async fn receive(
    mut answers: Answers,
    client: &SlamClient,
    plan: &StreamPlan,
    progress: &mut Progress,
    observe: &mut impl FnMut(StreamEvent<'_>),
) -> Result<(), ClientError> {
    while let Some(received) = answers.next().await? {
        let (frame_idx, answer) = progress.note(plan, received).ok_or_else(|| {
            ClientError::protocol(format!("{} answered a frame that was not sent", client.server()))
        })?;
        observe(StreamEvent::Answered { frame_idx, answer: &answer });
    }
    Ok(())
}

/// Sends the frames of a range when they are due. The number behind the last one of the range or of the
/// source; `None` if the stream ended before.
async fn send(
    sender: FrameSender,
    source: Arc<dyn FrameSource>,
    range: Range<usize>,
    plan: StreamPlan,
) -> Result<Option<usize>, ClientError> {
    let first_idx = range.start;
    let mut end_idx = first_idx;
    let mut frames = read_ahead(source, range);
    let mut first = None;
    while let Some(ready) = frames.recv().await {
        let ReadyFrame { frame_idx, frame } = ready?;
        let (started, first_ns) =
            *first.get_or_insert_with(|| (tokio::time::Instant::now(), frame.timestamp_ns));
        let due = plan.pacing.due(frame_idx - first_idx, frame.timestamp_ns.saturating_sub(first_ns));
        tokio::time::sleep_until(started + due).await;
        let sent = v1::Frame {
            sequence: plan.placement.sequence(frame_idx),
            timestamp_ns: frame.timestamp_ns.saturating_add(plan.placement.shift_ns),
            image: Some(frame.image),
        };
        if !sender.send(sent).await {
            return Ok(None);
        }
        end_idx = frame_idx + 1;
    }
    Ok(Some(end_idx))
}

/// What the sender came to, as [`send`] says. If the stream has ended, it is not waited for: it may be asleep
/// until its next frame is due.
async fn finish_sending(
    sending: JoinHandle<Result<Option<usize>, ClientError>>,
    ended: bool,
) -> Result<Option<usize>, ClientError> {
    if ended && !sending.is_finished() {
        sending.abort();
        return Ok(None);
    }
    match sending.await {
        Ok(outcome) => outcome,
        Err(failed) => Err(ClientError::protocol(format!("sending failed: {failed}"))),
    }
}

/// Waits until the last tracked frame, that of this sequence number, is in the server's database.
async fn wait_until_durable(
    client: &mut SlamClient,
    plan: &StreamPlan,
    wanted: Option<u64>,
) -> Result<v1::Session, ClientError> {
    let deadline = Instant::now() + DURABLE_TIMEOUT;
    loop {
        let session = client.session(&plan.session_id).await?;
        let session = session.ok_or_else(|| ClientError::protocol("the session is gone"))?;
        // `None < Some(_)`: nothing wanted is there at once, nothing durable is not.
        if session.durable_sequence >= wanted {
            return Ok(session);
        }
        if Instant::now() > deadline {
            let reached = session.durable_sequence.map_or_else(|| "none".to_owned(), |n| n.to_string());
            return Err(ClientError::protocol(format!(
                "frame {} is not in the database after {} s; the last that is: {reached}",
                wanted.unwrap_or_default(),
                DURABLE_TIMEOUT.as_secs(),
            )));
        }
        tokio::time::sleep(DURABLE_POLL).await;
    }
}

fn backoff(n_attempts: u32) -> Duration {
    FIRST_BACKOFF.saturating_mul(2u32.saturating_pow(n_attempts.saturating_sub(1))).min(MAX_BACKOFF)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_a_limit() {
        let waits: Vec<u128> = (1..=7).map(|n| backoff(n).as_millis()).collect();
        assert_eq!(waits, [200, 400, 800, 1600, 3200, 5000, 5000]);
        assert_eq!(backoff(u32::MAX), MAX_BACKOFF);
        let total: Duration = (1..=MAX_ATTEMPTS).map(backoff).sum();
        assert!((50..90).contains(&total.as_secs()), "{total:?}");
    }
}
