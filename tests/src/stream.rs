//! A stream of frames, message by message.

use crate::Client;
use proto::v1;
use proto::v1::stream_frames_request::Message as Request;
use proto::v1::stream_frames_response::Message as Response;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// Longer than any answer may take on a busy machine: a test that waits this long has found a fault.
const PATIENCE: Duration = Duration::from_secs(60);

/// An open stream.
pub struct FrameStream {
    requests: mpsc::Sender<v1::StreamFramesRequest>,
    answers: Streaming<v1::StreamFramesResponse>,
    /// The session as it was when the stream was opened.
    pub opened: v1::Session,
}

/// A LOSSLESS stream that maps.
pub fn open_message(session_id: &str) -> v1::OpenStream {
    v1::OpenStream {
        session_id: session_id.to_owned(),
        mode: v1::StreamMode::MapAndLocalize.into(),
        policy: v1::StreamPolicy::Lossless.into(),
        take_over: false,
        new_segment: false,
    }
}

/// A pinhole camera of this size.
pub fn camera(width: u32, height: u32) -> v1::Camera {
    v1::Camera {
        model: v1::CameraModel::Pinhole.into(),
        width,
        height,
        fx: f64::from(width),
        fy: f64::from(width),
        cx: f64::from(width - 1) / 2.0,
        cy: f64::from(height - 1) / 2.0,
        distortion: Vec::new(),
    }
}

/// A frame of the given number, 50 ms after the one before.
pub fn frame(sequence: u64, image: v1::Image) -> v1::Frame {
    v1::Frame { sequence, timestamp_ns: sequence as i64 * 50_000_000, image: Some(image) }
}

/// Makes a session.
///
/// # Errors
/// What the server says.
pub async fn create_session(
    client: &mut Client,
    id: &str,
    camera: v1::Camera,
) -> Result<v1::Session, Status> {
    let request = v1::CreateSessionRequest {
        session_id: id.to_owned(),
        camera: Some(camera),
        options: None,
        ..v1::CreateSessionRequest::default()
    };
    Ok(client.create_session(request).await?.into_inner())
}

impl FrameStream {
    /// Starts a call without opening the stream: the first message is up to the caller.
    ///
    /// # Errors
    /// What the server says.
    pub async fn start(client: &mut Client) -> Result<Self, Status> {
        let (requests, receiver) = mpsc::channel(1);
        let answers = client.stream_frames(ReceiverStream::new(receiver)).await?.into_inner();
        Ok(Self { requests, answers, opened: v1::Session::default() })
    }

    /// Opens a stream.
    ///
    /// # Errors
    /// What the server says.
    pub async fn open(client: &mut Client, open: v1::OpenStream) -> Result<Self, Status> {
        let mut stream = Self::start(client).await?;
        stream.send(Request::Open(open)).await;
        match stream.next().await? {
            Some(Response::Opened(opened)) => {
                stream.opened = opened.session.ok_or_else(|| Status::internal("opened without a session"))?;
                Ok(stream)
            }
            other => Err(Status::internal(format!("expected `opened`, got {other:?}"))),
        }
    }

    /// Sends a message; false if the call has ended.
    pub async fn send(&self, message: Request) -> bool {
        let request = v1::StreamFramesRequest { message: Some(message) };
        tokio::time::timeout(PATIENCE, self.requests.send(request)).await.is_ok_and(|sent| sent.is_ok())
    }

    /// The handle to send from another task.
    pub fn sender(&self) -> mpsc::Sender<v1::StreamFramesRequest> {
        self.requests.clone()
    }

    /// Sends a frame; false if the call has ended.
    pub async fn send_frame(&self, frame: v1::Frame) -> bool {
        self.send(Request::Frame(frame)).await
    }

    /// The next answer; `None` at the end.
    ///
    /// # Errors
    /// What the server says.
    pub async fn next(&mut self) -> Result<Option<Response>, Status> {
        let answer = tokio::time::timeout(PATIENCE, self.answers.message()).await;
        let answer = answer.map_err(|_| Status::deadline_exceeded("the server does not answer"))??;
        Ok(answer.and_then(|answer| answer.message))
    }

    /// Sends a frame and waits for its answer.
    ///
    /// # Errors
    /// What the server says.
    pub async fn exchange(&mut self, frame: v1::Frame) -> Result<Response, Status> {
        self.send_frame(frame).await;
        self.next().await?.ok_or_else(|| Status::internal("the stream ended without an answer"))
    }

    /// Sends a frame that must be tracked.
    ///
    /// # Errors
    /// What the server says.
    pub async fn track(&mut self, frame: v1::Frame) -> Result<v1::FrameResult, Status> {
        match self.exchange(frame).await? {
            Response::Result(result) => Ok(result),
            other => Err(Status::internal(format!("expected a result, got {other:?}"))),
        }
    }

    /// Ends the stream and reads what is left of it.
    ///
    /// # Errors
    /// How the server ended it.
    pub async fn finish(self) -> Result<Vec<Response>, Status> {
        let Self { requests, answers, opened } = self;
        drop(requests);
        let (unused, _) = mpsc::channel(1);
        let mut rest = Self { requests: unused, answers, opened };
        let mut left = Vec::new();
        while let Some(answer) = rest.next().await? {
            left.push(answer);
        }
        Ok(left)
    }
}
