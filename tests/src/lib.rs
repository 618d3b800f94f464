//! What end-to-end tests share: servers on free ports, a client that speaks the plain contract, and images.
//!
//! The tests use the generated client and not the `client` crate, so that they see exactly what is on the
//! wire.

mod images;
mod stream;

pub use images::{SmallWorld, jpeg, oversized_png, png, raw_gray};
pub use stream::{FrameStream, camera, create_session, frame, open_message};

use anyhow::{Context, ensure};
use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper_util::client::legacy::Client as HttpClient;
use hyper_util::rt::TokioExecutor;
use proto::v1::slam_service_client::SlamServiceClient;
use server::{Config, Running, Server, Shutdown};
use std::net::SocketAddr;
use std::path::Path;
use store::{NewToken, TokenQuotas, TokenRole};
use tempfile::TempDir;
use tonic::transport::Channel;

/// A client of the service.
pub type Client = SlamServiceClient<Channel>;

/// A server in this process with a database of its own.
pub struct TestServer {
    config: Config,
    running: Running,
    folder: TempDir,
}

impl TestServer {
    /// A server with an empty database.
    pub async fn start() -> Self {
        Self::start_with(|_| {}).await
    }

    /// A server with an empty database and a changed configuration.
    pub async fn start_with(change: impl FnOnce(&mut Config)) -> Self {
        let folder = tempfile::tempdir().expect("a folder for the database");
        let mut config = Config::local(folder.path());
        change(&mut config);
        let running = Server::start(config.clone()).await.expect("the server starts");
        Self { config, running, folder }
    }

    /// A server with a copy of the database that an ended server left in a folder.
    pub async fn start_on_copy(of: &Path) -> Self {
        let folder = tempfile::tempdir().expect("a folder for the database");
        let file = server::DATABASE_FILE;
        std::fs::copy(of.join(file), folder.path().join(file)).expect("the database is copied");
        let config = Config::local(folder.path());
        let running = Server::start(config.clone()).await.expect("the server starts");
        Self { config, running, folder }
    }

    /// Ends the server in order and starts another one on the same database.
    pub async fn restart(self) -> Self {
        let Self { config, running, folder } = self;
        assert_eq!(running.shutdown().await, Shutdown::Complete);
        let running = Server::start(config.clone()).await.expect("the server starts again");
        Self { config, running, folder }
    }

    /// Ends the server in order; the database stays until the folder is dropped.
    pub async fn shut_down(self) -> (Shutdown, TempDir) {
        (self.running.shutdown().await, self.folder)
    }

    /// The server.
    pub fn running(&self) -> &Running {
        &self.running
    }

    /// The folder of the database.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Makes a token in the database, as another program would; the server notices it a moment later.
    pub async fn make_token(&self, name: &str, role: TokenRole, quotas: TokenQuotas) -> String {
        let token = server::access::new_token();
        let owner = (role != TokenRole::Admin).then(|| name.trim_end_matches("-reader").to_owned());
        let hash = server::access::token_hash(&token);
        let name = name.to_owned();
        let new = NewToken { name, hash, role, owner, created_at_ns: 0, expires_at_ns: None, quotas };
        self.running.store().create_token(&new).await.expect("the token is made");
        token
    }

    /// As [`Self::make_token`], and waits until the server knows it.
    pub async fn token(&self, name: &str, role: TokenRole) -> String {
        let token = self.make_token(name, role, TokenQuotas::default()).await;
        self.running.reload().await;
        token
    }

    /// A new connection.
    pub async fn client(&self) -> Client {
        connect(self.running.grpc_addr).await.expect("the server takes connections")
    }

    /// Body of a page that must be there.
    pub async fn get(&self, path: &str) -> String {
        get(self.running.http_addr, path).await.expect("the page is there")
    }

    /// A JSON page that must be there.
    pub async fn get_json(&self, path: &str) -> serde_json::Value {
        serde_json::from_str(&self.get(path).await).expect("the page is JSON")
    }
}

/// A request with a token.
pub fn with_token<T>(token: &str, message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().expect("a token"));
    request
}

/// A new connection to a server.
///
/// # Errors
/// If it does not take connections.
pub async fn connect(grpc_addr: SocketAddr) -> anyhow::Result<Client> {
    let channel = Channel::from_shared(format!("http://{grpc_addr}"))?.connect().await?;
    Ok(SlamServiceClient::new(channel)
        .max_decoding_message_size(64 << 20)
        .max_encoding_message_size(256 << 20))
}

/// Body of a page.
///
/// # Errors
/// If it cannot be fetched, or its status is not a success.
pub async fn get(http_addr: SocketAddr, path: &str) -> anyhow::Result<String> {
    let client = HttpClient::builder(TokioExecutor::new()).build_http::<Empty<Bytes>>();
    let response = client.get(format!("http://{http_addr}{path}").parse()?).await?;
    let status = response.status();
    ensure!(status.is_success(), "{path}: {status}");
    let body = response.into_body().collect().await.context("the page ends early")?;
    Ok(String::from_utf8(body.to_bytes().into())?)
}
