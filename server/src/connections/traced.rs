//! A span of each request, for who traces the server.

use super::Interface;
use crate::traces::TARGET;
use axum::extract::{MatchedPath, Request, State};
use axum::http::HeaderMap;
use axum::middleware::Next;
use axum::response::Response;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry_sdk::propagation::TraceContextPropagator;
use tracing::{Instrument, Span, field};
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// A span of each request, from its arrival until its answer begins. It belongs to the trace that the request
/// names (W3C `traceparent`), if it names one.
pub async fn trace(State(interface): State<Interface>, request: Request, next: Next) -> Response {
    let (method, path) = (request.method(), request.uri().path());
    let route = request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str);
    let span = match interface {
        Interface::Http => tracing::info_span!(
            target: TARGET, parent: None, "request", otel.name = format!("{method} {route}"), otel.kind = "server",
            http.request.method = method.as_str(), http.route = route, url.path = path,
            http.response.status_code = field::Empty, otel.status_code = field::Empty
        ),
        Interface::Grpc => tracing::info_span!(
            target: TARGET, parent: None, "request", otel.name = path.trim_start_matches('/'), otel.kind = "server",
            rpc.system = "grpc", rpc.grpc.status_code = field::Empty, otel.status_code = field::Empty
        ),
    };
    if !span.is_disabled() {
        let parent = TraceContextPropagator::new().extract(&Headers(request.headers()));
        // Fails where spans are not sent.
        let _ = span.set_parent(parent);
    }
    let response = next.run(request).instrument(span.clone()).await;
    note_status(&span, &response, interface);
    response
}

fn note_status(span: &Span, response: &Response, interface: Interface) {
    let status = match interface {
        Interface::Http => {
            span.record("http.response.status_code", i64::from(response.status().as_u16()));
            response.status().is_server_error()
        }
        Interface::Grpc => {
            // The status of an answer with messages follows them.
            let code = response
                .headers()
                .get("grpc-status")
                .and_then(|code| code.to_str().ok()?.parse::<i64>().ok());
            code.inspect(|code| drop(span.record("rpc.grpc.status_code", code)));
            code.is_some_and(|code| code != 0)
        }
    };
    if status {
        span.record("otel.status_code", "ERROR");
    }
}

/// The headers of a request, as the name of its trace is looked for.
struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(axum::http::HeaderName::as_str).collect()
    }
}
