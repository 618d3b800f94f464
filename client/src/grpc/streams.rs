//! Streams of frames, and of what happens in a session.

use proto::v1;
use proto::v1::stream_frames_request::Message as Sent;
use proto::v1::stream_frames_response::Message as Received;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

use super::SlamClient;
use crate::error::ClientError;

/// Frames on their way to the connection. Flow control holds frames back where they are read; this only keeps
/// the connection from running dry.
const FRAMES_IN_FLIGHT: usize = 2;

impl SlamClient {
    /// What happens in a session from now on.
    ///
    /// # Errors
    /// `NOT_FOUND`.
    pub async fn watch(&mut self, session_id: &str) -> Result<Events, ClientError> {
        let request = v1::WatchMapRequest { session_id: session_id.to_owned() };
        let answer = self.grpc.watch_map(request).await;
        Ok(Events { events: self.unpack(answer)?, server: self.server() })
    }

    /// Opens a stream of frames into a session and waits until the server has it ready.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `FAILED_PRECONDITION` if another writer is connected and is not to be taken over.
    pub async fn open_stream(&mut self, open: v1::OpenStream) -> Result<FrameStream, ClientError> {
        let (requests, outgoing) = mpsc::channel(FRAMES_IN_FLIGHT);
        let opening = v1::StreamFramesRequest { message: Some(Sent::Open(open)) };
        requests.try_send(opening).expect("a new channel has room");
        let answer = self.grpc.stream_frames(ReceiverStream::new(outgoing)).await;
        let mut answers = self.unpack(answer)?;
        let server = self.server();
        match next(&mut answers, &server).await? {
            Some(Received::Opened(v1::StreamOpened { session: Some(session) })) => Ok(FrameStream {
                session,
                sender: FrameSender { requests },
                answers: Answers { answers, server },
            }),
            _ => Err(ClientError::protocol("a stream must begin with `opened` and its session")),
        }
    }
}

/// An open stream: frames go in at one end, answers come out at the other, each at its own pace.
pub struct FrameStream {
    /// The session as it was when the stream opened.
    pub session: v1::Session,
    /// Where frames go in. Dropping it tells the server that there are no more.
    pub sender: FrameSender,
    /// Where answers come out.
    pub answers: Answers,
}

/// The sending end of a stream.
pub struct FrameSender {
    requests: mpsc::Sender<v1::StreamFramesRequest>,
}

impl FrameSender {
    /// Sends a frame, waiting while the server holds the client back. `false` if the stream has ended; its
    /// answers say why.
    pub async fn send(&self, frame: v1::Frame) -> bool {
        self.requests.send(v1::StreamFramesRequest { message: Some(Sent::Frame(frame)) }).await.is_ok()
    }
}

/// The receiving end of a stream.
pub struct Answers {
    answers: Streaming<v1::StreamFramesResponse>,
    server: String,
}

impl Answers {
    /// The next answer; `None` when the server has answered every frame and the stream has ended.
    ///
    /// # Errors
    /// If the connection broke or the server ended the stream.
    pub async fn next(&mut self) -> Result<Option<Received>, ClientError> {
        next(&mut self.answers, &self.server).await
    }
}

/// What happens in a session, as it happens.
pub struct Events {
    events: Streaming<v1::SessionEvent>,
    server: String,
}

impl Events {
    /// The next event, the session itself first; `None` when the server shuts down.
    ///
    /// # Errors
    /// If the connection broke or the session was deleted.
    pub async fn next(&mut self) -> Result<Option<v1::session_event::Event>, ClientError> {
        match self.events.message().await {
            Ok(None) => Ok(None),
            Ok(Some(v1::SessionEvent { event: Some(event) })) => Ok(Some(event)),
            Ok(Some(_)) => Err(ClientError::protocol("an event is empty")),
            Err(status) => Err(ClientError::from_status(&self.server, &status)),
        }
    }
}

async fn next(
    answers: &mut Streaming<v1::StreamFramesResponse>,
    server: &str,
) -> Result<Option<Received>, ClientError> {
    match answers.message().await {
        Ok(None) => Ok(None),
        Ok(Some(v1::StreamFramesResponse { message: Some(message) })) => Ok(Some(message)),
        Ok(Some(_)) => Err(ClientError::protocol("an answer is empty")),
        Err(status) => Err(ClientError::from_status(server, &status)),
    }
}
