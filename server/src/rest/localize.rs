//! One image against stored maps.

use super::extract::{AskedBy, Params, file_of, numbers};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::localization::{AskedCamera, Located, MAX_SESSIONS, Question};
use crate::model::{Camera, Pose, Scale, State as TrackingState, Units};
use crate::session::{Encoding, SentImage, SessionId};
use axum::Json;
use axum::extract::{Path, Request, State};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Where an image was taken.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Location {
    /// Whose map the pose is in; of several, the one that fits best. `null` if none does.
    session_id: Option<String>,
    /// Tracked or weak with a pose, lost without one, initialising if the session has no map yet.
    state: TrackingState,
    /// Why there is no pose, or a weak one, in a plain sentence. Empty when tracked.
    reason: String,
    /// The camera's pose in the world; `null` if the place was not found.
    world_from_camera: Option<Pose>,
    /// Covariance of the pose, 36 numbers row by row: position (as lengths are told) x y z, then turns about
    /// the world's axes x y z, radians. What noise of the image alone makes of it.
    covariance: Option<Vec<f64>>,
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
    /// The camera the pose was found with, of the image's size; its focal length may have been found.
    camera: Option<Camera>,
    /// Sessions searched by looks.
    n_sessions_searched: u32,
    /// Sessions the image was looked for in.
    n_sessions_tried: u32,
    /// The map is as of this frame; `null` if no frame is stored.
    durable_sequence: Option<u64>,
    /// Milliseconds to read the map and to make it ready.
    load_ms: f64,
    /// Milliseconds to locate the image in it.
    locate_ms: f64,
}

impl From<Located> for Location {
    fn from(located: Located) -> Self {
        let (report, units) = (&located.report, Units::new(located.metres_per_unit));
        let covariance = located.covariance.filter(|_| report.world_from_camera.is_some());
        Self {
            session_id: located.session.as_ref().map(ToString::to_string),
            state: report.outcome.state().into(),
            reason: report.reason(),
            world_from_camera: report.world_from_camera.as_ref().map(|pose| units.pose(pose)),
            covariance: covariance.map(|covariance| covariance.transpose().as_slice().to_vec()),
            scale: units.scale(),
            submap_id: report.submap.0,
            n_inlier_points: report.n_inlier_points,
            n_inlier_lines: report.n_inlier_lines,
            n_keypoints: report.n_keypoints,
            camera: located.camera.map(Camera::from),
            n_sessions_searched: located.n_searched,
            n_sessions_tried: located.n_tried,
            durable_sequence: located.durable_sequence,
            load_ms: located.load_ns as f64 * 1e-6,
            locate_ms: located.locate_ns as f64 * 1e-6,
        }
    }
}

/// What is said of the image's camera, and where to look. Of an image of the session's size nothing need be
/// said if its camera took it; of another size, the focal length is found.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ImageParams {
    /// The image's camera as JSON, such as
    /// `{"model":"pinhole","width":640,"height":480,"fx":525,"fy":525,"cx":319.5,"cy":239.5}`.
    camera: Option<String>,
    /// Field of view across the longer side of the image, degrees, of a camera without distortion.
    fov_deg: Option<f64>,
    /// Nothing is known of the camera, even if the image has the session's size.
    unknown_camera: bool,
    /// Where the camera is thought to be, `x,y,z`; needs `radius`.
    near: Option<String>,
    /// How far it may be from there.
    radius: Option<f64>,
}

/// Which sessions.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default)]
#[into_params(parameter_in = Query)]
pub(super) struct ManyParams {
    /// Names of sessions with commas between, at most 1000; left out, all of the caller's.
    sessions: Option<String>,
    /// The image's camera as JSON.
    camera: Option<String>,
    /// Field of view across the longer side of the image, degrees, of a camera without distortion.
    fov_deg: Option<f64>,
    /// Nothing is known of the camera, even if the image has a session's size.
    unknown_camera: bool,
}

impl ImageParams {
    fn asked_camera(&self) -> Result<AskedCamera, ApiError> {
        match (&self.camera, self.fov_deg, self.unknown_camera) {
            (None, None, false) => Ok(AskedCamera::Unsaid),
            (Some(text), None, false) => {
                let camera: Result<Camera, _> = serde_json::from_str(text);
                let camera = camera.map_err(|error| ApiError::invalid("camera", error.to_string()))?;
                Ok(AskedCamera::Given(camera.into()))
            }
            (None, Some(degrees), false) => Ok(AskedCamera::FieldOfView(degrees)),
            (None, None, true) => Ok(AskedCamera::Unknown),
            _ => Err(ApiError::invalid("camera", "camera, fov_deg and unknown_camera exclude each other")),
        }
    }

