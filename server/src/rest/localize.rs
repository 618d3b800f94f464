//! One image against a stored map.

use super::extract::{AskedBy, file_of};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::model::{Pose, Scale, State as TrackingState, Units};
use crate::session::{Encoding, Located, SentImage};
use axum::Json;
use axum::extract::{Path, Request, State};
use serde::Serialize;
use utoipa::ToSchema;

/// Where an image was taken.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Location {
    /// Tracked or weak with a pose, lost without one, initialising if the session has no map yet.
    state: TrackingState,
    /// Why there is no pose, or a weak one, in a plain sentence. Empty when tracked.
    reason: String,
    /// The camera's pose in the world; `null` if the place was not found.
    world_from_camera: Option<Pose>,
    /// What a length of 1 means.
    scale: Scale,
    /// The submap whose frame of reference the pose is in.
    submap_id: u32,
    /// Points that agree with the pose.
    n_inlier_points: usize,
    /// Lines that agree with the pose.
    n_inlier_lines: usize,
    /// Keypoints found in the image.
    n_keypoints: usize,
    /// The map is as of this frame; `null` if no frame is stored.
    durable_sequence: Option<u64>,
    /// Milliseconds to read the map and to make it ready.
    load_ms: f64,
    /// Milliseconds to locate the image in it.
    locate_ms: f64,
}

impl From<Located> for Location {
    fn from(located: Located) -> Self {
        let Located { report, metres_per_unit, durable_sequence, load_ns, locate_ns } = located;
        let units = Units::new(metres_per_unit);
        Self {
            state: report.outcome.state().into(),
            reason: report.reason(),
            world_from_camera: report.world_from_camera.as_ref().map(|pose| units.pose(pose)),
            scale: units.scale(),
            submap_id: report.submap.0,
            n_inlier_points: report.n_inlier_points,
            n_inlier_lines: report.n_inlier_lines,
            n_keypoints: report.n_keypoints,
            durable_sequence,
            load_ms: load_ns as f64 * 1e-6,
            locate_ms: locate_ns as f64 * 1e-6,
        }
    }
}

/// Locates one image in the session's map, as of its last commit, without changing anything; also while a
/// client streams into the session. The body is the image file, or a form with it as the part `image`; its
/// bytes tell its format.
#[utoipa::path(post, path = "/v1/sessions/{id}/localize", tag = "maps",
    params(("id", description = "The session's id")),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/bmp"),
        (Vec<u8> = "image/webp"), (Vec<u8> = "image/tiff"), (Vec<u8> = "image/x-portable-anymap"),
        (Vec<u8> = "application/octet-stream"), (Vec<u8> = "multipart/form-data")),
        description = "An image file of the size of the session's camera"),
    responses(
    (status = 200, description = "Where it was taken, or why that is not known", body = Location),
    (status = 400, description = "The image cannot be used", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 415, description = "The body is said to be something else than an image", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 413, description = "The image is too large", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 429, description = "Too many wait", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 503, description = "It took too long", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn localize(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    request: Request,
) -> Result<Json<Location>, ApiError> {
    let id = caller.session(&id, "id")?;
    let data = file_of(request, "image").await?;
    let image = SentImage { encoding: Encoding::Auto, width: 0, height: 0, row_stride: 0, data };
    Ok(Json(app.service.localize(&id, image).await?.into()))
}
