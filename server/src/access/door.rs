//! The door: what every request of both ports passes, and nothing else lets anybody in.

use super::keys::Keys;
use super::origin::Pages;
use super::passed::{self, Asked, Marks, Passed};
use super::rates::{Asker, RequestRates};
use super::rules::{self, Need};
use super::tickets::{Ticket, Tickets};
use super::{Caller, Role};
use crate::connections::{Interface, Peer, client_network, until};
use crate::error::{ApiError, ErrorCode};
use crate::network::{AccessConfig, QuotaConfig, span};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;
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
    /// None where the server is alone.
    marks: Option<Marks>,
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
        let secret = store.fleet_secret().await?;
        let marks = secret.as_deref().zip(store.own_name());
        let marks = marks.map(|(secret, own_name)| Marks::new(secret, own_name.to_owned()));
        let keys = Arc::new(Keys::new(store, quotas).await?);
        let tickets = Tickets::new(span(config.ticket_s), secret.as_deref())?;
        let rates = RequestRates::new(config.requests_per_s, config.request_burst);
        let pages = RwLock::new(Arc::new(Pages::new(&config.hosts, &config.cors_origins)));
        Ok(Arc::new(Self { config, keys, tickets, rates, pages, open: Caller::open(), marks }))
    }

    /// The tokens.
    pub fn keys(&self) -> &Arc<Keys> {
        &self.keys
    }

    /// What requests are marked with that are passed on; `None` where the server is alone.
    pub fn marks(&self) -> Option<&Marks> {
        self.marks.as_ref()
    }

    /// Notes of a request that another server passed on who asks.
    fn unmark(&self, request: &mut Request) {
        let asked = Asked { method: request.method(), uri: request.uri() };
        let Some((passed, peer)) = passed::read(self.marks.as_ref(), request.headers(), asked) else {
            return;
        };
        request.extensions_mut().insert(passed);
        if let Some(peer) = peer {
            request.extensions_mut().insert(peer);
        }
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
            // By which name the other server was called is not this one's to say.
            let is_proven = request.extensions().get::<Passed>().is_some_and(|passed| passed.is_proven);
            if interface == Interface::Http && !is_proven {
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
    door.access.unmark(&mut request);
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
        self.interface.refusal(error)
    }

    /// A body that ends with an error when its reader may read no more.
    fn until_revoked(&self, body: Body, gone: CancellationToken) -> Body {
        if http_body::Body::size_hint(&body).exact().is_some() {
            return body;
        }
        until(body, self.interface, async move {
            gone.cancelled().await;
            revoked()
        })
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
