//! The HTTP skin: decode, call the service, encode.

mod assets;
mod conditional;
mod document;
mod events;
mod extract;
mod fleet;
mod frames;
mod graph;
mod keyframes;
mod lines;
mod localize;
mod map;
mod masks;
mod model;
mod motion;
mod operations;
mod place;
mod points;
mod primitives;
mod problem;
mod reference;
mod scale;
mod scene;
mod sessions;
mod stream;
mod system;
mod tickets;
mod trajectory;

use crate::access::{self, Access, Door};
use crate::connections::{self, Interface, Opening, Port};
use crate::relay::{self, Relay, RelayLayer};
use crate::service::Service;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, ETAG, IF_NONE_MATCH, LOCATION, RETRY_AFTER};
use axum::http::{HeaderName, Method};
use metrics_exporter_prometheus::PrometheusHandle;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower::util::option_layer;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::{Modify, OpenApi};
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouterExt};
use utoipa_axum::routes;

pub use crate::model::{Camera, Pose, State};
pub use assets::viewer_file;
pub use model::{Session, SessionPage};
pub use problem::{ProblemDetails, Violation};
pub use trajectory::{Format, TrajectoryWriter};

/// Largest request body but for images: requests are a calibration and a few options.
const MAX_BODY_BYTES: usize = 64 << 10;
/// Largest request with readings of motion sensors: 10,000 lines of two hundred letters.
const MAX_MOTION_BYTES: usize = 2 << 20;
/// Largest request with reference positions: 100 000 rows of a hundred letters.
const MAX_POSITIONS_BYTES: usize = 10 << 20;

/// Observations are folded together this often, so that they do not pile up when nobody reads the metrics.
const METRICS_FOLDED_EVERY: Duration = Duration::from_secs(5);

/// Browsers need not ask again whether a foreign page may for this long.
const CORS_REMEMBERED: Duration = Duration::from_secs(600);

/// What gRPC-Web has in a request, and in an answer.
const GRPC_WEB_SENT: [HeaderName; 3] = [
    HeaderName::from_static("x-grpc-web"),
    HeaderName::from_static("x-user-agent"),
    HeaderName::from_static("grpc-timeout"),
];
const GRPC_WEB_ANSWERED: [HeaderName; 3] = [
    HeaderName::from_static("grpc-status"),
    HeaderName::from_static("grpc-message"),
    HeaderName::from_static("grpc-status-details-bin"),
];

/// What the handlers share.
#[derive(Clone)]
pub struct App {
    /// The service.
    pub service: Arc<Service>,
    /// The process's metrics.
    pub metrics: PrometheusHandle,
}

impl App {
    /// The interface of a service, with the metrics of this process.
    pub fn new(service: Arc<Service>) -> Self {
        Self { service, metrics: crate::telemetry::metrics() }
    }
}

#[derive(OpenApi)]
#[openapi(modifiers(&BearerTokens), security((), ("token" = [])), info(
    title = "monoslam",
    description = "Sessions, trajectories and maps of a monocular SLAM service. Frames are streamed over gRPC. \
                   Poses are world_from_camera, quaternions x y z w; lengths are map units unless a session's \
                   scale says metric."
))]
struct Document;

/// Tokens are sent as RFC 6750 has it; a server without tokens needs none.
struct BearerTokens;

impl Modify for BearerTokens {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        let components = document.components.get_or_insert_with(Default::default);
        components.add_security_scheme("token", scheme);
    }
}

/// Every path of the interface with its document. An image may have `max_image_bytes`.
fn api(max_image_bytes: usize) -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(sessions::list, sessions::create))
        .routes(routes!(sessions::get, sessions::update, sessions::delete))
        .routes(routes!(scale::scale).layer(DefaultBodyLimit::max(MAX_POSITIONS_BYTES)))
        .routes(routes!(operations::optimize))
        .routes(routes!(operations::merge))
        .routes(routes!(operations::list))
        .routes(routes!(operations::get))
        .routes(routes!(operations::cancel))
        .routes(routes!(masks::get, masks::put, masks::delete).layer(DefaultBodyLimit::max(max_image_bytes)))
        .routes(routes!(motion::add, motion::get).layer(DefaultBodyLimit::max(MAX_MOTION_BYTES)))
        .routes(routes!(scene::picture))
        .routes(routes!(events::events))
        .routes(routes!(stream::stream))
        .routes(routes!(frames::image))
        .routes(routes!(frames::observed))
        .routes(routes!(trajectory::trajectory))
        .routes(routes!(keyframes::list))
        .routes(routes!(keyframes::get))
        .routes(routes!(keyframes::image))
        .routes(routes!(keyframes::observed))
        .routes(routes!(points::list))
        .routes(routes!(lines::list))
        .routes(routes!(primitives::list))
        .routes(routes!(primitives::get))
        .routes(routes!(graph::graph))
        .routes(routes!(scene::scene))
        .routes(routes!(map::map))
        .routes(routes!(localize::localize).layer(DefaultBodyLimit::max(max_image_bytes)))
        .routes(routes!(localize::localize_among).layer(DefaultBodyLimit::max(max_image_bytes)))
        .routes(routes!(tickets::issue, tickets::forget))
        .routes(routes!(fleet::fleet))
        .routes(routes!(system::healthz))
        .routes(routes!(system::readyz))
        .routes(routes!(system::metrics))
}

