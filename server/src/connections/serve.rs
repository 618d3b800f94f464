//! Takes connections and answers requests on them.

use super::body::{Answer, Timed};
use super::inflow::Inflow;
use super::io::Socket;
use super::metered::{Messages, Meter, Whole};
use super::refusal::Refusals;
use super::table::{Place, Table};
use super::tls::Certificates;
use crate::budget::Charges;
use crate::network::span;
use axum::Router;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

/// After accepting failed, as when there are no more files, this long passes before the next attempt.
const AFTER_FAILURE: Duration = Duration::from_millis(100);

/// A client that does not answer a ping for this long is gone, so that a phone that lost its network frees
/// its session.
const KEEPALIVE: Duration = Duration::from_secs(15);

/// Which of the two interfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interface {
    /// gRPC, over HTTP/2 alone.
    Grpc,
    /// REST, events and pages, over HTTP/1 and HTTP/2.
    Http,
}

/// Who is at the other end, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// The address.
    pub addr: SocketAddr,
    /// Whether the connection is encrypted.
    pub is_encrypted: bool,
}

/// What a port is opened with.
pub struct Opening {
    /// Where connections come in.
    pub listener: TcpListener,
    /// Encryption, if there is any.
    pub tls: Option<Arc<Certificates>>,
    /// Where connections are noted.
    pub table: Arc<Table>,
    /// What the bytes of requests are counted against.
    pub meter: Meter,
}

/// A port to serve.
pub struct Port {
    /// Where connections come in.
    pub listener: TcpListener,
    /// What is spoken.
    pub interface: Interface,
    /// Encryption, if there is any.
    pub tls: Option<Arc<Certificates>>,
    /// Where connections are noted.
    pub table: Arc<Table>,
    /// What the bytes of requests are counted against.
    pub meter: Meter,
    /// Requests for these paths may stand still in the middle of their body, and end by themselves in a
    /// shutdown.
    pub patient_paths: &'static [&'static str],
    /// Cancelled before the server stops: the connections there are then take no further requests, so that
    /// their clients make new ones, which a load balancer leads elsewhere. New ones are still served.
    pub leaving: CancellationToken,
}

/// Serves a port until `closing`, then lets what is under way end.
pub async fn serve(port: Port, router: Router, closing: CancellationToken) {
    let Port { listener, interface, tls, table, meter, patient_paths, leaving } = port;
    let refusals = Refusals::new();
    // Each connection keeps a sender, so that the channel ends when the last of them does.
    let (alive, mut all_gone) = mpsc::channel::<Infallible>(1);
    loop {
        let accepted = tokio::select! {
            biased;
            () = closing.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        let (stream, addr) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!("a connection cannot be taken: {error}");
                tokio::time::sleep(AFTER_FAILURE).await;
                continue;
            }
        };
        let place = match table.admit(addr.ip()) {
            Ok(place) => Arc::new(place),
            Err(full) => {
                tracing::debug!("a connection from {addr} was refused: {full}");
                // Encrypted, saying why would cost more than serving.
                if tls.is_none() {
                    refusals.say(stream, interface, full);
                }
                continue;
            }
        };
        let _ = stream.set_nodelay(true);
        let peer = Peer { addr, is_encrypted: tls.is_some() };
        let connection = Connection {
            interface,
            peer,
            place,
            inflow: Inflow::new(meter.budget.clone()),
            meter: meter.clone(),
            patient_paths,
            router: router.clone(),
            closing: closing.clone(),
            // Who comes afterwards found no other server.
            leaving: if leaving.is_cancelled() { CancellationToken::new() } else { leaving.clone() },
        };
        let (tls, alive) = (tls.clone(), alive.clone());
        tokio::spawn(async move {
            let _alive = alive;
            connection.run(stream, tls).await;
        });
    }
    drop((listener, alive));
    all_gone.recv().await;
}

struct Connection {
    interface: Interface,
    peer: Peer,
    place: Arc<Place>,
    inflow: Inflow,
    meter: Meter,
    patient_paths: &'static [&'static str],
    router: Router,
    closing: CancellationToken,
    leaving: CancellationToken,
}

