//! Lines, by place.

use super::{Batches, MapQueries, Place, Scaled, batches};
use crate::error::ApiError;
use crate::model::Units;
use crate::page::{Page, PageRequest};
use crate::session::SessionId;
use serde::Serialize;
use slam::map::{LineLandmark, PrimitiveId, SubmapId};
use utoipa::ToSchema;

/// A line of the map: an infinite line and the part of it that was seen.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Line {
    /// Identity within the session.
    pub id: u64,
    /// The submap whose frame of reference the line is in.
    pub submap_id: u32,
    /// One end of the part that was seen.
    pub start: [f64; 3],
    /// The other end.
    pub end: [f64; 3],
    /// Direction of the infinite line, of unit length (Plücker coordinates).
    pub direction: [f64; 3],
    /// Moment of the infinite line, a point on it times the direction (Plücker coordinates).
    pub moment: [f64; 3],
    /// Keyframes that see it.
    pub n_observations: u32,
    /// The global primitive whose direction it has; `null` while none is known.
    pub primitive_id: Option<u64>,
}

/// Which lines are wanted; every condition given must hold for the part of the line that was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineQuery {
    /// Where some part of the line is.
    pub place: Place,
    /// Lines seen by at least so many keyframes.
    pub min_observations: u32,
    /// Lines in this submap.
    pub submap: Option<SubmapId>,
    /// Lines with this primitive's direction.
    pub primitive: Option<PrimitiveId>,
}

impl Line {
    pub(super) fn new(line: &LineLandmark, units: Units) -> Self {
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

impl LineQuery {
    fn in_map_units(&self, units: Units) -> Result<store::LineQuery, ApiError> {
        let (bounds, near) = self.place.in_map_units(units)?;
        let Self { place: _, min_observations, submap, primitive } = *self;
        Ok(store::LineQuery { bounds, near, min_observations, submap, primitive })
    }
}

impl MapQueries {
    /// A page of the wanted lines in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or a condition or the token cannot be used.
    pub async fn lines(
        &self,
        id: &SessionId,
        query: &LineQuery,
        page: &PageRequest,
    ) -> Result<Scaled<Page<Line>>, ApiError> {
        let after = page.after()?;
        let units = self.units(id).await?;
        let query = query.in_map_units(units)?;
        let lines = self.store.lines_page(id.as_str(), &query, after, page.size()).await?;
        Ok(Scaled::new(units, Page::of(lines, |line| Line::new(&line, units))))
    }

    /// Every wanted line in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or a condition cannot be used.
    pub async fn all_lines(
        &self,
        id: &SessionId,
        query: &LineQuery,
    ) -> Result<Scaled<Batches<Line>>, ApiError> {
        let units = self.units(id).await?;
        let lines = self.store.lines(id.as_str(), query.in_map_units(units)?).await?;
        Ok(Scaled::new(units, batches(lines, move |line| Line::new(&line, units))))
    }
}
