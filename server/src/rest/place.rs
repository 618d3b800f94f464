//! Places in the part of the address after the question mark.

use super::extract::numbers;
use crate::error::ApiError;
use crate::maps::{BoundingBox, Place};

/// The box and the ball asked for.
///
/// # Errors
/// If one is not well formed.
pub(super) fn parse_place(
    bbox: Option<&str>,
    near: Option<&str>,
    radius: Option<f64>,
) -> Result<Place, ApiError> {
    let form = "x_min,y_min,z_min,x_max,y_max,z_max";
    let bbox = bbox.map(|text| numbers::<6>("bbox", text, form)).transpose()?;
    let bbox = bbox.map(|[x_min, y_min, z_min, x_max, y_max, z_max]| BoundingBox {
        min: [x_min, y_min, z_min],
        max: [x_max, y_max, z_max],
    });
    let near = near.map(|text| numbers::<3>("near", text, "x,y,z")).transpose()?;
    Ok(Place { bbox, near, radius })
}
