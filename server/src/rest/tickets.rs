//! Tickets, with which a browser opens what it can send no token with.

use super::extract::AskedBy;
use super::{App, ProblemDetails};
use crate::access::{Role, Ticket, cookie_name};
use crate::connections::Peer;
use crate::error::ApiError;
use axum::Json;
use axum::extract::State;
use axum::http::header::SET_COOKIE;
use axum::http::{Extensions, HeaderMap, HeaderName, StatusCode, Uri};
use serde::Serialize;
use utoipa::ToSchema;

/// Who asks, as far as a page needs to know.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Admission {
    /// The name of the token; `local` if none is needed.
    name: String,
    /// What it allows: `reader`, `writer` or `admin`.
    role: &'static str,
    /// Whose sessions it leads to; `null` leads to those of all.
    owner: Option<String>,
    /// Seconds until the ticket must be renewed; `null` if none is needed.
    expires_in_s: Option<u64>,
}

/// Gives a page a ticket: a cookie that is taken for reading and for streams, where browsers send no token.
/// It is good for the server's `access.ticket_s`, and no longer than its token.
#[utoipa::path(post, path = "/v1/tickets", tag = "system", responses(
    (status = 200, description = "A ticket, as a cookie", body = Admission),
    (status = 401, description = "A token is needed", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn issue(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    uri: Uri,
    headers: HeaderMap,
    extensions: Extensions,
) -> Result<(Option<[(HeaderName, String); 1]>, Json<Admission>), ApiError> {
    let ticket = app.service.access().ticket(&headers);
    let admission = Admission {
        name: caller.name().to_owned(),
        role: Role::name(caller.role()),
        owner: caller.owner().map(str::to_owned),
        expires_in_s: ticket.as_ref().map(|ticket| ticket.lifetime.as_secs()),
    };
    let cookie = ticket
        .map(|Ticket { value, lifetime }| cookie(&uri, &headers, &extensions, &value, lifetime.as_secs()));
    Ok((cookie.map(|cookie| [(SET_COOKIE, cookie)]), Json(admission)))
}

/// Has a browser forget its ticket.
#[utoipa::path(delete, path = "/v1/tickets", tag = "system", responses((status = 204, description = "It does")))]
pub(super) async fn forget(
    uri: Uri,
    headers: HeaderMap,
    extensions: Extensions,
) -> (StatusCode, [(HeaderName, String); 1]) {
    (StatusCode::NO_CONTENT, [(SET_COOKIE, cookie(&uri, &headers, &extensions, "", 0))])
}

fn cookie(uri: &Uri, headers: &HeaderMap, extensions: &Extensions, value: &str, seconds: u64) -> String {
    let is_encrypted = extensions.get::<Peer>().is_some_and(|peer| peer.is_encrypted);
    let secure = if is_encrypted { "; Secure" } else { "" };
    let name = cookie_name(headers, uri);
    format!("{name}={value}; Path=/; Max-Age={seconds}; HttpOnly; SameSite=Strict{secure}")
}
