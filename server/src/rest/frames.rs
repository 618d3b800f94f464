//! The last frames of a session that is watched: their images and what was measured in them.

use super::extract::AskedBy;
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::maps::Observed;
use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::response::IntoResponse;

/// The image of one of the last frames, as it was sent; pixels sent raw come as PNG. Frames are kept while
/// somebody reads the session's events, the last ten of them.
#[utoipa::path(get, path = "/v1/sessions/{id}/frames/{sequence}/image", tag = "sessions",
    params(("id", description = "The session's id"), ("sequence", description = "The client's number of the frame")),
    responses(
    (status = 200, description = "The image", content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"))),
    (status = 404, description = "The frame is not kept, or no longer", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn image(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, sequence)): Path<(String, String)>,
) -> Result<impl IntoResponse, ApiError> {
    let (id, sequence) = (caller.session(&id, "id")?, parse_sequence(&sequence)?);
    let image = app.service.frame_image(&id, sequence).await?;
    let headers = [
        (CONTENT_TYPE, image.media_type),
        (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
        (CACHE_CONTROL, "no-store".to_owned()),
    ];
    Ok((headers, image.bytes))
}

/// What was measured and recognized in one of the last frames.
#[utoipa::path(get, path = "/v1/sessions/{id}/frames/{sequence}/observed", tag = "sessions",
    params(("id", description = "The session's id"), ("sequence", description = "The client's number of the frame")),
    responses(
    (status = 200, description = "Keypoints and segments", body = Observed),
    (status = 404, description = "The frame is not kept, or no longer", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn observed(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, sequence)): Path<(String, String)>,
) -> Result<Json<Observed>, ApiError> {
    let (id, sequence) = (caller.session(&id, "id")?, parse_sequence(&sequence)?);
    Ok(Json(app.service.frame_observed(&id, sequence).await?))
}

fn parse_sequence(text: &str) -> Result<u64, ApiError> {
    text.parse().map_err(|_| ApiError::invalid("sequence", "must be the number of a frame"))
}
