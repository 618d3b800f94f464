//! The whole map as a file.

use super::extract::{AskedBy, Params};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::maps::{ColmapPart, MapFormat};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use slam::map::SubmapId;
use utoipa::{IntoParams, ToSchema};

/// How the map is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Format {
    /// Polygon file (ASCII): points as vertices, lines as edges between two vertices each.
    #[default]
    Ply,
    /// One object with keyframes, points, lines and primitives.
    Json,
    /// COLMAP's text model, one `part` at a time.
    Colmap,
    /// `transforms.json` of nerfstudio and instant-ngp, of keyframes whose image was kept.
    Transforms,
    /// MCAP with Foxglove's schemas: points, lines, the camera's way and the keyframes' images.
    Mcap,
}

/// A file of a COLMAP text model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(super) enum Part {
    /// `cameras.txt`: the session's camera.
    #[serde(rename = "cameras")]
    Cameras,
    /// `images.txt`: keyframes with their keypoints.
    #[serde(rename = "images")]
    Images,
    /// `points3D.txt`: points with who sees them.
    #[serde(rename = "points3D")]
    Points3D,
}

/// Which map and how.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// How it is written.
    #[param(inline)]
    format: Format,
    /// COLMAP: which file of the model. COLMAP puts the origin at the corner of the top-left pixel, half a
    /// pixel from where it is everywhere else here. Image names are `keyframe_` and the keyframe's number
    /// with six digits, and `.jpg` or `.png` where the image was kept; the images are at
    /// `…/keyframes/{kf}/image`. Reprojection errors are -1: not computed.
    /// Fetch the three parts while nobody streams: each is as of its own commit.
    #[param(inline)]
    part: Option<Part>,
    /// This submap only; submaps do not share a frame of reference. Left out, JSON has all of them, and the
    /// others the one with the most keyframes.
    submap_id: Option<u32>,
}

/// The map as a file, as of one commit.
#[utoipa::path(get, path = "/v1/sessions/{id}/map", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The map", content(
        (String = "application/octet-stream"), (String = "text/plain"), (serde_json::Value = "application/json"))),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn map(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let id = caller.session(&id, "id")?;
    let format = wanted.format()?;
    let file = app.service.maps().export(&id, format, wanted.submap_id.map(SubmapId)).await?;
    // Names of files are letters, digits, `-`, `_` and `.`: nothing to escape.
    let disposition = format!("attachment; filename=\"{}\"", file.name);
    let headers = [
        (CONTENT_TYPE, file.media_type.to_owned()),
        (CONTENT_DISPOSITION, disposition),
        (CONTENT_LENGTH, file.n_bytes.to_string()),
    ];
    Ok((headers, Body::from_stream(file.into_chunks().await?)))
}

impl Wanted {
    fn format(&self) -> Result<MapFormat, ApiError> {
        match (self.format, self.part) {
            (Format::Ply, None) => Ok(MapFormat::Ply),
            (Format::Json, None) => Ok(MapFormat::Json),
            (Format::Transforms, None) => Ok(MapFormat::Transforms),
            (Format::Mcap, None) => Ok(MapFormat::Mcap),
            (Format::Colmap, Some(Part::Cameras)) => Ok(MapFormat::Colmap(ColmapPart::Cameras)),
            (Format::Colmap, Some(Part::Images)) => Ok(MapFormat::Colmap(ColmapPart::Images)),
            (Format::Colmap, Some(Part::Points3D)) => Ok(MapFormat::Colmap(ColmapPart::Points3D)),
            (Format::Colmap, None) => {
                Err(ApiError::invalid("part", "must be cameras, images or points3D with format=colmap"))
            }
            (_, Some(_)) => Err(ApiError::invalid("part", "is for format=colmap only")),
        }
    }
}
