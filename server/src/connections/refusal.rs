//! The answer to a connection that is not taken: its first request is told why, and that was all.

use super::serve::Interface;
use super::table::Full;
use crate::error::{ApiError, ErrorCode};
use axum::response::Response;
use hyper::body::Incoming;
use hyper::header::{CONNECTION, HeaderValue};
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{Notify, Semaphore};

/// Refusals that are being said at the same time; further connections are closed without a word.
const MAX_REFUSALS: usize = 64;

/// How long saying one may take, the client's request included.
const PATIENCE: Duration = Duration::from_secs(1);

/// Says why connections are not taken.
pub struct Refusals(Arc<Semaphore>);

impl Refusals {
    /// None is being said.
    pub fn new() -> Self {
        Self(Arc::new(Semaphore::new(MAX_REFUSALS)))
    }

    /// Says it and closes the connection.
    pub fn say(&self, stream: TcpStream, interface: Interface, full: Full) {
        let Ok(turn) = self.0.clone().try_acquire_owned() else { return };
        tokio::spawn(async move {
            let _turn = turn;
            let _ = tokio::time::timeout(PATIENCE, answer(stream, interface, full)).await;
        });
    }
}

async fn answer(stream: TcpStream, interface: Interface, full: Full) {
    let answered = Arc::new(Notify::new());
    let has_answered = answered.clone();
    let service = service_fn(move |_: hyper::Request<Incoming>| {
        has_answered.notify_one();
        async move { Ok::<_, Infallible>(refusal(interface, full)) }
    });
    let mut builder = Builder::new(TokioExecutor::new());
    if interface == Interface::Grpc {
        builder = builder.http2_only();
    }
    let connection = builder.serve_connection(TokioIo::new(stream), service);
    tokio::pin!(connection);
    tokio::select! {
        _ = connection.as_mut() => return,
        () = answered.notified() => connection.as_mut().graceful_shutdown(),
    }
    let _ = connection.await;
}

fn refusal(interface: Interface, full: Full) -> Response {
    let sentence = format!("{full}; try again later");
    let error = ApiError::new(ErrorCode::TooManyConnections, sentence).retry_after(Duration::from_secs(1));
    let mut response = interface.refusal(error);
    if interface == Interface::Http {
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    }
    response
}
