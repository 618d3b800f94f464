//! Key frames and their images.

use super::extract::Params;
use super::model::{Pose, Scale};
use super::units::Units;
use super::{App, Problem};
use crate::error::{ApiError, ErrorCode};
use crate::service::checked_page_size;
use crate::session::SessionId;
use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use slam::map::KeyframeId;
use store::KeyframeRecord;
use utoipa::{IntoParams, ToSchema};

/// A key frame.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Keyframe {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the pose is in.
    submap_id: u32,
    /// The client's number of the frame.
    sequence: u64,
    /// The client's time of the frame, nanoseconds.
    timestamp_ns: i64,
    /// The camera's pose in the world.
    world_from_camera: Pose,
    /// The key frame it hangs on in the spanning tree.
    parent: Option<u64>,
    /// Keypoints measured in it.
    n_keypoints: u32,
    /// Keypoints that see a point.
    n_points: u32,
    /// Segments measured in it.
    n_segments: u32,
    /// Segments that see a line.
    n_lines: u32,
    /// Whether its image was kept.
    has_image: bool,
}

/// Some key frames in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct KeyframePage {
    /// What a length of 1 means.
    scale: Scale,
    /// The key frames.
    keyframes: Vec<Keyframe>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

impl Keyframe {
    pub fn new(record: &KeyframeRecord, units: Units) -> Self {
        Self {
            id: record.id.get(),
            submap_id: record.submap.0,
            sequence: record.sequence,
            timestamp_ns: record.timestamp_ns,
            world_from_camera: units.pose(&record.camera_from_world.inverse()),
            parent: record.parent.map(KeyframeId::get),
            n_keypoints: record.n_keypoints,
            n_points: record.n_points,
            n_segments: record.n_segments,
            n_lines: record.n_lines,
            has_image: record.has_image,
        }
    }
}

/// Which page.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Page {
    /// Entries on the page, at most 1000; 0 means 100.
    page_size: u32,
    /// `next_page_token` of the page before.
    page_token: String,
}

/// Key frames in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes", tag = "maps",
    params(("id", description = "The session's id"), Page), responses(
    (status = 200, description = "A page of key frames", body = KeyframePage),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(page): Params<Page>,
) -> Result<Json<KeyframePage>, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let after = match page.page_token.as_str() {
        "" => None,
        token => Some(keyframe_id("page_token", token)?),
    };
    let units = Units::of(&app, &id).await?;
    let page = app.service.store().keyframes(id.as_str(), after, checked_page_size(page.page_size)?).await?;
    Ok(Json(KeyframePage {
        scale: units.scale(),
        keyframes: page.keyframes.iter().map(|record| Keyframe::new(record, units)).collect(),
        next_page_token: page.next.map(|id| id.to_string()),
    }))
}

/// A key frame.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes/{kf}", tag = "maps",
    params(("id", description = "The session's id"), ("kf", description = "The key frame's id")), responses(
    (status = 200, description = "The key frame", body = Keyframe),
    (status = 404, description = "No such key frame", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    Path((id, kf)): Path<(String, String)>,
) -> Result<Json<Keyframe>, ApiError> {
    let (id, record) = find(&app, &id, &kf).await?;
    Ok(Json(Keyframe::new(&record, Units::of(&app, &id).await?)))
}

/// A key frame's image, as it was sent; pixels sent raw come as PNG.
#[utoipa::path(get, path = "/v1/sessions/{id}/keyframes/{kf}/image", tag = "maps",
    params(("id", description = "The session's id"), ("kf", description = "The key frame's id")), responses(
    (status = 200, description = "The image", content((Vec<u8> = "image/png"), (Vec<u8> = "image/jpeg"))),
    (status = 404, description = "No such image", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn image(
    State(app): State<App>,
    Path((id, kf)): Path<(String, String)>,
) -> Result<impl IntoResponse, ApiError> {
    let (id, keyframe) = find(&app, &id, &kf).await?;
    let image = app.service.store().keyframe_image(id.as_str(), keyframe.id).await?.ok_or_else(|| {
        ApiError::new(
            ErrorCode::ImageNotFound,
            format!("the image of key frame {} was not kept", keyframe.id),
        )
    })?;
    // The bytes are a client's: a browser must not take them for anything else.
    let headers = [(CONTENT_TYPE, image.media_type), (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned())];
    Ok((headers, image.bytes))
}

async fn find(app: &App, id: &str, kf: &str) -> Result<(SessionId, KeyframeRecord), ApiError> {
    let id = SessionId::parse(id, "id")?;
    let keyframe_id = keyframe_id("kf", kf)?;
    let keyframe = app.service.store().keyframe(id.as_str(), keyframe_id).await?;
    let keyframe = keyframe.ok_or_else(|| {
        let sentence = format!("session {id} has no key frame {keyframe_id}");
        ApiError::new(ErrorCode::KeyframeNotFound, sentence)
    })?;
    Ok((id, keyframe))
}

fn keyframe_id(field: &str, text: &str) -> Result<KeyframeId, ApiError> {
    let number = text.parse().ok().filter(|number| i64::try_from(*number).is_ok());
    number
        .and_then(KeyframeId::new)
        .ok_or_else(|| ApiError::invalid(field, "must be a key frame's number, from 1 on"))
}
