//! A point as columns.

use super::cell::MAX_POINT_ID;
use crate::StoreError;
use crate::blob::{decode_descriptor, decode_observations, encode_descriptor, encode_observations};
use crate::engine::Row;
use crate::number::{from_column_u32, keyframe_column, keyframe_id, point_id, submap_id};
use nalgebra::Vector3;
use slam::map::{PointId, PointLandmark, SubmapId};

/// Where a point is, without what recognizing it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedPoint {
    /// Identity within the session.
    pub id: PointId,
    /// The submap whose frame of reference the position is in.
    pub submap: SubmapId,
    /// Position in the world, map units.
    pub position: Vector3<f64>,
    /// Keyframes that see it.
    pub n_observations: u32,
}

/// How much of a point is read: columns cost more than rows.
pub(crate) struct Form<T> {
    /// After the session.
    pub columns: &'static str,
    /// From these columns.
    pub parse: fn(&Row) -> Result<T, StoreError>,
    /// Of what was parsed.
    pub id: fn(&T) -> PointId,
}

/// All of it.
pub(crate) const WHOLE: Form<PointLandmark> =
    Form { columns: POINT_COLUMNS, parse: parse_point, id: |point| point.id };

/// Where it is.
pub(crate) const PLACED: Form<PlacedPoint> =
    Form { columns: "id, submap, x, y, z, n_observations", parse: parse_placed, id: |point| point.id };

/// The columns of a point after its session, in the order [`parse_point`] expects.
pub(crate) const POINT_COLUMNS: &str = "id, submap, x, y, z, descriptor, view_x, view_y, view_z, min_distance, \
     max_distance, created_by, n_visible, n_found, observations, n_observations";

/// A point in the form of its row.
pub(crate) struct PointRow {
    pub id: i64,
    pub submap: i64,
    pub position: Vector3<f64>,
    pub descriptor: [u8; 32],
    pub view: Vector3<f64>,
    pub distance_range: (f64, f64),
    pub created_by: i64,
    pub n_visible: u32,
    pub n_found: u32,
    pub observations: Vec<u8>,
    pub n_observations: i64,
}

impl PointRow {
    /// Takes a point apart, refusing numbers that are not finite.
    pub fn new(point: &PointLandmark) -> Result<Self, StoreError> {
        let id = point.id.get();
        if id > MAX_POINT_ID {
            return Err(StoreError::OutOfRange { what: "point id", value: id });
        }
        let (nearest, farthest) = point.distance_range;
        // The farthest may be infinite: the point has not been seen from a distance that means anything yet.
        let numbers = point.position.iter().chain(&point.mean_view_direction).chain([&nearest]);
        if !numbers.into_iter().all(|value| value.is_finite()) || farthest.is_nan() {
            return Err(StoreError::NotFinite(format!("point {id}")));
        }
        Ok(Self {
            id: id as i64,
            submap: i64::from(point.submap.0),
            position: point.position,
            descriptor: encode_descriptor(&point.descriptor),
            view: point.mean_view_direction,
            distance_range: point.distance_range,
            created_by: keyframe_column(point.created_by)?,
            n_visible: point.n_visible,
            n_found: point.n_found,
            observations: encode_observations(&point.observations),
            n_observations: point.observations.len() as i64,
        })
    }
}

fn parse_placed(row: &Row) -> Result<PlacedPoint, StoreError> {
    Ok(PlacedPoint {
        id: point_id(row.try_get(0)?)?,
        submap: submap_id(row.try_get(1)?)?,
        position: Vector3::new(row.try_get(2)?, row.try_get(3)?, row.try_get(4)?),
        n_observations: from_column_u32("n_observations", row.try_get(5)?)?,
    })
}

/// A point from [`POINT_COLUMNS`].
pub(crate) fn parse_point(row: &Row) -> Result<PointLandmark, StoreError> {
    let id = point_id(row.try_get(0)?)?;
    let corrupt = |error| StoreError::Corrupt(format!("point {id}: {error}"));
    let vector = |first: usize| -> Result<Vector3<f64>, StoreError> {
        Ok(Vector3::new(row.try_get(first)?, row.try_get(first + 1)?, row.try_get(first + 2)?))
    };
    let point = PointLandmark {
        id,
        submap: submap_id(row.try_get(1)?)?,
        position: vector(2)?,
        descriptor: decode_descriptor(row.try_get(5)?).map_err(corrupt)?,
        mean_view_direction: vector(6)?,
        distance_range: (row.try_get(9)?, row.try_get(10)?),
        created_by: keyframe_id(row.try_get(11)?)?,
        n_visible: from_column_u32("n_visible", row.try_get(12)?)?,
        n_found: from_column_u32("n_found", row.try_get(13)?)?,
        observations: decode_observations(row.try_get(14)?).map_err(corrupt)?,
    };
    let n_observations: i64 = row.try_get(15)?;
    if n_observations != point.observations.len() as i64 {
        return Err(StoreError::Corrupt(format!("point {id} has the wrong number of observations")));
    }
    Ok(point)
}
