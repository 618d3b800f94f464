//! Global primitives: the directions that key frames share.

use super::extract::Params;
use super::{App, Problem};
use crate::error::{ApiError, ErrorCode};
use crate::service::checked_page_size;
use crate::session::SessionId;
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use slam::map::{GlobalPrimitive, KeyframeId, PrimitiveId, SubmapId};
use store::{LineQuery, PrimitiveRecord};
use tokio_stream::StreamExt;
use utoipa::{IntoParams, ToSchema};

/// A direction of the world that key frames share, whether or not they see the same place.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Primitive {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the direction is in.
    submap_id: u32,
    /// Unit vector in the world; it means the same as its negative.
    direction: [f64; 3],
    /// Covariance of the direction, row by row, radians squared. Of rank two: nothing is uncertain along the direction.
    covariance: [[f64; 3]; 3],
    /// Standard deviation of the direction where it is least certain, degrees.
    std_deg: f64,
    /// Key frames that show it.
    n_keyframes: u32,
    /// Lines that have its direction.
    n_lines: u64,
}

/// A primitive with what it rests on.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct PrimitiveDetail {
    /// The primitive.
    #[serde(flatten)]
    primitive: Primitive,
    /// The key frame that made it, which may have been removed since.
    created_by: u64,
    /// The key frames it ties.
    keyframes: Vec<u64>,
    /// The lines that have its direction; `GET …/lines?primitive_id=` tells where they are.
    lines: Vec<u64>,
}

/// Some primitives in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct PrimitivePage {
    /// The primitives.
    primitives: Vec<Primitive>,
    /// Where the next page begins; `null` on the last.
    next_page_token: Option<String>,
}

impl Primitive {
    pub fn new(primitive: &GlobalPrimitive, n_lines: u64) -> Self {
        let covariance = &primitive.covariance;
        let variance = covariance.symmetric_eigenvalues().max().max(0.0);
        Self {
            id: primitive.id.get(),
            submap_id: primitive.submap.0,
            direction: (*primitive.direction.as_vector()).into(),
            covariance: std::array::from_fn(|row| std::array::from_fn(|column| covariance[(row, column)])),
            std_deg: variance.sqrt().to_degrees(),
            n_keyframes: primitive.observations.len() as u32,
            n_lines,
        }
    }
}

impl From<PrimitiveRecord> for Primitive {
    fn from(record: PrimitiveRecord) -> Self {
        Self::new(&record.primitive, record.n_lines)
    }
}

/// Which page.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Page {
    /// Primitives of this submap.
    submap_id: Option<u32>,
    /// Entries on the page, at most 1000; 0 means 100.
    page_size: u32,
    /// `next_page_token` of the page before.
    page_token: String,
}

/// Global primitives in the order of their ids.
#[utoipa::path(get, path = "/v1/sessions/{id}/primitives", tag = "maps",
    params(("id", description = "The session's id"), Page), responses(
    (status = 200, description = "A page of primitives", body = PrimitivePage),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(page): Params<Page>,
) -> Result<Json<PrimitivePage>, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let after = match page.page_token.as_str() {
        "" => None,
        token => Some(parse_id("page_token", token)?),
    };
    let page_size = checked_page_size(page.page_size)?;
    let submap = page.submap_id.map(SubmapId);
    let page = app.service.store().primitives_page(id.as_str(), submap, after, page_size).await?;
    Ok(Json(PrimitivePage {
        primitives: page.primitives.into_iter().map(Primitive::from).collect(),
        next_page_token: page.next.map(|id| id.to_string()),
    }))
}

/// A global primitive with the key frames it ties and the lines that have its direction.
#[utoipa::path(get, path = "/v1/sessions/{id}/primitives/{p}", tag = "maps",
    params(("id", description = "The session's id"), ("p", description = "The primitive's id")), responses(
    (status = 200, description = "The primitive", body = PrimitiveDetail),
    (status = 404, description = "No such primitive", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    Path((id, p)): Path<(String, String)>,
) -> Result<Json<PrimitiveDetail>, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let primitive_id = parse_id("p", &p)?;
    let store = app.service.store();
    let record = store.primitive(id.as_str(), primitive_id).await?.ok_or_else(|| {
        let sentence = format!("session {id} has no primitive {primitive_id}");
        ApiError::new(ErrorCode::PrimitiveNotFound, sentence)
    })?;
    let query = LineQuery { primitive: Some(primitive_id), ..LineQuery::default() };
    let lines: Vec<u64> = store
        .lines(id.as_str(), query)
        .await?
        .map(|line| line.map(|line| line.id.get()))
        .collect::<Result<_, _>>()
        .await?;
    let keyframes = record.primitive.observations.iter().map(|seen| seen.keyframe);
    Ok(Json(PrimitiveDetail {
        created_by: record.primitive.created_by.get(),
        keyframes: keyframes.map(KeyframeId::get).collect(),
        // Both as of the same commit, or nearly: the lines are those that were just read.
        primitive: Primitive::new(&record.primitive, lines.len() as u64),
        lines,
    }))
}

fn parse_id(field: &str, text: &str) -> Result<PrimitiveId, ApiError> {
    text.parse().map_err(|_| ApiError::invalid(field, EXPECTED)).and_then(|number| checked_id(field, number))
}

const EXPECTED: &str = "must be a primitive's number, from 1 on";

/// A primitive's id that the database can look for.
pub(super) fn checked_id(field: &str, number: u64) -> Result<PrimitiveId, ApiError> {
    let id = Some(number).filter(|number| i64::try_from(*number).is_ok()).and_then(PrimitiveId::new);
    id.ok_or_else(|| ApiError::invalid(field, EXPECTED))
}
