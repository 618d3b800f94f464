//! The door: what every request of both ports passes, and nothing else lets anybody in.

use super::keys::Keys;
use super::origin::Pages;
use super::rates::{Asker, RequestRates};
use super::rules::{self, Need};
use super::tickets::{Ticket, Tickets};
use super::{Caller, Role};
use crate::connections::{Interface, Peer, client_network};
use crate::error::{ApiError, ErrorCode};
use crate::network::{AccessConfig, QuotaConfig, span};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use http_body::Frame;
use http_body_util::{BodyStream, StreamBody};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use store::Store;
use tokio_util::sync::CancellationToken;

/// How often callers are forgotten who have not asked lately.
const FORGETTING_EVERY: Duration = Duration::from_secs(60);

/// Who may do what; the same for both ports.
pub struct Access {
    config: AccessConfig,
    keys: Arc<Keys>,
    tickets: Tickets,
    rates: RequestRates,
    pages: RwLock<Arc<Pages>>,
    open: Caller,
}

/// The door of one port.
#[derive(Clone)]
pub struct Door {
    /// What is decided by.
    pub access: Arc<Access>,
    /// The port's interface, in whose words is refused.
    pub interface: Interface,
}

impl Access {
    /// As configured, with the tokens of a database.
    ///
    /// # Errors
    /// If the database cannot be read, or the system gives no random numbers.
    pub async fn new(config: AccessConfig, quotas: QuotaConfig, store: Store) -> anyhow::Result<Arc<Self>> {
        let keys = Arc::new(Keys::new(store, quotas).await?);
        let tickets = Tickets::new(span(config.ticket_s))?;
        let rates = RequestRates::new(config.requests_per_s, config.request_burst);
        let pages = RwLock::new(Arc::new(Pages::new(&config.hosts, &config.cors_origins)));
        Ok(Arc::new(Self { config, keys, tickets, rates, pages, open: Caller::open() }))
    }

    /// The tokens.
    pub fn keys(&self) -> &Arc<Keys> {
        &self.keys
    }

    /// Takes over which pages may ask, and what each token may use, from a changed configuration.
    pub fn reconfigure(&self, config: &AccessConfig, quotas: &QuotaConfig) {
        let pages = Arc::new(Pages::new(&config.hosts, &config.cors_origins));
        *self.pages.write().unwrap_or_else(PoisonError::into_inner) = pages;
        self.keys.set_quotas(quotas);
    }

    /// Whether pages of this origin may use the interface.
    pub fn allows_origin(&self, origin: &HeaderValue) -> bool {
        origin.to_str().is_ok_and(|origin| self.pages().allows(origin))
    }

