//! Sends one request to another server and its answer back, frame by frame: each side is read only as fast as
//! the other takes it, by the flow control of HTTP/2 and of TCP.

use super::dial::{Dialed, Dialer};
use super::unreachable;
use crate::access::{Asked, Marks};
use crate::budget::Charges;
use crate::connections::{Interface, Peer, until};
use crate::error::ApiError;
use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{
    CONNECTION, EXPECT, HOST, PROXY_AUTHENTICATE, PROXY_AUTHORIZATION, TE, TRAILER, TRANSFER_ENCODING,
    UPGRADE,
};
use axum::http::request::Parts;
use axum::http::uri::PathAndQuery;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, Version};
use axum::response::Response;
use futures_util::StreamExt;
use http_body_util::{BodyExt, BodyStream, StreamBody};
use hyper::body::Incoming;
use hyper::client::conn::{http1, http2};
use hyper::upgrade::OnUpgrade;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use std::any::Any;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;
use store::Owner;
use tokio::task::JoinHandle;

/// What concerns one connection alone [RFC 9110, 7.6.1].
const OF_CONNECTION: [HeaderName; 9] = [
    CONNECTION,
    HeaderName::from_static("keep-alive"),
    HeaderName::from_static("proxy-connection"),
    PROXY_AUTHENTICATE,
    PROXY_AUTHORIZATION,
    TE,
    TRAILER,
    TRANSFER_ENCODING,
    UPGRADE,
];

/// What of an answer may wait here for a client that does not read, and of a request for a server that does
/// not: a few frames' answers, and an image. The rest waits where it comes from.
const WINDOW_BYTES: u32 = 256 << 10;

/// A server that stands still is noticed after this long; by then another may have its sessions.
const KEEPALIVE: Duration = Duration::from_secs(5);

/// Sends a request to a server.
pub struct Forward<'a> {
    /// Connects.
    pub dialer: &'a Dialer,
    /// What passed requests are marked with.
    pub marks: Option<&'a Marks>,
    /// The server.
    pub server: &'a Owner,
    /// What is spoken.
    pub interface: Interface,
}

/// A connection and the task that drives it; dropping it ends both.
struct Driver {
    task: JoinHandle<()>,
    /// Kept: a connection that nobody can send on any more may end.
    _sender: Box<dyn Any + Send>,
}

impl Drop for Driver {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Forward<'_> {
    /// Sends a request and answers with what the server answers, until `ending` says why not.
    ///
    /// # Errors
    /// If the server cannot be reached, or `ending` comes before the answer begins.
    pub async fn send(
        &self,
        request: Request,
        ending: impl Future<Output = ApiError> + Send + 'static,
    ) -> Result<Response, ApiError> {
        let (interface, server) = (self.interface, self.server);
        let url = if interface == Interface::Grpc { &server.grpc_url } else { &server.http_url };
        let dialed = self.dialer.dial(url, interface).await;
        let dialed = dialed.map_err(|error| unreachable(server, interface, &error))?;
        let (mut parts, body) = request.into_parts();
        let upgrade = parts.extensions.remove::<OnUpgrade>();
        let request = self.rewritten(parts, body, &dialed);
        let mut ending = Box::pin(ending);
        let answering = async {
            match interface {
                Interface::Grpc => over_http2(dialed, request).await,
                Interface::Http => over_http1(dialed, request).await,
            }
        };
        let (response, driver) = tokio::select! {
            answered = answering => answered.map_err(|error| unreachable(server, interface, &error))?,
            error = &mut ending => return Err(error),
        };
        if response.status() == StatusCode::SWITCHING_PROTOCOLS {
            return Ok(switched(response, driver, upgrade, ending));
        }
        let server = server.clone();
        let mut response = response.map(|body| {
            let frames = BodyStream::new(body).map(move |frame| {
                // The connection lasts as long as its answer is read.
                let _open = &driver;
                frame.or_else(|error| interface.last_frame(unreachable(&server, interface, &error)))
            });
            until(Body::new(StreamBody::new(frames)), interface, ending)
        });
        remove_those_of_connection(response.headers_mut());
        Ok(response)
    }

