//! A page for people who open the address in a browser.

use super::App;
use crate::error::ApiError;
use crate::model::State as TrackingState;
use crate::page::{MAX_PAGE_SIZE, PageRequest};
use crate::session::SessionView;
use axum::extract::State;
use axum::response::Html;
use std::fmt::Write;

const HEAD: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>monoslam</title><style>\
body{font:15px system-ui;margin:2em auto;max-width:60em;padding:0 1em}table{border-collapse:collapse;width:100%}\
td,th{text-align:right;padding:.3em .7em;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}\
</style><h1>monoslam</h1><p><a href=\"/openapi.json\">OpenAPI document</a> · <a href=\"/metrics\">metrics</a></p>";

/// The sessions, as a table.
pub(super) async fn page(State(app): State<App>) -> Result<Html<String>, ApiError> {
    let list = app.service.list_sessions(&PageRequest::new(MAX_PAGE_SIZE, "")?).await?;
    let mut html = HEAD.to_owned();
    if list.items.is_empty() {
        html.push_str("<p>No sessions yet.");
        return Ok(Html(html));
    }
    html.push_str(
        "<table><tr><th>session<th>state<th>frames<th>keyframes<th>points<th>in memory<th>trajectory",
    );
    list.items.iter().for_each(|session| push_row(&mut html, session));
    html.push_str("</table>");
    if list.next_page_token.is_some() {
        html.push_str("<p>There are more: see <a href=\"/v1/sessions\">/v1/sessions</a>.");
    }
    Ok(Html(html))
}

/// Ids are letters, digits, `-` and `_`, so nothing needs escaping.
fn push_row(html: &mut String, session: &SessionView) {
    let SessionView { id, n_frames, n_keyframes, n_points, .. } = session;
    let state = session.state.map_or("empty", |state| TrackingState::from(state).name());
    let loaded = if session.has_writer {
        "streaming"
    } else if session.loaded {
        "yes"
    } else {
        "no"
    };
    let _ = write!(
        html,
        "<tr><td><a href=\"/v1/sessions/{id}\">{id}</a><td>{state}<td>{n_frames}<td>{n_keyframes}<td>{n_points}\
         <td>{loaded}<td><a href=\"/v1/sessions/{id}/trajectory\">tum</a> \
         <a href=\"/v1/sessions/{id}/trajectory?format=csv\">csv</a>"
    );
}