/// The whole interface, without a socket. Behind its door, requests that come over no connection are this
/// process's own.
pub fn router(app: App) -> Router {
    router_with(app, Router::new(), None)
}

/// As [`router`], with more behind the same door, and passing on what another server must answer.
fn router_with(app: App, more: Router, relay: Option<Relay>) -> Router {
    let access = app.service.access().clone();
    // Where no foreign page is let in, nothing is said about them.
    let cors = option_layer((!access.config().cors_origins.is_empty()).then(|| cors(access.clone())));
    let relay = relay.map(|relay| RelayLayer { relay, interface: Interface::Http });
    let relay = relay.map(|layer| axum::middleware::from_fn_with_state(layer, relay::pass));
    let door = Door { access, interface: Interface::Http };
    let max_image_bytes = app.service.config().limits.max_message_bytes;
    let (router, mut document) = api(max_image_bytes).split_for_parts();
    document::complete(&mut document);
    let document = Arc::new(document);
    router
        .route(
            "/openapi.json",
            axum::routing::get(move || async move { axum::Json(document.as_ref().clone()) }),
        )
        .route("/", axum::routing::get(assets::page))
        .route("/capture", axum::routing::get(assets::capture))
        .route("/favicon.svg", axum::routing::get(assets::icon))
        .route("/assets/{name}", axum::routing::get(assets::asset))
        .merge(reference::routes())
        .with_state(app.clone())
        .merge(more.reset_fallback())
        .fallback(problem::not_found)
        .method_not_allowed_fallback(problem::method_not_allowed)
        .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
        .layer(axum::middleware::from_fn_with_state(app.clone(), conditional::answer))
        .layer(option_layer(relay))
        .layer(axum::middleware::from_fn_with_state(door, access::check))
        .layer(axum::middleware::from_fn_with_state(Interface::Http, connections::trace))
        // Images and events go as they are.
        .layer(CompressionLayer::new())
        .layer(cors)
        .layer(CatchPanicLayer::custom(panicked))
}

/// Pages of the origins that are allowed may use the interface, with tokens and without cookies.
fn cors(access: Arc<Access>) -> CorsLayer {
    CorsLayer::new()
        .allow_origin(AllowOrigin::predicate(move |origin, _| access.allows_origin(origin)))
        .allow_methods([Method::GET, Method::POST, Method::PATCH, Method::DELETE])
        .allow_headers(Vec::from_iter(
            [AUTHORIZATION, CONTENT_TYPE, IF_NONE_MATCH].into_iter().chain(GRPC_WEB_SENT),
        ))
        .expose_headers(Vec::from_iter([ETAG, LOCATION, RETRY_AFTER].into_iter().chain(GRPC_WEB_ANSWERED)))
        .max_age(CORS_REMEMBERED)
}

/// The OpenAPI document.
pub fn openapi() -> utoipa::openapi::OpenApi {
    let mut document = api(0).split_for_parts().1;
    document::complete(&mut document);
    document
}

/// Serves HTTP, and `calls` beside it, until `closing`, then lets what is under way end.
///
/// # Errors
/// None so far.
pub(crate) async fn serve(
    app: App,
    calls: Router,
    relay: Relay,
    opening: Opening,
    closing: CancellationToken,
) -> anyhow::Result<()> {
    tokio::spawn(fold_metrics(app.metrics.clone(), closing.clone()));
    let Opening { listener, tls, table, meter } = opening;
    let leaving = app.service.registry().leaving();
    let port = Port { listener, interface: Interface::Http, tls, table, meter, patient_paths: &[], leaving };
    connections::serve(port, router_with(app, calls, Some(relay)), closing).await;
    Ok(())
}

/// The exporter keeps every observation until it is asked to fold them together.
async fn fold_metrics(metrics: PrometheusHandle, closing: CancellationToken) {
    while tokio::time::timeout(METRICS_FOLDED_EVERY, closing.cancelled()).await.is_err() {
        metrics.run_upkeep();
    }
}

fn panicked(_: Box<dyn std::any::Any + Send>) -> axum::response::Response {
    axum::response::IntoResponse::into_response(crate::error::ApiError::internal("a handler panicked"))
}
