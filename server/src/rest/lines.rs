//! Lines, by place.

use super::extract::{AskedBy, PageParams, Paged};
use super::place::parse_place;
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::ids::checked_id;
use crate::maps::{Line, LineQuery};
use crate::model::Scale;
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use slam::map::SubmapId;
use utoipa::{IntoParams, ToSchema};

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
    /// Lines seen by at least so many keyframes.
    min_observations: u32,
    /// Lines in this submap.
    submap_id: Option<u32>,
    /// Lines with this primitive's direction.
    primitive_id: Option<u64>,
}

impl Conditions {
    fn query(&self) -> Result<LineQuery, ApiError> {
        Ok(LineQuery {
            place: parse_place(self.bbox.as_deref(), self.near.as_deref(), self.radius)?,
            min_observations: self.min_observations,
            submap: self.submap_id.map(SubmapId),
            primitive: self.primitive_id.map(|number| checked_id("primitive_id", number)).transpose()?,
        })
    }
}

/// Lines in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/lines", tag = "maps",
    params(("id", description = "The session's id"), Conditions, PageParams), responses(
    (status = 200, description = "A page of lines", body = LinePage),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Paged(page, conditions): Paged<Conditions>,
) -> Result<Json<LinePage>, ApiError> {
    let id = caller.session(&id, "id")?;
    let answer = app.service.maps().lines(&id, &conditions.query()?, &page).await?;
    let (scale, page) = (answer.scale, answer.value);
    Ok(Json(LinePage { scale, lines: page.items, next_page_token: page.next_page_token }))
}