    fn pages(&self) -> Arc<Pages> {
        self.pages.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The configuration that the server started with.
    pub fn config(&self) -> &AccessConfig {
        &self.config
    }

    /// A ticket for the token that a request brings; `None` without a token.
    pub fn ticket(&self, headers: &HeaderMap) -> Option<Ticket> {
        Some(self.tickets.issue(self.keys.number(bearer(headers)?)?))
    }

    /// Notices new and revoked tokens, until `closing`.
    pub async fn look_after(self: Arc<Self>, closing: CancellationToken) {
        let refreshing = self.keys.clone().look_after(span(self.config.refresh_s), closing.clone());
        let forgetting = async {
            while tokio::time::timeout(FORGETTING_EVERY, closing.cancelled()).await.is_err() {
                self.rates.forget_idle();
            }
        };
        tokio::join!(refreshing, forgetting);
    }

    /// Who asks.
    fn identify(&self, request: &Request, interface: Interface) -> Result<Caller, ApiError> {
        if let Some(token) = bearer(request.headers()) {
            let unknown = "the token is not known to this server, has run out, or was revoked";
            return self.keys.find(token).ok_or_else(|| unauthenticated(unknown));
        }
        let is_reading = matches!(*request.method(), Method::GET | Method::HEAD);
        if interface == Interface::Http
            && is_reading
            && let Some(caller) = self.tickets.of_request(request.headers(), request.uri(), &self.keys)
        {
            return Ok(caller);
        }
        if self.is_open_to(request) || (self.keys.is_open() && self.config.insecure) {
            if interface == Interface::Http {
                self.pages().check_host(request.headers(), request.uri())?;
            }
            return Ok(self.open.clone());
        }
        let sentence = "a token is needed: send it as `authorization: Bearer …`, or give the programs --token or \
                        MONOSLAM_TOKEN; whoever runs the server makes one with `monoslam-server token create`";
        Err(unauthenticated(sentence))
    }

    /// Whether a request comes from this machine while there are no tokens.
    fn is_open_to(&self, request: &Request) -> bool {
        let peer = request.extensions().get::<Peer>();
        // Without a peer it is this process that asks.
        self.keys.is_open() && peer.is_none_or(|peer| peer.addr.ip().to_canonical().is_loopback())
    }

    fn admit(&self, request: &Request, interface: Interface) -> Result<Option<Caller>, ApiError> {
        let (method, path) = (request.method(), request.uri().path());
        let need = match interface {
            Interface::Grpc => rules::of_call(path),
            Interface::Http => rules::of_route(method, path),
        };
        let role = match need {
            Need::Metrics if self.config.public_metrics => None,
            Need::Nothing => None,
            Need::Metrics => Some(Role::Admin),
            Need::Role(role) => Some(role),
        };
        let address = request.extensions().get::<Peer>().map(|peer| client_network(peer.addr.ip()));
        let Some(role) = role else {
            self.rates.count(&Asker::Address(address))?;
            return Ok(None);
        };
        let caller = match self.identify(request, interface) {
            Ok(caller) => caller,
            Err(error) => {
                self.rates.count(&Asker::Address(address))?;
                return Err(error);
            }
        };
        // This machine is not kept from its own server.
        if !self.is_open_to(request) {
            self.rates.count(&Asker::Token(caller.name().to_owned()))?;
        }
        if interface == Interface::Http && rules::is_changing(method, path) {
            self.pages().check_origin(request.headers(), request.uri())?;
        }
        if caller.role() < role {
            let sentence = format!(
                "this needs a token with the role {}, and the role of {} is {}",
                role.name(),
                caller.name(),
                caller.role().name()
            );
            return Err(ApiError::new(ErrorCode::Forbidden, sentence));
        }
        Ok(Some(caller))
    }
}

/// Lets a request through with its [`Caller`], or refuses it in the words of the port. An answer that is
/// still under way when the caller's token is revoked ends there.
pub async fn check(State(door): State<Door>, mut request: Request, next: Next) -> Response {
    let caller = match door.access.admit(&request, door.interface) {
        Ok(caller) => caller,
        Err(error) => return door.refusal(error),
    };
    let Some(caller) = caller else { return next.run(request).await };
    request.extensions_mut().insert(caller.clone());
    let response = next.run(request).await;
    if caller.revoked().is_cancelled() {
        return door.refusal(revoked());
    }
    response.map(|body| door.until_revoked(body, caller.revoked().clone()))
}

impl Door {
    fn refusal(&self, error: ApiError) -> Response {
        metrics::counter!("monoslam_requests_refused_total", "code" => error.code.name()).increment(1);
        match self.interface {
            Interface::Http => error.into_response(),
            Interface::Grpc => tonic::Status::from(error).into_http(),
        }
    }

    /// A body that ends with an error when its reader may read no more.
    fn until_revoked(&self, body: Body, gone: CancellationToken) -> Body {
        if http_body::Body::is_end_stream(&body) || http_body::Body::size_hint(&body).exact().is_some() {
            return body;
        }
        let interface = self.interface;
        let last = async move {
            match interface {
                Interface::Http => Err(axum::Error::new(revoked())),
                Interface::Grpc => {
                    let mut trailers = HeaderMap::new();
                    tonic::Status::from(revoked()).add_header(&mut trailers).map_err(axum::Error::new)?;
                    Ok(Frame::trailers(trailers))
                }
            }
        };
        let rest = BodyStream::new(body).take_until(gone.clone().cancelled_owned());
        let end = futures_util::stream::once(last).filter(move |_| {
            let is_gone = gone.is_cancelled();
            async move { is_gone }
        });
        Body::new(StreamBody::new(rest.chain(end)))
    }
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    let text = headers.get(AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = text.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn unauthenticated(sentence: &str) -> ApiError {
    ApiError::new(ErrorCode::Unauthenticated, sentence)
}

fn revoked() -> ApiError {
    unauthenticated("the token has run out or was revoked")
}
