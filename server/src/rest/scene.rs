//! The map as a viewer draws it, part by part, and small pictures of sessions.

use super::extract::{AskedBy, Params};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::maps::ScenePart;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, ETAG, IF_NONE_MATCH, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde::Deserialize;
use tokio_stream::StreamExt;
use utoipa::IntoParams;

/// Which part of the scene.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// The `revision` of a scene read before: only what changed since is told, as far as the server
    /// remembers; `full` says whether it did.
    #[param(value_type = Option<String>)]
    since: Option<String>,
}

/// The session's map and trajectory as columns of numbers, for drawing: one JSON object a line, the first
/// `scene`, the last `end`. Lengths are map units whatever the session's scale.
#[utoipa::path(get, path = "/v1/sessions/{id}/scene", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The parts", body = ScenePart, content_type = "application/x-ndjson"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn scene(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let parts = app.service.scene(&caller.session(&id, "id")?, wanted.since.as_deref()).await?;
    let lines = parts.map(|part| {
        let mut line = serde_json::to_string(&part?).map_err(ApiError::internal)?;
        line.push('\n');
        Ok::<_, ApiError>(Bytes::from(line))
    });
    let headers = [(CONTENT_TYPE, "application/x-ndjson"), (CACHE_CONTROL, "no-store")];
    Ok((headers, Body::from_stream(lines)))
}

/// A small picture of what the session saw last: its newest keyframe, in gray.
#[utoipa::path(get, path = "/v1/sessions/{id}/picture", tag = "sessions",
    params(("id", description = "The session's id")), responses(
    (status = 200, description = "The picture", body = Vec<u8>, content_type = "image/png"),
    (status = 304, description = "It is the one named by If-None-Match"),
    (status = 404, description = "No such session, or none of its images was kept", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn picture(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let picture = app.service.maps().picture(&caller.session(&id, "id")?).await?;
    let tag = format!("\"{}\"", picture.tag);
    let known = headers.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let headers = [
        (ETAG, tag),
        (CACHE_CONTROL, "no-cache".to_owned()),
        (CONTENT_TYPE, "image/png".to_owned()),
        (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
    ];
    if known {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    Ok((headers, picture.png).into_response())
}
