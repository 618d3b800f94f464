//! Frames over a WebSocket, for clients that cannot speak gRPC, such as a page in a browser.
//!
//! Each binary message of the client is a frame: its number (`u64`), its time in nanoseconds (`i64`), both
//! little-endian, then an image file. The server's messages are JSON with a `type`: `opened` first, then
//! one of `result`, `repeated`, `dropped` or `rejected` for each frame, in the order of arrival; `error` ends
//! the stream. The text message `finish` says that there are no more frames: what is on its way is answered,
//! the map saved, and the socket closed.

use super::events::FrameEvent;
use super::extract::{AskedBy, Params};
use super::model::Session;
use super::{App, ProblemDetails};
use crate::access::Caller;
use crate::budget::Charge;
use crate::connections::Inflow;
use crate::error::{ApiError, ErrorCode};
use crate::model::Units;
use crate::service::Service;
use crate::session::{
    Encoding, FrameQueue, Mode, OpenRequest, Policy, Queued, Rejection, Reply, SentFrame, SentImage,
};
use axum::Extension;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, State};
use axum::response::Response;
use bytes::{Buf, Bytes};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use utoipa::{IntoParams, ToSchema};

/// Answers that wait for the client to read them. When there are as many, the session waits for the client,
/// or, in a `realtime` stream, drops frames.
const MAX_WAITING_ANSWERS: usize = 16;

/// Number and time of a frame, before its image.
const HEAD_BYTES: usize = 16;

/// Numbers of frames are below 2^63, as the database has them.
const MAX_SEQUENCE: u64 = i64::MAX as u64;

/// A client is asked this often whether it is there: a phone that left the network says nothing.
const PING_EVERY: Duration = Duration::from_secs(10);

/// A client that neither sends nor reads anything for this long is gone.
const PATIENCE: Duration = Duration::from_secs(30);

/// What happens to frames that come faster than they are tracked.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum WantedPolicy {
    /// Every frame is tracked; the client is held back.
    Lossless,
    /// The newest frames are tracked; each one dropped is reported.
    #[default]
    Realtime,
}

/// How to stream.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// What happens to frames that come faster than they are tracked.
    #[param(inline)]
    policy: WantedPolicy,
    /// Ends the stream of the present writer, if there is one, instead of being refused.
    take_over: bool,
    /// Begins a new segment with the first new frame: its time may be any, as after a clock was set.
    new_segment: bool,
}

/// One message to the client of a stream.
#[derive(Serialize, ToSchema)]
#[serde(tag = "type", rename_all = "lowercase")]
pub(super) enum StreamMessage {
    /// The stream is open.
    Opened {
        /// The session as it is now.
        session: Box<Session>,
    },
    /// A frame was tracked, or tried to be.
    Result {
        /// What came of it.
        #[serde(flatten)]
        frame: Box<FrameEvent>,
        /// Every frame up to this one is in the database; `null` before the first.
        durable_sequence: Option<u64>,
    },
    /// The frame was answered before; it was not tracked again.
    Repeated {
        /// The client's number of the frame.
        sequence: u64,
        /// Every frame up to this one is in the database; `null` before the first.
        durable_sequence: Option<u64>,
    },
    /// A newer frame came before this one's turn.
    Dropped {
        /// The client's number of the frame.
        sequence: u64,
    },
    /// The frame cannot be used; nothing of it is kept.
    Rejected {
        /// The client's number of the frame.
        sequence: u64,
        /// Which part of the frame is wrong.
        field: &'static str,
        /// What is wrong with it, in a plain sentence.
        reason: String,
        /// Stable name of the kind of error.
        code: &'static str,
    },
    /// The stream ends with this problem.
    Error {
        /// What went wrong.
        problem: ProblemDetails,
    },
}

