//! One bidirectional stream of frames and answers.

use super::convert;
use crate::access::Caller;
use crate::budget::{Charge, Charges};
use crate::error::{ApiError, ErrorCode};
use crate::network::span;
use crate::service::Service;
use crate::session::{FrameQueue, OpenRequest, Queued, Replies, Reply};
use proto::v1;
use proto::v1::stream_frames_request::Message;
use std::pin::Pin;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::{Code, Status, Streaming};

/// Answers that wait for the client to read them. When there are as many, the session waits for the client,
/// or, in a REALTIME stream, drops frames.
const MAX_WAITING_ANSWERS: usize = 16;

/// The server's side of a stream.
pub type Answers = Pin<Box<dyn Stream<Item = Result<v1::StreamFramesResponse, Status>> + Send>>;

/// Serves a stream in a task of its own: the client sees the headers of the answer at once.
pub fn start(
    service: Arc<Service>,
    caller: Caller,
    requests: Streaming<v1::StreamFramesRequest>,
    charges: Charges,
) -> Answers {
    let (replies, answers) = mpsc::channel(MAX_WAITING_ANSWERS);
    tokio::spawn(serve(service, caller, Requests { requests, charges }, replies));
    Box::pin(ReceiverStream::new(answers).map(|reply: Result<Reply, ApiError>| match reply {
        Ok(reply) => Ok(convert::reply(reply)),
        Err(error) => Err(error.into()),
    }))
}

async fn serve(service: Arc<Service>, caller: Caller, mut requests: Requests, replies: Replies) {
    match open(&service, &caller, &mut requests, &replies).await {
        Ok(queue) => {
            // From here on the session alone holds the answers' channel, and its end is the end of the
            // stream.
            drop(replies);
            let ending = tokio::select! {
                ending = read_frames(&caller, &mut requests, &queue) => ending,
                () = queue.closed() => return,
            };
            queue.close(ending);
        }
        Err(error) => {
            let _ = replies.send(Err(error)).await;
        }
    }
}

async fn open(
    service: &Service,
    caller: &Caller,
    requests: &mut Requests,
    replies: &Replies,
) -> Result<Arc<FrameQueue>, ApiError> {
    let patience = span(service.config().connections.body_timeout_s);
    let first = tokio::time::timeout(patience, requests.next()).await.map_err(|_elapsed| {
        ApiError::invalid("open", format!("the first message of a stream must come within {patience:?}"))
    })?;
    let first = first?.map(|(request, _charge)| request.message);
    let Some(Some(Message::Open(open))) = first else {
        return Err(ApiError::invalid("open", "the first message of a stream must be `open`"));
    };
    let request: OpenRequest = convert::open_request(caller, open)?;
    // Not given up half-way, even if the client is gone by then: whoever is told of a queue closes it.
    service.open_stream(caller, request, replies.clone()).await
}

/// Queues frames until the client ends the stream or breaks the rules.
async fn read_frames(caller: &Caller, requests: &mut Requests, queue: &FrameQueue) -> Result<(), ApiError> {
    while let Some((request, charge)) = requests.next().await? {
        let item = match request.message {
            Some(Message::Frame(frame)) => convert::frame(frame, charge),
            Some(Message::Open(_)) => return Err(ApiError::invalid("open", "the stream is open already")),
            None => {
                return Err(ApiError::invalid(
                    "message",
                    "a message must be `open` or `frame`; this one is empty",
                ));
            }
        };
        let item = item.map_or_else(Queued::Rejected, Queued::Frame);
        if caller.push(queue, item).await.is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// What a client sends, with the room that it takes.
struct Requests {
    requests: Streaming<v1::StreamFramesRequest>,
    charges: Charges,
}

impl Requests {
    async fn next(&mut self) -> Result<Option<(v1::StreamFramesRequest, Option<Charge>)>, ApiError> {
        let request = self.requests.message().await.map_err(unreadable)?;
        Ok(request.map(|request| (request, self.charges.pop())))
    }
}

fn unreadable(status: Status) -> ApiError {
    match status.code() {
        Code::OutOfRange => {
            let sentence = format!("a message is larger than the server takes: {}", status.message());
            ApiError::new(ErrorCode::MessageTooLarge, sentence)
        }
        Code::ResourceExhausted => ApiError::new(ErrorCode::TooBusy, status.message()),
        // Nobody reads this if the connection broke.
        _ => ApiError::invalid("message", format!("the stream cannot be read on: {}", status.message())),
    }
}
