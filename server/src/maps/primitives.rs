//! Global primitives: the directions that keyframes share.

use super::{Batches, MapQueries, ROWS_PER_BATCH, batches_of_pages};
use crate::error::{ApiError, ErrorCode};
use crate::page::{Page, PageRequest};
use crate::session::SessionId;
use futures_util::stream::TryStreamExt;
use serde::Serialize;
use slam::map::{GlobalPrimitive, KeyframeId, PrimitiveId, SubmapId};
use store::{LineQuery, PrimitiveRecord};
use utoipa::ToSchema;

/// A direction of the world that keyframes share, whether or not they see the same place.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Primitive {
    /// Identity within the session.
    pub id: u64,
    /// The submap whose frame of reference the direction is in.
    pub submap_id: u32,
    /// Unit vector in the world; it means the same as its negative.
    pub direction: [f64; 3],
    /// Covariance of the direction, row by row, radians squared. Of rank two: nothing is uncertain along the
    /// direction.
    pub covariance: [[f64; 3]; 3],
    /// Standard deviation of the direction where it is least certain, degrees.
    pub std_deg: f64,
    /// Keyframes that show it.
    pub n_keyframes: u32,
    /// Lines that have its direction.
    pub n_lines: u64,
}

/// A primitive with what it rests on.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct PrimitiveDetail {
    /// The primitive.
    #[serde(flatten)]
    pub primitive: Primitive,
    /// The keyframe that made it, which may have been removed since.
    pub created_by: u64,
    /// The keyframes it ties.
    pub keyframes: Vec<u64>,
    /// The lines that have its direction; `GET …/lines?primitive_id=` tells where they are.
    pub lines: Vec<u64>,
}

impl Primitive {
    pub(super) fn new(primitive: &GlobalPrimitive, n_lines: u64) -> Self {
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

impl MapQueries {
    /// A page of the primitives of one submap, or of all, in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or the token cannot be used.
    pub async fn primitives(
        &self,
        id: &SessionId,
        submap: Option<SubmapId>,
        page: &PageRequest,
    ) -> Result<Page<Primitive>, ApiError> {
        let after = page.after()?;
        let primitives = self.store.primitives_page(id.as_str(), submap, after, page.size()).await?;
        Ok(Page::of(primitives, Primitive::from))
    }

    /// Every primitive of one submap, or of all, in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn all_primitives(
        &self,
        id: &SessionId,
        submap: Option<SubmapId>,
    ) -> Result<Batches<Primitive>, ApiError> {
        // A stream that is open tells no more that the session is not there.
        self.units(id).await?;
        let (store, id) = (self.store.clone(), id.clone());
        let read = move |after| {
            let (store, id) = (store.clone(), id.clone());
            async move { store.primitives_page(id.as_str(), submap, after, ROWS_PER_BATCH as u32).await }
        };
        Ok(batches_of_pages(read, Primitive::from))
    }

    /// A primitive with the keyframes it ties and the lines that have its direction.
    ///
    /// # Errors
    /// If there is no such session or primitive.
    pub async fn primitive(
        &self,
        id: &SessionId,
        primitive_id: PrimitiveId,
    ) -> Result<PrimitiveDetail, ApiError> {
        let record = self.store.primitive(id.as_str(), primitive_id).await?.ok_or_else(|| {
            let sentence = format!("session {id} has no primitive {primitive_id}");
            ApiError::new(ErrorCode::PrimitiveNotFound, sentence)
        })?;
        let query = LineQuery { primitive: Some(primitive_id), ..LineQuery::default() };
        let lines = self.store.lines(id.as_str(), query).await?;
        let lines: Vec<u64> = lines.map_ok(|line| line.id.get()).try_collect().await?;
        let keyframes = record.primitive.observations.iter().map(|seen| seen.keyframe);
        Ok(PrimitiveDetail {
            created_by: record.primitive.created_by.get(),
            keyframes: keyframes.map(KeyframeId::get).collect(),
            // Both as of the same commit, or nearly: the lines are those that were just read.
            primitive: Primitive::new(&record.primitive, lines.len() as u64),
            lines,
        })
    }
}
