//! Points, by place.

use super::extract::{Params, numbers};
use super::{App, Problem};
use crate::error::ApiError;
use crate::service::checked_page_size;
use crate::session::SessionId;
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use slam::map::{PointId, PointLandmark, SubmapId};
use store::{Bounds, PointQuery};
use utoipa::{IntoParams, ToSchema};

/// A point of the map.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Point {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the position is in.
    submap_id: u32,
    /// Position, map units.
    position: [f64; 3],
    /// Key frames that see it.
    n_observations: u32,
}

/// Some points in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct PointPage {
    /// The points.
    points: Vec<Point>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

impl From<PointLandmark> for Point {
    fn from(point: PointLandmark) -> Self {
        let PointLandmark { id, submap, position, observations, .. } = point;
        let position = [position.x, position.y, position.z];
        Self { id: id.get(), submap_id: submap.0, position, n_observations: observations.len() as u32 }
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
    /// How far from `near`, map units.
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
    fn query(&self) -> Result<PointQuery, ApiError> {
        let bounds = self.bbox.as_deref().map(parse_bounds).transpose()?;
        let near = match (self.near.as_deref(), self.radius) {
            (None, None) => None,
            (Some(near), Some(radius)) => {
                if !(radius.is_finite() && radius >= 0.0) {
                    return Err(ApiError::invalid("radius", "must be a finite number, 0 or more"));
                }
                Some((numbers::<3>("near", near, "x,y,z")?.into(), radius))
            }
            (Some(_), None) => return Err(ApiError::invalid("radius", "is needed with `near`")),
            (None, Some(_)) => return Err(ApiError::invalid("near", "is needed with `radius`")),
        };
        let submap = self.submap_id.map(SubmapId);
        Ok(PointQuery { bounds, near, min_observations: self.min_observations, submap })
    }
}

fn parse_bounds(text: &str) -> Result<Bounds, ApiError> {
    let form = "x_min,y_min,z_min,x_max,y_max,z_max";
    let [x_min, y_min, z_min, x_max, y_max, z_max] = numbers::<6>("bbox", text, form)?;
    if x_min > x_max || y_min > y_max || z_min > z_max {
        return Err(ApiError::invalid("bbox", "each minimum must be at most its maximum"));
    }
    Ok(Bounds { min: [x_min, y_min, z_min].into(), max: [x_max, y_max, z_max].into() })
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
    let page = app.service.store().points_page(id.as_str(), &conditions.query()?, after, page_size).await?;
    Ok(Json(PointPage {
        points: page.points.into_iter().map(Point::from).collect(),
        next_page_token: page.next.map(|id| id.to_string()),
    }))
}

fn parse_token(token: &str) -> Result<PointId, ApiError> {
    let id = token.parse().ok().and_then(PointId::new);
    id.ok_or_else(|| ApiError::invalid("page_token", "is none of a page of points"))
}
