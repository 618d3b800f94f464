//! Global primitives: the directions that keyframes share.

use super::extract::{AskedBy, PageParams, Paged};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::ids::parse_id;
use crate::maps::{Primitive, PrimitiveDetail};
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use slam::map::SubmapId;
use utoipa::{IntoParams, ToSchema};

/// Some primitives in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct PrimitivePage {
    /// The primitives.
    primitives: Vec<Primitive>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

/// Which primitives.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Conditions {
    /// Primitives of this submap.
    submap_id: Option<u32>,
}

/// Global primitives in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/primitives", tag = "maps",
    params(("id", description = "The session's id"), Conditions, PageParams), responses(
    (status = 200, description = "A page of primitives", body = PrimitivePage),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Paged(page, conditions): Paged<Conditions>,
) -> Result<Json<PrimitivePage>, ApiError> {
    let id = caller.session(&id, "id")?;
    let page = app.service.maps().primitives(&id, conditions.submap_id.map(SubmapId), &page).await?;
    Ok(Json(PrimitivePage { primitives: page.items, next_page_token: page.next_page_token }))
}

/// A global primitive with the keyframes it ties and the lines that have its direction.
#[utoipa::path(get, path = "/v1/sessions/{id}/primitives/{p}", tag = "maps",
    params(("id", description = "The session's id"), ("p", description = "The primitive's id")), responses(
    (status = 200, description = "The primitive", body = PrimitiveDetail),
    (status = 404, description = "No such primitive", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path((id, p)): Path<(String, String)>,
) -> Result<Json<PrimitiveDetail>, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(Json(app.service.maps().primitive(&id, parse_id("p", &p)?).await?))
}
