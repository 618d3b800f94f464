//! The typed client of the gRPC service.

use std::time::Duration;

use geometry::CameraParameters;
use proto::v1;
use proto::v1::slam_service_client::SlamServiceClient;
use proto::v1::stream_frames_request::Message as Sent;
use proto::v1::stream_frames_response::Message as Received;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic::{Response, Status, Streaming};

use crate::convert::camera_message;
use crate::credentials::{Bearer, Credentials};
use crate::error::{ClientError, causes};
use crate::http::HttpClient;

/// The response header in which the server tells the port of its HTTP interface.
pub const HTTP_PORT_HEADER: &str = "x-monoslam-http-port";

/// The port of the HTTP interface if the server does not tell.
const DEFAULT_HTTP_PORT: u16 = 8080;

/// A server that does not take a connection for this long is not there.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// A server that does not answer a ping for this long is gone. It answers while it works, so this only has to
/// outlast a stall of the network.
const KEEPALIVE: Duration = Duration::from_secs(10);

/// Sessions asked for at a time.
const PAGE_SIZE: u32 = 1000;

/// Frames on their way to the connection. Flow control holds frames back where they are read; this only keeps
/// the connection from running dry.
const FRAMES_IN_FLIGHT: usize = 2;

/// A connection to a SLAM server.
#[derive(Clone, Debug)]
pub struct SlamClient {
    server: Uri,
    credentials: Credentials,
    grpc: SlamServiceClient<InterceptedService<Channel, Bearer>>,
}

impl SlamClient {
    /// Connects to the gRPC interface of a server, such as `http://127.0.0.1:50051`.
    ///
    /// # Errors
    /// If the address is not one or nobody answers there.
    pub async fn connect(server: &str) -> Result<Self, ClientError> {
        Self::connect_with(server, Credentials::default()).await
    }

