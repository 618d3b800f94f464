//! Points, by place.

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
use slam::map::{PointId, PointLandmark, SubmapId};
use store::PointQuery;
use utoipa::{IntoParams, ToSchema};

/// A point of the map.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Point {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the position is in.
    submap_id: u32,
    /// Position.
    position: [f64; 3],
    /// Key frames that see it.
    n_observations: u32,
}

/// Some points in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct PointPage {
    /// What a length of 1 means.
    scale: Scale,
    /// The points.
    points: Vec<Point>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

impl Point {
    pub fn new(point: &PointLandmark, units: Units) -> Self {
        Self {
            id: point.id.get(),
            submap_id: point.submap.0,
            position: units.position(&point.position),
            n_observations: point.observations.len() as u32,
        }
    }
}

/// Which points; every condition given must hold.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Conditions {
    /// Points in this box: `x_min,y_min,z_min,x_max,y_max,z_max`.
    #[param(value_type = Option<String>)]
    bbox: Option<String>,
    /// Points around this place, `x,y,z`; needs `radius`.
    #[param(value_type = Option<String>)]
    near: Option<String>,
    /// How far from `near`.
    radius: Option<f64>,
    /// Points seen by at least so many key frames.
    min_observations: u32,
    /// Points in this submap.
    submap_id: Option<u32>,
    /// Entries on the page, at most 1000; 0 means 100.
    page_size: u32,
    /// `next_page_token` of the page before.
    page_token: String,
}

impl Conditions {
    fn query(&self, units: Units) -> Result<PointQuery, ApiError> {
        let (bounds, near) = parse_place(self.bbox.as_deref(), self.near.as_deref(), self.radius, units)?;
        let submap = self.submap_id.map(SubmapId);
        Ok(PointQuery { bounds, near, min_observations: self.min_observations, submap })
    }
}

/// Points in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/points", tag = "maps",
    params(("id", description = "The session's id"), Conditions), responses(
    (status = 200, description = "A page of points", body = PointPage),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(conditions): Params<Conditions>,
) -> Result<Json<PointPage>, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let after = match conditions.page_token.as_str() {
        "" => None,
        token => Some(parse_token(token)?),
    };
    let page_size = checked_page_size(conditions.page_size)?;
    let units = Units::of(&app, &id).await?;
    let page =
        app.service.store().points_page(id.as_str(), &conditions.query(units)?, after, page_size).await?;
    Ok(Json(PointPage {
        scale: units.scale(),
        points: page.points.iter().map(|point| Point::new(point, units)).collect(),
        next_page_token: page.next.map(|id| id.to_string()),
    }))
}

fn parse_token(token: &str) -> Result<PointId, ApiError> {
    let id = token.parse().ok().and_then(PointId::new);
    id.ok_or_else(|| ApiError::invalid("page_token", "is none of a page of points"))
}
