//! Lines, by place.

use super::extract::Params;
use super::model::Scale;
use super::place::parse_place;
use super::units::Units;
use super::{App, Problem};
use crate::error::ApiError;
use crate::service::checked_page_size;
use crate::session::SessionId;
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use slam::map::{LineId, LineLandmark, PrimitiveId, SubmapId};
use store::LineQuery;
use utoipa::{IntoParams, ToSchema};

/// A line of the map: an infinite line and the part of it that was seen.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Line {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the line is in.
    submap_id: u32,
    /// One end of the part that was seen.
    start: [f64; 3],
    /// The other end.
    end: [f64; 3],
    /// Direction of the infinite line, of unit length (Plücker coordinates).
    direction: [f64; 3],
    /// Moment of the infinite line, a point on it times the direction (Plücker coordinates).
    moment: [f64; 3],
    /// Key frames that see it.
    n_observations: u32,
    /// The global primitive whose direction it has; `null` while none is known.
    primitive_id: Option<u64>,
}

/// Some lines in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct LinePage {
    /// What a length of 1 means.
    scale: Scale,
    /// The lines.
    lines: Vec<Line>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

impl Line {
    pub fn new(line: &LineLandmark, units: Units) -> Self {
        let [start, end] = line.endpoints;
        Self {
            id: line.id.get(),
            submap_id: line.submap.0,
            start: units.position(&start),
            end: units.position(&end),
            direction: (*line.line.direction()).into(),
            // A moment is a length.
            moment: units.position(line.line.moment()),
            n_observations: line.observations.len() as u32,
            primitive_id: line.primitive.map(PrimitiveId::get),
        }
    }
}

/// Which lines; every condition given must hold for the part of the line that was seen.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Conditions {
    /// Lines some part of which is in this box: `x_min,y_min,z_min,x_max,y_max,z_max`.
    #[param(value_type = Option<String>)]
    bbox: Option<String>,
    /// Lines some part of which is near this place, `x,y,z`; needs `radius`.
    #[param(value_type = Option<String>)]
    near: Option<String>,
    /// How far from `near`.
    radius: Option<f64>,
    /// Lines seen by at least so many key frames.
    min_observations: u32,
    /// Lines in this submap.
    submap_id: Option<u32>,
    /// Lines with this primitive's direction.
    primitive_id: Option<u64>,
    /// Entries on the page, at most 1000; 0 means 100.
    page_size: u32,
    /// `next_page_token` of the page before.
    page_token: String,
}

impl Conditions {
    fn query(&self, units: Units) -> Result<LineQuery, ApiError> {
        let (bounds, near) = parse_place(self.bbox.as_deref(), self.near.as_deref(), self.radius, units)?;
        let primitive = match self.primitive_id {
            None => None,
            Some(number) => Some(super::primitives::checked_id("primitive_id", number)?),
        };
        let submap = self.submap_id.map(SubmapId);
        Ok(LineQuery { bounds, near, min_observations: self.min_observations, submap, primitive })
    }
}

/// Lines in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/lines", tag = "maps",
    params(("id", description = "The session's id"), Conditions), responses(
    (status = 200, description = "A page of lines", body = LinePage),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(conditions): Params<Conditions>,
) -> Result<Json<LinePage>, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let after = match conditions.page_token.as_str() {
        "" => None,
        token => Some(parse_token(token)?),
    };
    let page_size = checked_page_size(conditions.page_size)?;
    let units = Units::of(&app, &id).await?;
    let page =
        app.service.store().lines_page(id.as_str(), &conditions.query(units)?, after, page_size).await?;
    Ok(Json(LinePage {
        scale: units.scale(),
        lines: page.lines.iter().map(|line| Line::new(line, units)).collect(),
        next_page_token: page.next.map(|id| id.to_string()),
    }))
}

fn parse_token(token: &str) -> Result<LineId, ApiError> {
    let id = token.parse().ok().and_then(LineId::new);
    id.ok_or_else(|| ApiError::invalid("page_token", "is none of a page of lines"))
}