    /// As [`Self::connect`], with a token, or encrypted (`https://HOST:PORT`).
    ///
    /// # Errors
    /// If the address is not one, the credentials cannot be used, or nobody answers there.
    pub async fn connect_with(server: &str, credentials: Credentials) -> Result<Self, ClientError> {
        let uri = parse_address(server)?;
        let bearer = Bearer(credentials.header()?);
        let mut endpoint = Endpoint::from(uri.clone())
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEPALIVE)
            .keep_alive_timeout(KEEPALIVE)
            .tcp_nodelay(true);
        if uri.scheme_str() == Some("https") {
            let tls = endpoint.tls_config(credentials.grpc_tls());
            endpoint = tls.map_err(|error| ClientError::Credentials(causes(&error)))?;
        }
        let connected = endpoint.connect().await;
        let channel = connected.map_err(|error| ClientError::unreachable(server, causes(&error)))?;
        let grpc = SlamServiceClient::with_interceptor(channel, bearer);
        Ok(Self { server: uri, credentials, grpc })
    }

    /// The HTTP interface of the same server, with the same credentials.
    ///
    /// # Errors
    /// If the server cannot be asked where it is.
    pub async fn http(&mut self) -> Result<HttpClient, ClientError> {
        let address = self.http_address().await?;
        HttpClient::told(address, &self.credentials)
    }

    /// The address connected to.
    pub fn server(&self) -> String {
        self.server.to_string().trim_end_matches('/').to_owned()
    }

    /// Makes a session for one camera; with an empty id the server chooses one. What the options leave out
    /// takes the server's default.
    ///
    /// # Errors
    /// `ALREADY_EXISTS` if the id is taken, `INVALID_ARGUMENT` if the camera is refused.
    pub async fn create_session(
        &mut self,
        session_id: &str,
        camera: &CameraParameters,
        options: v1::SessionOptions,
    ) -> Result<v1::Session, ClientError> {
        self.create_session_with_mask(session_id, camera, options, Vec::new()).await
    }

    /// As [`Self::create_session`], with the file of a picture that is dark where nothing of the images is to
    /// be used.
    ///
    /// # Errors
    /// As there; `INVALID_ARGUMENT` also if the picture cannot be used.
    pub async fn create_session_with_mask(
        &mut self,
        session_id: &str,
        camera: &CameraParameters,
        options: v1::SessionOptions,
        mask: Vec<u8>,
    ) -> Result<v1::Session, ClientError> {
        let request = v1::CreateSessionRequest {
            session_id: session_id.to_owned(),
            camera: Some(camera_message(camera)),
            options: Some(options),
            mask,
        };
        let answer = self.grpc.create_session(request).await;
        self.unpack(answer)
    }

    /// The session of that id as it is now; `None` if there is none.
    ///
    /// # Errors
    /// If the server cannot be asked.
    pub async fn session(&mut self, session_id: &str) -> Result<Option<v1::Session>, ClientError> {
        let request = v1::GetSessionRequest { session_id: session_id.to_owned() };
        let answer = self.grpc.get_session(request).await;
        match self.unpack(answer) {
            Ok(session) => Ok(Some(session)),
            Err(ClientError::Refused { code: tonic::Code::NotFound, .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// All sessions in the order of their ids.
    ///
    /// # Errors
    /// If the server cannot be asked.
    pub async fn sessions(&mut self) -> Result<Vec<v1::Session>, ClientError> {
        let mut sessions = Vec::new();
        let mut page_token = String::new();
        loop {
            let answer =
                self.grpc.list_sessions(v1::ListSessionsRequest { page_size: PAGE_SIZE, page_token }).await;
            let page = self.unpack(answer)?;
            sessions.extend(page.sessions);
            page_token = page.next_page_token;
            if page_token.is_empty() {
                return Ok(sessions);
            }
        }
    }

    /// Deletes a session with its map.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `FAILED_PRECONDITION` while a writer is connected.
    pub async fn delete_session(&mut self, session_id: &str) -> Result<(), ClientError> {
        let request = v1::DeleteSessionRequest { session_id: session_id.to_owned() };
        let answer = self.grpc.delete_session(request).await;
        self.unpack(answer).map(|_| ())
    }

    /// All points of a session's map, as of its last commit.
    ///
    /// # Errors
    /// `NOT_FOUND`, or if the connection breaks.
    pub async fn points(&mut self, session_id: &str) -> Result<Vec<v1::Point>, ClientError> {
        let request = v1::QueryPointsRequest { session_id: session_id.to_owned(), ..Default::default() };
        let answer = self.grpc.query_points(request).await;
        let mut batches = self.unpack(answer)?;
        let mut points = Vec::new();
        while let Some(batch) = batches.message().await.map_err(|status| self.refused(&status))? {
            points.extend(batch.points);
        }
        Ok(points)
    }

    /// All lines of a session's map, as of its last commit.
    ///
    /// # Errors
    /// `NOT_FOUND`, or if the connection breaks.
    pub async fn lines(&mut self, session_id: &str) -> Result<Vec<v1::Line>, ClientError> {
        let request = v1::QueryLinesRequest { session_id: session_id.to_owned(), ..Default::default() };
        let answer = self.grpc.query_lines(request).await;
        let mut batches = self.unpack(answer)?;
        let mut lines = Vec::new();
        while let Some(batch) = batches.message().await.map_err(|status| self.refused(&status))? {
            lines.extend(batch.lines);
        }
        Ok(lines)
    }

    /// Changes a session's options; they hold from its next stream on. What an option leaves out stays as it
    /// is.
    ///
    /// # Errors
    /// `NOT_FOUND`, `INVALID_ARGUMENT`, or `FAILED_PRECONDITION` while a writer is connected.
    pub async fn update_session(
        &mut self,
        session_id: &str,
        options: v1::SessionOptions,
    ) -> Result<v1::Session, ClientError> {
        let request = v1::UpdateSessionRequest { session_id: session_id.to_owned(), options: Some(options) };
        let answer = self.grpc.update_session(request).await;
        self.unpack(answer)
    }

    /// Says how many metres a map unit of the session is, or with `None` frees the scale.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if it is not a positive number.
    pub async fn set_scale(
        &mut self,
        session_id: &str,
        metres_per_unit: Option<f64>,
    ) -> Result<v1::Session, ClientError> {
        let session_id = session_id.to_owned();
        let request = v1::SetScaleRequest { session_id, metres_per_unit, reference: None };
        let answer = self.grpc.set_scale(request).await;
        self.unpack(answer)
    }

    /// Finds how many metres a map unit of the session is from a known distance or positions; the session's
    /// `scale_measurement` tells how well.
    ///
    /// # Errors
    /// `NOT_FOUND`, `INVALID_ARGUMENT`, or `FAILED_PRECONDITION` if the reference does not determine it.
    pub async fn measure_scale(
        &mut self,
        session_id: &str,
        reference: v1::set_scale_request::Reference,
    ) -> Result<v1::Session, ClientError> {
        let (session_id, reference) = (session_id.to_owned(), Some(reference));
        let request = v1::SetScaleRequest { session_id, metres_per_unit: None, reference };
        let answer = self.grpc.set_scale(request).await;
        self.unpack(answer)
    }

    /// Locates one image in the map of a session without changing it. A place that is not found is an answer:
    /// its state is `LOST` and its reason a sentence.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if the image cannot be used.
    pub async fn localize(
        &mut self,
        session_id: &str,
        image: v1::Image,
    ) -> Result<v1::LocalizeResponse, ClientError> {
        let session_id = session_id.to_owned();
        self.localize_with(v1::LocalizeRequest { session_id, image: Some(image), ..Default::default() }).await
    }

    /// As [`Self::localize`], with everything that can be said: another camera, several sessions, where to
    /// look.
    ///
    /// # Errors
    /// `NOT_FOUND`, or `INVALID_ARGUMENT` if the image or what is said of its camera cannot be used.
    pub async fn localize_with(
        &mut self,
        request: v1::LocalizeRequest,
    ) -> Result<v1::LocalizeResponse, ClientError> {
        let answer = self.grpc.localize(request).await;
        self.unpack(answer)
    }

    /// Begins global bundle adjustment of an idle session's map; it goes on when the client leaves.
    ///
    /// # Errors
    /// `NOT_FOUND`, `FAILED_PRECONDITION` while a writer is connected or another operation works on it, or
    /// `RESOURCE_EXHAUSTED` where too many wait.
    pub async fn optimize_map(&mut self, session_id: &str) -> Result<v1::Operation, ClientError> {
        let answer =
            self.grpc.optimize_map(v1::OptimizeMapRequest { session_id: session_id.to_owned() }).await;
        self.unpack(answer)
    }

    /// Begins to join one session with another where their maps show the same place.
    ///
    /// # Errors
    /// As [`Self::optimize_map`].
    pub async fn merge_sessions(&mut self, into: &str, from: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::MergeSessionsRequest { into: into.to_owned(), from: from.to_owned() };
        let answer = self.grpc.merge_sessions(request).await;
        self.unpack(answer)
    }

    /// How far an operation is.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is none of this id, or no longer.
    pub async fn operation(&mut self, operation_id: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::GetOperationRequest { operation_id: operation_id.to_owned() };
        let answer = self.grpc.get_operation(request).await;
        self.unpack(answer)
    }

    /// Operations on all sessions, or on one, the newest first.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is no such session.
    pub async fn operations(&mut self, session_id: Option<&str>) -> Result<Vec<v1::Operation>, ClientError> {
        let session_id = session_id.unwrap_or_default().to_owned();
        let answer = self.grpc.list_operations(v1::ListOperationsRequest { session_id }).await;
        Ok(self.unpack(answer)?.operations)
    }

    /// Asks an operation to end without a result.
    ///
    /// # Errors
    /// `NOT_FOUND` if there is none of this id, or no longer.
    pub async fn cancel_operation(&mut self, operation_id: &str) -> Result<v1::Operation, ClientError> {
        let request = v1::CancelOperationRequest { operation_id: operation_id.to_owned() };
        let answer = self.grpc.cancel_operation(request).await;
        self.unpack(answer)
    }

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

    /// The address of the server's HTTP interface: on the same host, at the port the server tells in the
    /// header [`HTTP_PORT_HEADER`] of every answer.
    ///
    /// # Errors
    /// If the server cannot be asked.
    pub async fn http_address(&mut self) -> Result<String, ClientError> {
        let answer = self
            .grpc
            .list_sessions(v1::ListSessionsRequest { page_size: 1, page_token: String::new() })
            .await;
        let headers = match &answer {
            Ok(response) => response.metadata(),
            Err(status) => status.metadata(),
        };
        let told = headers.get(HTTP_PORT_HEADER).and_then(|value| value.to_str().ok()?.parse().ok());
        if told.is_none() {
            self.unpack(answer)?;
        }
        let (scheme, host) = (self.server.scheme_str(), self.server.host());
        let (scheme, host) = (scheme.unwrap_or("http"), host.unwrap_or("localhost"));
        Ok(format!("{scheme}://{host}:{}", told.unwrap_or(DEFAULT_HTTP_PORT)))
    }

    fn unpack<T>(&self, answer: Result<Response<T>, Status>) -> Result<T, ClientError> {
        answer.map(Response::into_inner).map_err(|status| self.refused(&status))
    }

    fn refused(&self, status: &Status) -> ClientError {
        ClientError::from_status(&self.server(), status)
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

fn parse_address(address: &str) -> Result<Uri, ClientError> {
    let refuse =
        |reason: &str| ClientError::Address { address: address.to_owned(), reason: reason.to_owned() };
    let expected = "http://HOST:PORT or https://HOST:PORT expected";
    let uri: Uri = address.parse().map_err(|_| refuse(expected))?;
    match (uri.scheme_str(), uri.host()) {
        (Some("http" | "https"), Some(_)) => Ok(uri),
        _ => Err(refuse(expected)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_checked() {
        assert_eq!(parse_address("http://[::1]:50051").unwrap().host(), Some("[::1]"));
        assert!(parse_address("https://h:1").is_ok());
        for address in ["localhost:50051", "ftp://h:1", "", "/path", "http://"] {
            let error = parse_address(address).unwrap_err().to_string();
            assert!(error.starts_with(&format!("`{address}` is not the address of a server")), "{error}");
        }
    }
}
