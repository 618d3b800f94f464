//! The viewer: the page at `/` and what it loads, built from `viewer/` and carried inside the program.

use crate::error::{ApiError, ErrorCode};
use axum::body::Body;
use axum::extract::Path;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use include_dir::{Dir, File, include_dir};
use std::hash::{DefaultHasher, Hash, Hasher};

/// What `npm run build` made.
static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../viewer/dist");

/// The page takes everything from this server and nothing from anywhere else.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Files below `assets/` have a hash of what they hold in their names, so one name means one content for
/// ever.
const FOR_EVER: &str = "public, max-age=31536000, immutable";

/// The text of the viewer's file with such an extension, `.js` or `.css`: it has one of each, which needs no
/// other.
pub fn viewer_file(extension: &str) -> Option<&'static str> {
    let mut files = FILES.get_dir("assets")?.files();
    let is_wanted = |path: &str| path.starts_with("assets/index-") && path.ends_with(extension);
    files.find(|file| is_wanted(&file.path().to_string_lossy()))?.contents_utf8()
}

/// The page.
pub(super) async fn page(headers: HeaderMap) -> Response {
    answer("index.html", "no-cache", &headers)
}

/// The page that makes a device's camera one of ours.
pub(super) async fn capture(headers: HeaderMap) -> Response {
    answer("capture.html", "no-cache", &headers)
}

/// The page's small sign.
pub(super) async fn icon(headers: HeaderMap) -> Response {
    answer("favicon.svg", "no-cache", &headers)
}

/// A file the page loads.
pub(super) async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    answer(&format!("assets/{name}"), FOR_EVER, &headers)
}

/// A file of the viewer; only those that were built in can be named.
fn answer(path: &str, caching: &'static str, request: &HeaderMap) -> Response {
    let Some(file) = FILES.get_file(path) else {
        let sentence = format!("there is nothing at /{path}");
        return ApiError::new(ErrorCode::NotFound, sentence).into_response();
    };
    let tag = tag_of(file);
    let known = request.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let headers = (page_headers(media_type(path), caching), [(ETAG, tag)]);
    if known {
        return (StatusCode::NOT_MODIFIED, headers.0, headers.1).into_response();
    }
    (headers.0, headers.1, Body::from(file.contents())).into_response()
}

/// What every file of a page is sent with.
pub(super) fn page_headers(
    media_type: &'static str,
    caching: &'static str,
) -> [(HeaderName, &'static str); 5] {
    [
        (CONTENT_TYPE, media_type),
        (CACHE_CONTROL, caching),
        (CONTENT_SECURITY_POLICY, POLICY),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ]
}

fn tag_of(file: &File<'_>) -> String {
    let mut hasher = DefaultHasher::new();
    file.contents().hash(&mut hasher);
    format!("\"{:016x}\"", hasher.finish())
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}
