//! Passes requests on to the server of the fleet that must answer them, so that any server can be asked.
//!
//! What is stored is answered by whoever is asked. What needs the server that works with a session is passed
//! on to it: streams of frames, watching, changes, and what is in its memory alone. [`pass`] stands behind
//! the door of both ports. It finds out which session a request means (`target`), who has it (`placement`),
//! and lets the request through, or sends it there and its answer back, frame by frame (`forward`). It knows
//! nothing of what requests mean besides.
//!
//! A request is passed on once: who gets one with a mark ([`crate::access::Passed`]) answers it or refuses it
//! with `OWNED_ELSEWHERE`.

mod dial;
mod forward;
mod placement;
mod target;

use crate::access::{Caller, Passed};
use crate::connections::{Interface, until};
use crate::error::{ApiError, ErrorCode};
use crate::network::span;
use crate::service::Service;
use crate::session::SessionId;
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::http::HeaderValue;
use axum::http::header::CONTENT_TYPE;
use axum::middleware::Next;
use axum::response::Response;
use dial::Dialer;
use futures_util::{Stream, StreamExt};
use http_body::Frame;
use http_body_util::{BodyStream, StreamBody};
use placement::Place;
use std::sync::Arc;
use std::time::Duration;
use store::{Owner, Store};
use target::{Need, Sought, Target};
use tokio_util::sync::CancellationToken;

/// While an answer goes on, it is asked this often who has the session: a twentieth of the default lease. A
/// question costs the database some 0.1 ms.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// How long a stream that is not opened yet is waited with before its answer begins. Most programs open it at
/// once; others wait for the answer first.
const OPENING_PATIENCE: Duration = Duration::from_millis(100);

/// When the server that has a session can be asked again that could not be reached.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// See the module's documentation. Clones share everything.
#[derive(Clone)]
pub struct Relay(Arc<Inner>);

struct Inner {
    service: Arc<Service>,
    store: Store,
    dialer: Dialer,
    max_message_bytes: usize,
    /// Cancelled when answers that are under way must end.
    closing: CancellationToken,
}

/// What stands behind one port's door.
#[derive(Clone)]
pub struct RelayLayer {
    /// Passes on.
    pub relay: Relay,
    /// What is spoken.
    pub interface: Interface,
}

impl Relay {
    /// Passes on for a service over this database, as configured. Answers that are under way end at
    /// `closing`.
    ///
    /// # Errors
    /// If the certificates of the fleet cannot be used.
    pub fn new(service: Arc<Service>, store: Store, closing: CancellationToken) -> anyhow::Result<Self> {
        let config = service.config();
        let (dialer, max_message_bytes) = (Dialer::new(&config.fleet)?, config.limits.max_message_bytes);
        Ok(Self(Arc::new(Inner { service, store, dialer, max_message_bytes, closing })))
    }

    /// Whether there may be other servers, and requests are passed on to them.
    fn is_used(&self) -> bool {
        self.0.store.own_name().is_some() && self.0.service.config().fleet.pass_on
    }
}

/// Lets a request through to this server's own answer, or passes it on to the server that must answer it.
pub async fn pass(State(layer): State<RelayLayer>, request: Request, next: Next) -> Response {
    let caller = request.extensions().get::<Caller>().cloned();
    let Some(caller) = caller.filter(|_| layer.relay.is_used()) else { return next.run(request).await };
    match layer.target(request, OPENING_PATIENCE).await {
        Sought::Found(target, request) => layer.answer(&caller, target, request, next).await,
        Sought::Unopened(request) => layer.answer_later(caller, request, next),
    }
}

impl RelayLayer {
    async fn target(&self, request: Request, patience: Duration) -> Sought {
        target::of(request, self.interface, self.relay.0.max_message_bytes, patience).await
    }

    async fn answer(
        &self,
        caller: &Caller,
        target: Option<Target>,
        request: Request,
        next: Next,
    ) -> Response {
        let (relay, interface) = (&self.relay, self.interface);
        let is_passed = request.extensions().get::<Passed>().is_some();
        let Some(Target { need, name }) = target else { return next.run(request).await };
        if need == Need::Operation {
            return match relay.server_of_operation(&name).await.filter(|_| !is_passed) {
                Some(server) => relay.send(server, None, need, interface, request).await,
                None => next.run(request).await,
            };
        }
        // What is wrong with a name is said by who answers.
        let Ok(id) = caller.session(&name, "session_id") else { return next.run(request).await };
        let place = if is_passed { Place::Here } else { relay.place(&id, need).await };
        match place {
            Place::There(server) => relay.send(server, Some(id), need, interface, request).await,
            Place::Here if need == Need::Watch => relay.watch_here(&id, interface, request, next).await,
            Place::Here => next.run(request).await,
        }
    }

