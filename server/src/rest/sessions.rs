//! Sessions.

use super::extract::{AskedBy, Body, NoConditions, PageParams, Paged};
use super::model::{CreateSession, Session, SessionPage, UpdateSession};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderName, StatusCode};
use serde::Serialize;
use utoipa::ToSchema;

/// Sessions in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions", tag = "sessions", params(PageParams), responses(
    (status = 200, description = "A page of sessions", body = SessionPage),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Paged(page, NoConditions {}): Paged<NoConditions>,
) -> Result<Json<SessionPage>, ApiError> {
    let page = app.service.list_sessions(&caller, &page).await?;
    let sessions = page.items.into_iter().map(Session::from).collect();
    Ok(Json(SessionPage { sessions, next_page_token: page.next_page_token }))
}

/// Makes a session.
#[utoipa::path(post, path = "/v1/sessions", tag = "sessions", request_body = CreateSession, responses(
    (status = 201, description = "The session", body = Session),
    (status = 400, description = "A field is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "The id is taken", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 429, description = "Too many sessions", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn create(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Body(request): Body<CreateSession>,
) -> Result<(StatusCode, [(HeaderName, String); 1], Json<Session>), ApiError> {
    let view = app.service.create_session(&caller, request.into_new_session(&caller)?).await?;
    let location = format!("/v1/sessions/{}", view.id);
    Ok((StatusCode::CREATED, [(LOCATION, location)], Json(view.into())))
}

/// A session.
#[utoipa::path(get, path = "/v1/sessions/{id}", tag = "sessions", params(("id", description = "The session's id")), responses(
    (status = 200, description = "The session", body = Session),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Json<Session>, ApiError> {
    Ok(Json(app.service.get_session(&caller.session(&id, "id")?).await?.into()))
}

/// Changes a session's options.
#[utoipa::path(patch, path = "/v1/sessions/{id}", tag = "sessions", params(("id", description = "The session's id")),
    request_body = UpdateSession, responses(
    (status = 200, description = "The session", body = Session),
    (status = 400, description = "A field is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn update(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Body(request): Body<UpdateSession>,
) -> Result<Json<Session>, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(Json(app.service.update_session(&caller, &id, request.options).await?.into()))
}

/// What became of a session that was deleted.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Deleted {
    /// The session's name, which is free again.
    id: String,
    /// What becomes of the room it took.
    note: &'static str,
}

/// Deletes a session with its map. The database file stays as large: new sessions fill the room, and
/// `monoslam-server compact` gives it back to the file system while no server runs.
#[utoipa::path(delete, path = "/v1/sessions/{id}", tag = "sessions", params(("id", description = "The session's id")), responses(
    (status = 200, description = "It is gone", body = Deleted),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn delete(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Json<Deleted>, ApiError> {
    app.service.delete_session(&caller, &caller.session(&id, "id")?).await?;
    let note = "the database file stays as large; new sessions fill the room, and `monoslam-server compact` gives it \
                back while no server runs";
    Ok(Json(Deleted { id, note }))
}
