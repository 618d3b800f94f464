//! The whole map as a file.
//!
//! A file needs to know how much is in it before it begins, and should be of one commit. So the map is read from one
//! commit into a file without a name, at the speed of the disk, and sent from there at the speed of the client: a slow
//! client keeps neither the database's log from being folded nor the map in memory.

mod colmap;
mod json;
mod ply;
mod spool;

use super::extract::Params;
use super::units::Units;
use super::{App, Problem};
use crate::error::ApiError;
use crate::session::SessionId;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use slam::map::SubmapId;
use spool::Spool;
use std::collections::BTreeMap;
use store::MapSnapshot;
use utoipa::{IntoParams, ToSchema};

/// How the map is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Format {
    /// Polygon file (ASCII): points as vertices, lines as edges between two vertices each.
    #[default]
    Ply,
    /// One object with key frames, points, lines and primitives.
    Json,
    /// COLMAP's text model, one `part` at a time.
    Colmap,
}

/// A file of a COLMAP text model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub(super) enum Part {
    /// `cameras.txt`: the session's camera.
    #[serde(rename = "cameras")]
    Cameras,
    /// `images.txt`: key frames with their keypoints.
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
    /// COLMAP: which file of the model. COLMAP puts the origin at the corner of the top-left pixel, half a pixel from
    /// where it is everywhere else here. Image names are `keyframe_` and the key frame's number with six digits; the
    /// images are at `…/keyframes/{kf}/image`. Reprojection errors are -1: not computed. Fetch the three parts while
    /// nobody streams: each is as of its own commit.
    #[param(inline)]
    part: Option<Part>,
    /// This submap only; submaps do not share a frame of reference. Left out, JSON has all of them, and the others the
    /// one with the most key frames.
    submap_id: Option<u32>,
}

/// The map as a file, as of one commit.
#[utoipa::path(get, path = "/v1/sessions/{id}/map", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The map", content(
        (String = "application/octet-stream"), (String = "text/plain"), (String = "application/json"))),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn map(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let part = match (wanted.format, wanted.part) {
        (Format::Colmap, None) => {
            return Err(ApiError::invalid("part", "must be cameras, images or points3D with format=colmap"));
        }
        (Format::Colmap, part) => part,
        (_, None) => None,
        (_, Some(_)) => return Err(ApiError::invalid("part", "is for format=colmap only")),
    };
    let snapshot = app.service.store().snapshot(id.as_str()).await?;
    let mut export = Export {
        units: Units::new(snapshot.record().metres_per_unit),
        snapshot,
        submap: wanted.submap_id.map(SubmapId),
        out: Spool::new(app.service.config().data_dir.clone()).await?,
    };
    if export.submap.is_none() && wanted.format != Format::Json {
        export.submap = Some(export.largest_submap().await?);
    }
    let (media_type, file_name) = match part {
        Some(Part::Cameras) => ("text/plain; charset=utf-8", "cameras.txt".to_owned()),
        Some(Part::Images) => ("text/plain; charset=utf-8", "images.txt".to_owned()),
        Some(Part::Points3D) => ("text/plain; charset=utf-8", "points3D.txt".to_owned()),
        None if wanted.format == Format::Ply => ("application/octet-stream", format!("{id}.ply")),
        None => ("application/json", format!("{id}.json")),
    };
    match part {
        Some(part) => colmap::write(&mut export, part).await?,
        None if wanted.format == Format::Ply => ply::write(&mut export).await?,
        None => json::write(&mut export).await?,
    }
    // The snapshot ends here, before the client reads the first byte.
    let Export { out, .. } = export;
    // Ids are letters, digits, `-` and `_`: nothing to escape.
    let disposition = format!("attachment; filename=\"{file_name}\"");
    let headers = [(CONTENT_TYPE, media_type.to_owned()), (CONTENT_DISPOSITION, disposition)];
    Ok((headers, out.into_body().await?))
}

/// A map on its way into a file.
struct Export {
    snapshot: MapSnapshot,
    units: Units,
    /// The submap wanted; `None` for all.
    submap: Option<SubmapId>,
    out: Spool,
}

impl Export {
    /// The submap with the most key frames, of equal ones the first.
    async fn largest_submap(&mut self) -> Result<SubmapId, ApiError> {
        let mut n_keyframes: BTreeMap<SubmapId, usize> = BTreeMap::new();
        let mut after = None;
        loop {
            let step = self.snapshot.keyframes_after(after).await?;
            let Some(last) = step.last() else { break };
            after = Some(last.id);
            step.iter().for_each(|record| *n_keyframes.entry(record.submap).or_default() += 1);
        }
        let largest = n_keyframes.iter().max_by_key(|(submap, n)| (**n, std::cmp::Reverse(**submap)));
        Ok(largest.map_or_else(SubmapId::default, |(submap, _)| *submap))
    }

    fn wants(&self, submap: SubmapId) -> bool {
        self.submap.is_none_or(|wanted| wanted == submap)
    }
}
