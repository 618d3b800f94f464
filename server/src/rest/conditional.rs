//! Conditional requests (RFC 9110, 13): what is asked of a map has the tag of the map's state, and who has
//! the answer of that state already is told so instead of being sent it again.

use super::App;
use crate::access::Caller;
use crate::session::SessionId;
use axum::extract::{Request, State};
use axum::http::header::{CACHE_CONTROL, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// What follows from the map alone, by the part of the path behind the session.
const OF_MAP: [&str; 7] = ["graph", "keyframes", "lines", "map", "points", "primitives", "trajectory"];
/// Kept by the client alone, and asked for before it is used again.
const REVALIDATE: HeaderValue = HeaderValue::from_static("private, no-cache");

/// Whether what a path asks follows from a map alone.
pub(super) fn is_of_map(path: &str) -> bool {
    let behind = path.strip_prefix("/v1/sessions/").and_then(|path| path.split('/').nth(1));
    behind.is_some_and(|what| OF_MAP.contains(&what))
}

/// Answers what is known already with `304`, and tags the rest.
pub(super) async fn answer(State(app): State<App>, request: Request, next: Next) -> Response {
    // A request is not held while its tag is looked up: its body cannot be shared between threads.
    let Some(id) = asked_map(&request) else { return next.run(request).await };
    let Some(tag) = tag_of(&app, &id).await else { return next.run(request).await };
    if is_known(request.headers(), &tag) {
        return (StatusCode::NOT_MODIFIED, [(ETAG, tag), (CACHE_CONTROL, REVALIDATE)]).into_response();
    }
    let mut response = next.run(request).await;
    if response.status() == StatusCode::OK {
        response.headers_mut().entry(ETAG).or_insert(tag);
        response.headers_mut().entry(CACHE_CONTROL).or_insert(REVALIDATE);
    }
    response
}

/// The session whose map is asked, if it is.
fn asked_map(request: &Request) -> Option<SessionId> {
    let path = request.uri().path();
    if request.method() != Method::GET || !is_of_map(path) {
        return None;
    }
    let id = path.strip_prefix("/v1/sessions/")?.split('/').next()?;
    request.extensions().get::<Caller>()?.session(id, "id").ok()
}

/// The tag of a map; taken before the map is read, so that an answer is at least as new.
async fn tag_of(app: &App, id: &SessionId) -> Option<HeaderValue> {
    let tag = app.service.map_tag(id).await.ok()?;
    HeaderValue::from_str(&format!("W/\"{tag}\"")).ok()
}

fn is_known(headers: &HeaderMap, tag: &HeaderValue) -> bool {
    let opaque = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    let Some(wanted) = tag.to_str().ok().map(opaque) else { return false };
    let known = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    known.flat_map(|value| value.split(',')).any(|tag| tag.trim() == "*" || opaque(tag) == wanted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_are_compared_weakly_and_one_of_many_is_enough() {
        let tag = HeaderValue::from_static("W/\"abc\"");
        let known = |value: &'static str| {
            is_known(&HeaderMap::from_iter([(IF_NONE_MATCH, HeaderValue::from_static(value))]), &tag)
        };
        assert!(known("\"abc\"") && known("W/\"abc\"") && known("\"x\", W/\"abc\"") && known("*"));
        assert!(!known("\"ab\"") && !known("abc") && !is_known(&HeaderMap::new(), &tag));
    }
}
