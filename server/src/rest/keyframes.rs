//! Keyframes and their images.

use super::extract::{AskedBy, NoConditions, PageParams, Paged};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::ids::parse_id;
use crate::maps::{Keyframe, Observed};
use crate::model::Scale;
use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

/// Some keyframes in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct KeyframePage {
    /// What a length of 1 means.
    scale: Scale,
    /// The keyframes.
    keyframes: Vec<Keyframe>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

/// Keyframes in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes", tag = "maps",
    params(("id", description = "The session's id"), PageParams), responses(
    (status = 200, description = "A page of keyframes", body = KeyframePage),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Paged(page, NoConditions {}): Paged<NoConditions>,
) -> Result<Json<KeyframePage>, ApiError> {
    let id = caller.session(&id, "id")?;
    let answer = app.service.maps().keyframes(&id, &page).await?;
    let (scale, page) = (answer.scale, answer.value);
    Ok(Json(KeyframePage { scale, keyframes: page.items, next_page_token: page.next_page_token }))
}

/// A keyframe.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes/{kf}", tag = "maps",
    params(("id", description = "The session's id"), ("kf", description = "The keyframe's id")), responses(
    (status = 200, description = "The keyframe", body = Keyframe),
    (status = 404, description = "No such keyframe", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, kf)): Path<(String, String)>,
) -> Result<Json<Keyframe>, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(Json(app.service.maps().keyframe(&id, parse_id("kf", &kf)?).await?))
}

/// What a keyframe measured: keypoints, segments and vanishing points, and what of the map they see.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes/{kf}/observed", tag = "maps",
    params(("id", description = "The session's id"), ("kf", description = "The keyframe's id")), responses(
    (status = 200, description = "Keypoints, segments and vanishing points", body = Observed),
    (status = 404, description = "No such keyframe", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn observed(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, kf)): Path<(String, String)>,
) -> Result<Json<Observed>, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(Json(app.service.maps().observed_keyframe(&id, parse_id("kf", &kf)?).await?))
}

/// A keyframe's image, as it was sent; pixels sent raw come as PNG.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes/{kf}/image", tag = "maps",
    params(("id", description = "The session's id"), ("kf", description = "The keyframe's id")), responses(
    (status = 200, description = "The image", content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"))),
    (status = 404, description = "No such image", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn image(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, kf)): Path<(String, String)>,
) -> Result<impl IntoResponse, ApiError> {
    let id = caller.session(&id, "id")?;
    let image = app.service.maps().keyframe_image(&id, parse_id("kf", &kf)?).await?;
    // The bytes are a client's: a browser must not take them for anything else.
    let headers = [(CONTENT_TYPE, image.media_type), (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned())];
    Ok((headers, image.bytes))
}