/// Streams frames into the session over a WebSocket. Binary messages are frames: number (u64) and time in
/// nanoseconds (i64), little-endian, then an image file; numbers count up from the session's
/// `next_sequence`. Each is answered with a JSON message; the text message `finish` ends the stream.
#[utoipa::path(get, path = "/v1/sessions/{id}/stream", tag = "sessions",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 101, description = "The stream; its messages", body = StreamMessage),
    (status = 400, description = "Not a WebSocket request, or from a page of another server", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn stream(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
    inflow: Option<Extension<Inflow>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let id = caller.session(&id, "id")?;
    app.service.get_session(&id).await?;
    let upgrade = upgrade.map_err(|rejection| ApiError::invalid("upgrade", rejection.body_text()))?;
    let policy = match wanted.policy {
        WantedPolicy::Lossless => Policy::Lossless,
        WantedPolicy::Realtime => Policy::Realtime,
    };
    let Wanted { take_over, new_segment, .. } = wanted;
    let request = OpenRequest { id, mode: Mode::MapAndLocalize, policy, take_over, new_segment };
    let max_bytes = app.service.config().limits.max_message_bytes;
    let upgrade = upgrade.max_message_size(max_bytes).max_frame_size(max_bytes);
    // None where a request comes over no connection.
    let inflow = inflow.map(|Extension(inflow)| inflow);
    Ok(upgrade.on_upgrade(move |socket| serve(app.service, (caller, inflow), socket, request)))
}

async fn serve(
    service: Arc<Service>,
    (caller, inflow): (Caller, Option<Inflow>),
    socket: WebSocket,
    request: OpenRequest,
) {
    if let Some(inflow) = &inflow {
        inflow.count();
    }
    let (sink, mut source) = socket.split();
    let (replies, answers) = mpsc::channel(MAX_WAITING_ANSWERS);
    let opened = service.open_stream(&caller, request, replies.clone()).await;
    let writing = write_answers(sink, answers);
    tokio::pin!(writing);
    let queue = match opened {
        Ok(queue) => queue,
        Err(error) => {
            let _ = replies.send(Err(error)).await;
            drop(replies);
            return writing.await;
        }
    };
    // From here on the session alone holds the answers' channel, and its end is the end of the stream.
    drop(replies);
    tokio::select! {
        // The session has ended the stream, or the client is gone.
        () = &mut writing => queue.close(Ok(())),
        ending = read_frames(&caller, inflow.as_ref(), &mut source, &queue) => {
            queue.close(ending);
            writing.await;
        }
    }
}

/// Sends answers until there are no more or the client does not take them.
async fn write_answers(
    mut sink: SplitSink<WebSocket, Message>,
    mut answers: mpsc::Receiver<Result<Reply, ApiError>>,
) {
    let mut pings = tokio::time::interval_at(tokio::time::Instant::now() + PING_EVERY, PING_EVERY);
    loop {
        let message = tokio::select! {
            answer = answers.recv() => match answer {
                Some(answer) => text_of(&message_of(answer)),
                None => break,
            },
            _ = pings.tick() => Message::Ping(Bytes::new()),
        };
        if !matches!(tokio::time::timeout(PATIENCE, sink.send(message)).await, Ok(Ok(()))) {
            return;
        }
    }
    let _ = tokio::time::timeout(PATIENCE, sink.send(Message::Close(None))).await;
}

/// Queues frames until the client says that there are no more, is gone, or breaks the rules.
async fn read_frames(
    caller: &Caller,
    inflow: Option<&Inflow>,
    source: &mut SplitStream<WebSocket>,
    queue: &FrameQueue,
) -> Result<(), ApiError> {
    while let Ok(Some(message)) = tokio::time::timeout(PATIENCE, source.next()).await {
        // Also what was no frame needs no room any more.
        let charge = inflow.and_then(Inflow::take).map(Arc::new);
        let item = match message {
            Ok(Message::Binary(bytes)) => frame(bytes, charge)?,
            Ok(Message::Text(text)) if text.as_str() == "finish" => return Ok(()),
            Ok(Message::Text(_)) => {
                return Err(ApiError::invalid("message", "a text message can only be `finish`"));
            }
            Ok(Message::Ping(_) | Message::Pong(_)) => continue,
            Ok(Message::Close(_)) => return Ok(()),
            Err(error) => return Err(inflow.and_then(Inflow::refusal).unwrap_or_else(|| broken(&error))),
        };
        if caller.push(queue, item).await.is_err() {
            break;
        }
    }
    Ok(())
}

/// Why the stream cannot be read on; nobody hears it if the connection broke.
fn broken(error: &axum::Error) -> ApiError {
    let sentence = format!("the stream cannot be read on: {error}");
    if error.to_string().contains("too long") {
        return ApiError::new(ErrorCode::MessageTooLarge, sentence);
    }
    ApiError::invalid("message", sentence)
}

/// The frame of a binary message.
fn frame(mut bytes: Bytes, charge: Option<Arc<Charge>>) -> Result<Queued, ApiError> {
    if bytes.len() < HEAD_BYTES {
        let sentence = format!("a frame begins with {HEAD_BYTES} bytes, its number and its time");
        return Err(ApiError::invalid("message", sentence));
    }
    let (sequence, timestamp_ns) = (bytes.get_u64_le(), bytes.get_i64_le());
    if sequence > MAX_SEQUENCE {
        let reason = "must be below 2^63".to_owned();
        let (field, code) = ("sequence", "SEQUENCE_OUT_OF_RANGE");
        return Ok(Queued::Rejected(Rejection { sequence, field, reason, code }));
    }
    let image = SentImage { encoding: Encoding::Auto, width: 0, height: 0, row_stride: 0, data: bytes };
    Ok(Queued::Frame(SentFrame { sequence, timestamp_ns, image, arrived: Instant::now(), charge }))
}

fn message_of(reply: Result<Reply, ApiError>) -> StreamMessage {
    match reply {
        Ok(Reply::Opened(view)) => StreamMessage::Opened { session: Box::new(Session::from(*view)) },
        Ok(Reply::Answered(answer)) => StreamMessage::Result {
            frame: Box::new(FrameEvent::new(&answer.report, Units::new(answer.metres_per_unit))),
            durable_sequence: answer.durable_sequence,
        },
        Ok(Reply::Repeated { sequence, durable_sequence, .. }) => {
            StreamMessage::Repeated { sequence, durable_sequence }
        }
        Ok(Reply::Dropped(sequence)) => StreamMessage::Dropped { sequence },
        Ok(Reply::Rejected(Rejection { sequence, field, reason, code })) => {
            StreamMessage::Rejected { sequence, field, reason, code }
        }
        Err(error) => StreamMessage::Error { problem: error.into() },
    }
}

/// Numbers and words only: nothing that JSON cannot say, as poses are finite.
fn text_of(message: &StreamMessage) -> Message {
    Message::Text(serde_json::to_string(message).unwrap_or_default().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_have_a_head() {
        let mut bytes = 7u64.to_le_bytes().to_vec();
        bytes.extend((-5i64).to_le_bytes());
        bytes.extend(b"\xff\xd8");
        let Ok(Queued::Frame(found)) = frame(bytes.clone().into(), None) else { panic!("a frame") };
        assert_eq!((found.sequence, found.timestamp_ns, &found.image.data[..]), (7, -5, &b"\xff\xd8"[..]));
        assert!(frame(Bytes::copy_from_slice(&bytes[..15]), None).is_err());
        bytes[7] = 0x80;
        assert!(
            matches!(frame(bytes.into(), None), Ok(Queued::Rejected(r)) if r.code == "SEQUENCE_OUT_OF_RANGE")
        );
    }
}