    /// The answer to a stream whose client waits for it to begin before it says which session is meant.
    fn answer_later(self, caller: Caller, mut request: Request, next: Next) -> Response {
        // How messages are compressed would have to be said now, and is another server's choice.
        request.headers_mut().remove("grpc-accept-encoding");
        let patience = span(self.relay.0.service.config().connections.body_timeout_s);
        let answering = async move {
            let closing = self.relay.0.closing.clone();
            let sought = tokio::select! {
                sought = self.target(request, patience) => sought,
                () = closing.cancelled() => return self.interface.refusal(going()),
            };
            let (target, request) = match sought {
                Sought::Found(target, request) => (target, request),
                Sought::Unopened(request) => (None, request),
            };
            self.answer(&caller, target, request, next).await
        };
        let frames = futures_util::stream::once(answering).flat_map(frames_of);
        let mut response = Response::new(Body::new(StreamBody::new(frames)));
        response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("application/grpc"));
        response
    }
}

/// The frames of a call's answer whose headers were sent already. A refusal has its status there.
fn frames_of(response: Response) -> impl Stream<Item = Result<Frame<Bytes>, axum::Error>> {
    let (parts, body) = response.into_parts();
    let status = parts.headers.contains_key("grpc-status").then(|| Ok(Frame::trailers(parts.headers)));
    futures_util::stream::iter(status).chain(BodyStream::new(body))
}

impl Relay {
    /// This server's own watch of a session, until another server works with it: what happens then is told
    /// there.
    async fn watch_here(
        &self,
        id: &SessionId,
        interface: Interface,
        request: Request,
        next: Next,
    ) -> Response {
        let (relay, id) = (self.clone(), id.clone());
        let moved = async move { relay.moved(&id, None).await };
        next.run(request).await.map(|body| until(body, interface, moved))
    }

    async fn send(
        &self,
        server: Owner,
        id: Option<SessionId>,
        need: Need,
        interface: Interface,
        request: Request,
    ) -> Response {
        let inner = &self.0;
        let forward = forward::Forward {
            dialer: &inner.dialer,
            marks: inner.service.access().marks(),
            server: &server,
            interface,
        };
        let ending = self.ending(server.clone(), id, need);
        let outcome = forward.send(request, ending).await;
        let label = if outcome.is_ok() { "answered" } else { "failed" };
        metrics::counter!("monoslam_requests_passed_on_total", "outcome" => label).increment(1);
        outcome.unwrap_or_else(|error| interface.refusal(error))
    }

    /// Says why an answer from another server must end, once it must.
    fn ending(
        &self,
        server: Owner,
        id: Option<SessionId>,
        need: Need,
    ) -> impl Future<Output = ApiError> + Send + 'static {
        let relay = self.clone();
        async move {
            let moved = async {
                match &id {
                    Some(id) => relay.moved(id, Some((&server, need))).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                error = moved => error,
                () = relay.0.closing.cancelled() => going(),
            }
        }
    }

    /// Waits until a session's answers come from elsewhere than from `there`, or, without it, than from here.
    async fn moved(&self, id: &SessionId, there: Option<(&Owner, Need)>) -> ApiError {
        // A server that was chosen for nobody's session takes it in a moment.
        let mut has_had_it = false;
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            if there.is_none() && self.0.store.keeps(id.as_str()) {
                continue;
            }
            // While nobody can be asked, nobody can take it either.
            let Ok(holder) = self.0.store.holder(id.as_str()).await else { continue };
            let is_same = match (&holder, there) {
                (Some(holder), Some((server, _))) => holder.server.name == server.name,
                (Some(holder), None) => Some(holder.server.name.as_str()) == self.0.store.own_name(),
                // Nobody's: it can be watched where it was, but frames are lost there.
                (None, Some((_, Need::Stream))) => !has_had_it,
                (None, _) => true,
            };
            has_had_it |= holder.is_some();
            if !is_same {
                let sentence = format!("session {id} is another server's now; ask again to go on there");
                return ApiError::new(ErrorCode::LeaseLost, sentence).retry_after(Duration::ZERO);
            }
        }
    }
}

/// This server stops, and what it passes on ends before.
fn going() -> ApiError {
    let sentence = "the server that passes this on is shutting down; reconnect and go on from next_sequence";
    ApiError::new(ErrorCode::ShuttingDown, sentence)
}

/// Another server that must answer cannot be reached.
fn unreachable(server: &Owner, interface: Interface, cause: &dyn std::fmt::Display) -> ApiError {
    let url = if interface == Interface::Grpc { &server.grpc_url } else { &server.http_url };
    tracing::warn!(server = server.name, "a request cannot be passed on to {url}: {cause}");
    let sentence = format!(
        "another server works with the session and cannot be reached now, at {url}; try again: it is passed on, or \
         another server takes the session, within seconds"
    );
    ApiError::new(ErrorCode::OwnerUnreachable, sentence).retry_after(RETRY_AFTER)
}
