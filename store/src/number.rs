//! Numbers between the domain's unsigned ones and SQLite's signed 64 bits.

use crate::StoreError;
use slam::map::{CameraId, KeyframeId, LineId, PointId, PrimitiveId, SubmapId};

/// Greatest sequence number the store takes.
pub const MAX_SEQUENCE: u64 = i64::MAX as u64;

/// A number as a column value.
pub(crate) fn to_column(what: &'static str, value: u64) -> Result<i64, StoreError> {
    i64::try_from(value).map_err(|_| StoreError::OutOfRange { what, value })
}

/// A column that holds a count or a sequence number.
pub(crate) fn from_column(what: &str, value: i64) -> Result<u64, StoreError> {
    u64::try_from(value).map_err(|_| StoreError::Corrupt(format!("{what} is {value}")))
}

/// As [`from_column`], for 32 bits.
pub(crate) fn from_column_u32(what: &str, value: i64) -> Result<u32, StoreError> {
    u32::try_from(value).map_err(|_| StoreError::Corrupt(format!("{what} is {value}")))
}

pub(crate) fn keyframe_id(value: i64) -> Result<KeyframeId, StoreError> {
    u64::try_from(value)
        .ok()
        .and_then(KeyframeId::new)
        .ok_or_else(|| StoreError::Corrupt(format!("a keyframe has the id {value}")))
}

pub(crate) fn point_id(value: i64) -> Result<PointId, StoreError> {
    u64::try_from(value)
        .ok()
        .and_then(PointId::new)
        .ok_or_else(|| StoreError::Corrupt(format!("a point has the id {value}")))
}

pub(crate) fn line_id(value: i64) -> Result<LineId, StoreError> {
    u64::try_from(value)
        .ok()
        .and_then(LineId::new)
        .ok_or_else(|| StoreError::Corrupt(format!("a line has the id {value}")))
}

pub(crate) fn primitive_id(value: i64) -> Result<PrimitiveId, StoreError> {
    u64::try_from(value)
        .ok()
        .and_then(PrimitiveId::new)
        .ok_or_else(|| StoreError::Corrupt(format!("a primitive has the id {value}")))
}

pub(crate) fn submap_id(value: i64) -> Result<SubmapId, StoreError> {
    from_column_u32("a submap", value).map(SubmapId)
}

pub(crate) fn camera_id(value: i64) -> Result<CameraId, StoreError> {
    from_column_u32("a camera's number", value).map(CameraId)
}

/// A keyframe's id as a column value.
pub(crate) fn keyframe_column(id: KeyframeId) -> Result<i64, StoreError> {
    to_column("keyframe id", id.get())
}