impl Connection {
    async fn run(self, stream: TcpStream, tls: Option<Arc<Certificates>>) {
        let socket = Socket::new(stream, self.place.clone(), self.inflow.clone());
        let Some(certificates) = tls else { return self.answer(socket).await };
        let drop = self.place.activity().drop.clone();
        let encrypted = tokio::select! {
            encrypted = certificates.acceptor(self.interface).accept(socket) => encrypted,
            () = drop.cancelled() => return,
            () = self.closing.cancelled() => return,
        };
        match encrypted {
            Ok(stream) => self.answer(stream).await,
            Err(error) => tracing::debug!("{} does not encrypt as it should: {error}", self.peer.addr),
        }
    }

    async fn answer<S: AsyncRead + AsyncWrite + Send + Unpin + 'static>(self, stream: S) {
        let limits = self.place.activity();
        let (close, drop) = (limits.close.clone(), limits.drop.clone());
        let (place, closing, leaving) = (self.place.clone(), self.closing.clone(), self.leaving.clone());
        let builder = self.builder();
        let service = service_fn(move |request| self.respond(request));
        let connection = builder.serve_connection_with_upgrades(TokioIo::new(stream), service);
        tokio::pin!(connection);
        let mut is_ending = false;
        loop {
            tokio::select! {
                outcome = connection.as_mut() => {
                    if let Err(error) = outcome {
                        tracing::debug!("a connection broke: {error}");
                    }
                    // What may go on is what it was upgraded to.
                    place.upgraded();
                    return;
                }
                () = drop.cancelled() => return,
                () = any_of([&close, &closing, &leaving]), if !is_ending => {
                    is_ending = true;
                    connection.as_mut().graceful_shutdown();
                }
            }
        }
    }

    fn builder(&self) -> Builder<TokioExecutor> {
        let header_timeout = span(self.place.limits().header_timeout_s);
        let mut builder = Builder::new(TokioExecutor::new());
        builder.http1().timer(TokioTimer::new()).header_read_timeout(header_timeout);
        builder.http2().timer(TokioTimer::new()).keep_alive_interval(KEEPALIVE).keep_alive_timeout(KEEPALIVE);
        match self.interface {
            Interface::Grpc => builder.http2_only(),
            Interface::Http => builder,
        }
    }

    fn respond(
        &self,
        mut request: hyper::Request<Incoming>,
    ) -> impl Future<Output = Result<hyper::Response<Answer>, Infallible>> + use<> {
        let in_flight = self.place.begin();
        request.extensions_mut().insert(self.peer);
        request.extensions_mut().insert(self.inflow.clone());
        let is_patient = self.patient_paths.contains(&request.uri().path());
        let timeout = span(self.place.limits().body_timeout_s);
        let charges = Charges::default();
        // Whoever works off messages one by one gives their room back; the rest is kept until the answer
        // begins.
        request.extensions_mut().insert(charges.clone());
        let kept = (!is_patient).then(|| charges.clone());
        let (meter, interface, closing) = (self.meter.clone(), self.interface, self.closing.clone());
        let request = request.map(|body| match interface {
            Interface::Grpc if is_patient => Body::new(Messages::new(body, meter, charges, timeout)),
            Interface::Grpc => {
                let timed = Timed::new(body, timeout, closing);
                Body::new(Messages::new(timed, meter, charges, timeout))
            }
            Interface::Http => Body::new(Whole::new(Timed::new(body, timeout, closing), meter, charges)),
        });
        let answered = self.router.clone().oneshot(request);
        async move {
            let response = answered.await?;
            drop(kept);
            Ok(response.map(|body| Answer::new(body, in_flight)))
        }
    }
}

async fn any_of([a, b, c]: [&CancellationToken; 3]) {
    tokio::select! {
        () = a.cancelled() => {}
        () = b.cancelled() => {}
        () = c.cancelled() => {}
    }
}
