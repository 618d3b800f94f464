//! What of a session's images is not the scene.

use super::extract::{AskedBy, file_of};
use super::model::Session;
use super::{App, ProblemDetails};
use crate::error::ApiError;
use axum::Json;
use axum::extract::{Path, Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;

/// What is left out of a session's images as not being the scene: white where the scene is seen, black what
/// is left out. Given, or found as what stays where it is while the scene moves.
#[utoipa::path(get, path = "/v1/sessions/{id}/mask", tag = "sessions", params(("id", description = "The session's id")), responses(
    (status = 200, description = "The picture, of the size that images are worked on", content((Vec<u8> = "image/png"))),
    (status = 404, description = "No such session, or nothing is left out", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<impl IntoResponse, ApiError> {
    let png = app.service.mask(&caller.session(&id, "id")?).await?;
    Ok(([(CONTENT_TYPE, "image/png")], png))
}

/// Gives what is to be left out of a session's images, from its next stream on. The body is the file of a
/// picture of the camera's size, dark where nothing is to be used, or a form with it as the part `mask`.
#[utoipa::path(put, path = "/v1/sessions/{id}/mask", tag = "sessions", params(("id", description = "The session's id")),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "application/octet-stream"),
        (Vec<u8> = "multipart/form-data")), description = "A picture of the size of the session's camera"),
    responses(
    (status = 200, description = "The session", body = Session),
    (status = 400, description = "The picture cannot be used", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 413, description = "The picture is too large", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 415, description = "The body is said to be something else than an image", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn put(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    request: Request,
) -> Result<Json<Session>, ApiError> {
    let id = caller.session(&id, "id")?;
    let file = file_of(request, "mask").await?;
    Ok(Json(app.service.set_mask(&caller, &id, Some(file)).await?.into()))
}

/// Forgets what is left out of a session's images: it is found anew, from its next stream on.
#[utoipa::path(delete, path = "/v1/sessions/{id}/mask", tag = "sessions", params(("id", description = "The session's id")), responses(
    (status = 200, description = "The session", body = Session),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn delete(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Json<Session>, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(Json(app.service.set_mask(&caller, &id, None).await?.into()))
}