    /// The request as the other server gets it.
    fn rewritten(&self, parts: Parts, body: Body, dialed: &Dialed) -> Request {
        let Parts { method, uri, mut headers, extensions, .. } = parts;
        let upgrade = headers.get(UPGRADE).filter(|_| self.interface == Interface::Http).cloned();
        remove_those_of_connection(&mut headers);
        headers.remove(EXPECT);
        if let Some(protocol) = upgrade {
            headers.insert(UPGRADE, protocol);
            headers.insert(CONNECTION, HeaderValue::from_static("upgrade"));
        }
        // Without a connection it is this process that asks.
        let here = Peer { addr: SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), is_encrypted: false };
        let peer = extensions.get::<Peer>().copied().unwrap_or(here);
        let path = uri.path_and_query().cloned().unwrap_or_else(|| PathAndQuery::from_static("/"));
        let path = Uri::from(path);
        if let Some(marks) = self.marks {
            let asked = Asked { method: &method, uri: &path };
            let (name, mark) = marks.mark(&self.server.name, peer, asked);
            headers.insert(name, mark);
        }
        let (uri, version) = match self.interface {
            Interface::Grpc => {
                headers.insert(TE, HeaderValue::from_static("trailers"));
                headers.remove(HOST);
                let whole = format!("{}://{}{path}", dialed.scheme, dialed.authority);
                (whole.parse().unwrap_or(path), Version::HTTP_2)
            }
            Interface::Http => {
                // By which name the caller called: pages and cookies are told apart by it.
                let called =
                    uri.authority().map_or(dialed.authority.as_str(), |authority| authority.as_str());
                if let (false, Ok(host)) = (headers.contains_key(HOST), HeaderValue::try_from(called)) {
                    headers.insert(HOST, host);
                }
                (path, Version::HTTP_11)
            }
        };
        let mut request = Request::new(passed_body(body, extensions.get::<Charges>().cloned()));
        *request.method_mut() = method;
        *request.uri_mut() = uri;
        *request.version_mut() = version;
        *request.headers_mut() = headers;
        request
    }
}

/// A body whose messages' room is free again once they were handed on.
fn passed_body(body: Body, charges: Option<Charges>) -> Body {
    let Some(charges) = charges else { return body };
    if http_body::Body::is_end_stream(&body) {
        return body;
    }
    Body::new(body.map_frame(move |frame| {
        while charges.pop().is_some() {}
        frame
    }))
}

async fn over_http1(
    dialed: Dialed,
    request: Request,
) -> Result<(hyper::Response<Incoming>, Driver), hyper::Error> {
    let (mut sender, connection) = http1::handshake(dialed.socket).await?;
    let connection = connection.with_upgrades();
    let task = tokio::spawn(driven(connection));
    let sent = sender.send_request(request);
    // From here on, whoever gives up the request ends the connection.
    let driver = Driver { task, _sender: Box::new(sender) };
    Ok((sent.await?, driver))
}

async fn over_http2(
    dialed: Dialed,
    request: Request,
) -> Result<(hyper::Response<Incoming>, Driver), hyper::Error> {
    let (mut sender, connection) = http2::Builder::new(TokioExecutor::new())
        .timer(TokioTimer::new())
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
        .max_send_buf_size(WINDOW_BYTES as usize)
        .keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE)
        .handshake(dialed.socket)
        .await?;
    let task = tokio::spawn(driven(connection));
    let sent = sender.send_request(request);
    // From here on, whoever gives up the request ends the connection.
    let driver = Driver { task, _sender: Box::new(sender) };
    Ok((sent.await?, driver))
}

async fn driven(connection: impl Future<Output = Result<(), hyper::Error>>) {
    if let Err(error) = connection.await {
        tracing::debug!("a connection to another server broke: {error}");
    }
}

/// An answer that goes on in another protocol: what either side sends is copied to the other until one ends,
/// or
/// `ending` comes.
fn switched(
    mut response: hyper::Response<Incoming>,
    driver: Driver,
    client: Option<OnUpgrade>,
    ending: impl Future<Output = ApiError> + Send + 'static,
) -> Response {
    let server = hyper::upgrade::on(&mut response);
    if let Some(client) = client {
        tokio::spawn(async move {
            let _open = driver;
            let Ok((client, server)) = tokio::try_join!(client, server) else { return };
            let (mut client, mut server) = (TokioIo::new(client), TokioIo::new(server));
            tokio::select! {
                _ = tokio::io::copy_bidirectional(&mut client, &mut server) => {}
                _ = ending => {}
            }
        });
    }
    response.map(|_| Body::empty())
}

fn remove_those_of_connection(headers: &mut HeaderMap) {
    let named: Vec<HeaderName> = headers
        .get_all(CONNECTION)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|names| names.split(','))
        .filter_map(|name| name.trim().parse().ok())
        .collect();
    for name in OF_CONNECTION.iter().chain(&named) {
        headers.remove(name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_concerns_one_connection_is_not_passed_on() {
        let mut headers = HeaderMap::new();
        headers.insert(CONNECTION, HeaderValue::from_static("Keep-Alive, X-Hop"));
        headers.insert("x-hop", HeaderValue::from_static("1"));
        headers.insert("keep-alive", HeaderValue::from_static("timeout=5"));
        headers.insert(TRANSFER_ENCODING, HeaderValue::from_static("chunked"));
        headers.insert("authorization", HeaderValue::from_static("Bearer x"));
        remove_those_of_connection(&mut headers);
        assert_eq!(headers.keys().map(HeaderName::as_str).collect::<Vec<_>>(), ["authorization"]);
    }
}
