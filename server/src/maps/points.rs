//! Points, by place.

use super::{Batches, MapQueries, Place, Scaled, batches};
use crate::error::ApiError;
use crate::model::Units;
use crate::page::{Page, PageRequest};
use crate::session::SessionId;
use serde::Serialize;
use slam::map::{PointLandmark, SubmapId};
use store::PlacedPoint;
use utoipa::ToSchema;

/// A point of the map.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Point {
    /// Identity within the session.
    pub id: u64,
    /// The submap whose frame of reference the position is in.
    pub submap_id: u32,
    /// Position.
    pub position: [f64; 3],
    /// Keyframes that see it.
    pub n_observations: u32,
}

/// Which points are wanted; every condition given must hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointQuery {
    /// Where.
    pub place: Place,
    /// Points seen by at least so many keyframes.
    pub min_observations: u32,
    /// Points in this submap.
    pub submap: Option<SubmapId>,
}

impl Point {
    pub(super) fn new(point: &PointLandmark, units: Units) -> Self {
        Self {
            id: point.id.get(),
            submap_id: point.submap.0,
            position: units.position(&point.position),
            n_observations: point.observations.len() as u32,
        }
    }
}

impl From<(PlacedPoint, Units)> for Point {
    fn from((point, units): (PlacedPoint, Units)) -> Self {
        Self {
            id: point.id.get(),
            submap_id: point.submap.0,
            position: units.position(&point.position),
            n_observations: point.n_observations,
        }
    }
}

impl PointQuery {
    fn in_map_units(&self, units: Units) -> Result<store::PointQuery, ApiError> {
        let (bounds, near) = self.place.in_map_units(units)?;
        let Self { place: _, min_observations, submap } = *self;
        Ok(store::PointQuery { bounds, near, min_observations, submap })
    }
}

impl MapQueries {
    /// A page of the wanted points in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or a condition or the token cannot be used.
    pub async fn points(
        &self,
        id: &SessionId,
        query: &PointQuery,
        page: &PageRequest,
    ) -> Result<Scaled<Page<Point>>, ApiError> {
        let after = page.after()?;
        let units = self.units(id).await?;
        let query = query.in_map_units(units)?;
        let points = self.store.placed_points_page(id.as_str(), &query, after, page.size()).await?;
        Ok(Scaled::new(units, Page::of(points, |point| Point::from((point, units)))))
    }

    /// Every wanted point in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or a condition cannot be used.
    pub async fn all_points(
        &self,
        id: &SessionId,
        query: &PointQuery,
    ) -> Result<Scaled<Batches<Point>>, ApiError> {
        let units = self.units(id).await?;
        let points = self.store.placed_points(id.as_str(), query.in_map_units(units)?).await?;
        Ok(Scaled::new(units, batches(points, move |point| Point::from((point, units)))))
    }
}
