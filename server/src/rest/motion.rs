//! Readings of the motion sensors of a session's device.

use super::extract::AskedBy;
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::motion::HEADER;
use axum::Json;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use bytes::Bytes;
use futures_util::stream::{self, StreamExt};
use serde::Serialize;
use utoipa::ToSchema;

/// What was taken in.
#[derive(Serialize, ToSchema)]
pub(super) struct Added {
    /// Readings in the request.
    n_readings: usize,
}

/// Keeps what the motion sensors of the session's device measured. The body has lines as the `imu0/data.csv`
/// of EuRoC recordings: a time in nanoseconds by the clock of the frames, three angular velocities (rad/s)
/// and three accelerations (m/s², gravity included), in the axes of the device; at most 10,000. Sent once
/// more they are kept once. The map does not use them.
#[utoipa::path(post, path = "/v1/sessions/{id}/motion", tag = "sessions", params(("id", description = "The session's id")),
    request_body(content = String, content_type = "text/csv"), responses(
    (status = 200, description = "They are saved", body = Added),
    (status = 400, description = "A line is no reading, or there are too many", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 413, description = "The body is too large", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn add(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    body: String,
) -> Result<Json<Added>, ApiError> {
    let id = caller.session(&id, "id")?;
    let n_readings = app.service.add_motion(&caller, &id, &body).await?;
    Ok(Json(Added { n_readings }))
}

/// What the motion sensors of the session's device measured, in the order of their times, with the columns of
/// the `imu0/data.csv` of EuRoC recordings.
#[utoipa::path(get, path = "/v1/sessions/{id}/motion", tag = "sessions", params(("id", description = "The session's id")), responses(
    (status = 200, description = "The readings", body = String, content_type = "text/csv"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<impl IntoResponse, ApiError> {
    let id = caller.session(&id, "id")?;
    let motion = app.service.motion();
    // Asked before the answer begins: there may be no such session.
    let first = motion.lines_after(&id, None).await?;
    let lines = stream::try_unfold(first, move |found| {
        let (motion, id) = (motion.clone(), id.clone());
        async move {
            let Some((first_ns, lines)) = found else { return Ok::<_, ApiError>(None) };
            let next = motion.lines_after(&id, Some(first_ns)).await?;
            Ok(Some((Bytes::from(lines), next)))
        }
    });
    let header = stream::once(async { Ok(Bytes::from_static(HEADER.as_bytes())) });
    let body = Body::from_stream(header.chain(lines));
    Ok(([(CONTENT_TYPE, "text/csv; charset=utf-8")], body))
}
