//! The typed client of the gRPC service: the connection and its sessions here; maps, operations on whole maps
//! and streams beside.

mod maps;
mod operations;
mod streams;

use std::time::Duration;

use geometry::CameraParameters;
use proto::v1;
use proto::v1::slam_service_client::SlamServiceClient;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint, Uri};
use tonic::{Response, Status};

use crate::convert::camera_message;
use crate::credentials::{Bearer, Credentials};
use crate::error::{ClientError, causes};
use crate::http::HttpClient;

pub use streams::{Answers, Events, FrameSender, FrameStream};

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

    /// Connects to another server of the same fleet, with the same credentials.
    ///
    /// # Errors
    /// As [`Self::connect`]; also if credentials would be sent there without encryption that are not here.
    pub async fn connect_to_owner(&self, server: &str) -> Result<Self, ClientError> {
        let is_encrypted = |uri: &Uri| uri.scheme_str() == Some("https");
        if is_encrypted(&self.server) && !is_encrypted(&parse_address(server)?) {
            let reason = "the server it was named by is reached encrypted".to_owned();
            return Err(ClientError::Address { address: server.to_owned(), reason });
        }
        Self::connect_with(server, self.credentials.clone()).await
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
            ..v1::CreateSessionRequest::default()
        };
        self.create(request).await
    }

    /// As [`Self::create_session`], one more camera on the map of a session: both localize in it and add to
    /// it, each with its own stream and trajectory. `camera` may be left out if it is like the map's own; of
    /// the options only those can be given that do not concern the map.
    ///
    /// # Errors
    /// As there; `NOT_FOUND` if there is no such map, `INVALID_ARGUMENT` also if it is another owner's.
    pub async fn create_session_on_map(
        &mut self,
        session_id: &str,
        map: &str,
        camera: Option<&CameraParameters>,
        options: v1::SessionOptions,
    ) -> Result<v1::Session, ClientError> {
        let request = v1::CreateSessionRequest {
            session_id: session_id.to_owned(),
            camera: camera.map(camera_message),
            options: Some(options),
            map: map.to_owned(),
            ..v1::CreateSessionRequest::default()
        };
        self.create(request).await
    }

    /// Makes a session as the request says.
    ///
    /// # Errors
    /// As the methods above.
    pub async fn create(&mut self, request: v1::CreateSessionRequest) -> Result<v1::Session, ClientError> {
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
