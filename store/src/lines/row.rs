//! A line as columns.

use crate::StoreError;
use crate::blob::{decode_descriptor, decode_observations, encode_descriptor, encode_observations};
use crate::engine::Row;
use crate::number::{
    from_column_u32, keyframe_column, keyframe_id, line_id, primitive_id, submap_id, to_column,
};
use crate::points::cell::MAX_POINT_ID;
use geometry::Line3;
use nalgebra::Vector3;
use slam::map::LineLandmark;

/// The columns of a line after its session, in the order [`parse_line`] expects.
pub(crate) const LINE_COLUMNS: &str = "id, submap, moment_x, moment_y, moment_z, direction_x, direction_y, \
     direction_z, start_x, start_y, start_z, end_x, end_y, end_z, descriptor, created_by, n_visible, n_found, \
     primitive, n_observations, observations";

/// How many there are.
pub(crate) const N_LINE_COLUMNS: usize = 21;

/// A line in the form of its row.
pub(crate) struct LineRow {
    pub id: i64,
    pub submap: i64,
    /// Moment, direction, start and end.
    pub place: [Vector3<f64>; 4],
    pub descriptor: [u8; 32],
    pub created_by: i64,
    pub n_visible: u32,
    pub n_found: u32,
    pub primitive: Option<i64>,
    pub n_observations: i64,
    pub observations: Vec<u8>,
}

impl LineRow {
    /// Takes a line apart, refusing numbers that are not finite.
    pub fn new(line: &LineLandmark) -> Result<Self, StoreError> {
        let id = line.id.get();
        if id > MAX_POINT_ID {
            return Err(StoreError::OutOfRange { what: "line id", value: id });
        }
        if !line.is_finite() {
            return Err(StoreError::NotFinite(format!("line {id}")));
        }
        let [start, end] = line.endpoints;
        Ok(Self {
            id: id as i64,
            submap: i64::from(line.submap.0),
            place: [*line.line.moment(), *line.line.direction(), start, end],
            descriptor: encode_descriptor(&line.descriptor),
            created_by: keyframe_column(line.created_by)?,
            n_visible: line.n_visible,
            n_found: line.n_found,
            primitive: line.primitive.map(|id| to_column("primitive id", id.get())).transpose()?,
            n_observations: line.observations.len() as i64,
            observations: encode_observations(&line.observations),
        })
    }
}

/// A line from [`LINE_COLUMNS`].
pub(crate) fn parse_line(row: &Row) -> Result<LineLandmark, StoreError> {
    let id = line_id(row.try_get(0)?)?;
    let corrupt = |what: &dyn std::fmt::Display| StoreError::Corrupt(format!("line {id}: {what}"));
    let vector = |first: usize| -> Result<Vector3<f64>, StoreError> {
        Ok(Vector3::new(row.try_get(first)?, row.try_get(first + 1)?, row.try_get(first + 2)?))
    };
    let (moment, direction) = (vector(2)?, vector(5)?);
    let primitive: Option<i64> = row.try_get(18)?;
    let line = LineLandmark {
        id,
        submap: submap_id(row.try_get(1)?)?,
        line: Line3::from_stored(moment, direction).ok_or_else(|| corrupt(&"it is no Plücker line"))?,
        endpoints: [vector(8)?, vector(11)?],
        descriptor: decode_descriptor(row.try_get(14)?).map_err(|error| corrupt(&error))?,
        created_by: keyframe_id(row.try_get(15)?)?,
        n_visible: from_column_u32("n_visible", row.try_get(16)?)?,
        n_found: from_column_u32("n_found", row.try_get(17)?)?,
        primitive: primitive.map(primitive_id).transpose()?,
        observations: decode_observations(row.try_get(20)?).map_err(|error| corrupt(&error))?,
    };
    let n_observations: i64 = row.try_get(19)?;
    if n_observations != line.observations.len() as i64 {
        return Err(StoreError::Corrupt(format!("line {id} has the wrong number of observations")));
    }
    Ok(line)
}
