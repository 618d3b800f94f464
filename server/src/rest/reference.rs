//! The interface as a page at `/api`, made of the OpenAPI document by a script, without anything from
//! elsewhere.

use super::assets::page_headers;
use axum::Router;
use axum::response::IntoResponse;
use axum::routing::get;

/// The files, by where they are served.
const FILES: [(&str, &str, &str); 3] = [
    ("/api", "text/html; charset=utf-8", include_str!("reference/page.html")),
    ("/api/page.css", "text/css; charset=utf-8", include_str!("reference/page.css")),
    ("/api/page.js", "text/javascript; charset=utf-8", include_str!("reference/page.js")),
];

/// Their routes.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    FILES.into_iter().fold(Router::new(), |router, (path, media_type, text)| {
        router.route(
            path,
            get(move || async move { (page_headers(media_type, "no-cache"), text).into_response() }),
        )
    })
}