    fn near(&self) -> Result<Option<([f64; 3], f64)>, ApiError> {
        match (&self.near, self.radius) {
            (None, None) => Ok(None),
            (Some(text), Some(radius)) if radius.is_finite() && radius > 0.0 => {
                Ok(Some((numbers("near", text, "x,y,z")?, radius)))
            }
            (_, Some(radius)) if !(radius.is_finite() && radius > 0.0) => {
                Err(ApiError::invalid("radius", "must be a number above 0"))
            }
            (Some(_), _) => Err(ApiError::invalid("radius", "is needed with near")),
            (None, Some(_)) => Err(ApiError::invalid("near", "is needed with radius")),
        }
    }

    async fn question(&self, sessions: Vec<SessionId>, request: Request) -> Result<Question, ApiError> {
        let (camera, near) = (self.asked_camera()?, self.near()?);
        let data = file_of(request, "image").await?;
        let image = SentImage { encoding: Encoding::Auto, width: 0, height: 0, row_stride: 0, data };
        Ok(Question { sessions, image, camera, near })
    }
}

/// Locates one image in the session's map, as of its last commit, without changing anything; also while a
/// client streams into the session. The body is the image file, or a form with it as the part `image`; its
/// bytes tell its format.
#[utoipa::path(post, path = "/v1/sessions/{id}/localize", tag = "maps",
    params(("id", description = "The session's id"), ImageParams),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/bmp"),
        (Vec<u8> = "image/webp"), (Vec<u8> = "image/tiff"), (Vec<u8> = "image/x-portable-anymap"),
        (Vec<u8> = "application/octet-stream"), (Vec<u8> = "multipart/form-data")),
        description = "An image file"),
    responses(
    (status = 200, description = "Where it was taken, or why that is not known", body = Location),
    (status = 400, description = "The image or a parameter cannot be used", body = ProblemDetails, content_type = "application/problem+json"),
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
    Params(params): Params<ImageParams>,
    request: Request,
) -> Result<Json<Location>, ApiError> {
    let id = caller.session(&id, "id")?;
    // An image for a session that is not there need not be received.
    app.service.get_session(&id).await?;
    let question = params.question(vec![id], request).await?;
    Ok(Json(app.service.localize(question).await?.into()))
}

/// Locates one image in whichever of several sessions' maps shows the place: those that look like it are
/// found by descriptors, and the best few looked at closely. Otherwise as for one session.
#[utoipa::path(post, path = "/v1/localize", tag = "maps", params(ManyParams),
    request_body(content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"), (Vec<u8> = "image/bmp"),
        (Vec<u8> = "image/webp"), (Vec<u8> = "image/tiff"), (Vec<u8> = "image/x-portable-anymap"),
        (Vec<u8> = "application/octet-stream"), (Vec<u8> = "multipart/form-data")),
        description = "An image file"),
    responses(
    (status = 200, description = "Where it was taken, or why that is not known", body = Location),
    (status = 400, description = "The image or a parameter cannot be used", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 415, description = "The body is said to be something else than an image", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 413, description = "The image is too large", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 429, description = "Too many wait", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 503, description = "It took too long", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn localize_among(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Params(params): Params<ManyParams>,
    request: Request,
) -> Result<Json<Location>, ApiError> {
    let ManyParams { sessions, camera, fov_deg, unknown_camera } = params;
    let sessions = match sessions.filter(|names| !names.is_empty()) {
        None => app.service.sessions_to_search(&caller).await?,
        Some(names) => {
            let names: Vec<&str> = names.split(',').map(str::trim).collect();
            if names.len() > MAX_SESSIONS {
                return Err(ApiError::invalid("sessions", format!("must be at most {MAX_SESSIONS}")));
            }
            names.iter().map(|name| caller.session(name, "sessions")).collect::<Result<_, _>>()?
        }
    };
    let params = ImageParams { camera, fov_deg, unknown_camera, near: None, radius: None };
    let question = params.question(sessions, request).await?;
    Ok(Json(app.service.localize(question).await?.into()))
}
