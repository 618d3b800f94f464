//! Places in requests.

use super::extract::numbers;
use super::units::Units;
use crate::error::ApiError;
use geometry::nalgebra::Vector3;
use store::Bounds;

/// A centre and a radius, map units.
type Ball = (Vector3<f64>, f64);

/// The box and the ball asked for, in map units.
///
/// # Errors
/// If one is not well formed, or half of the ball is missing.
pub(super) fn parse_place(
    bbox: Option<&str>,
    near: Option<&str>,
    radius: Option<f64>,
    units: Units,
) -> Result<(Option<Bounds>, Option<Ball>), ApiError> {
    let bounds = bbox.map(|text| parse_bounds(text, units)).transpose()?;
    let near = match (near, radius) {
        (None, None) => None,
        (Some(near), Some(radius)) => {
            if !(radius.is_finite() && radius >= 0.0) {
                return Err(ApiError::invalid("radius", "must be a finite number, 0 or more"));
            }
            let centre = numbers::<3>("near", near, "x,y,z")?.map(|length| units.to_map(length));
            Some((centre.into(), units.to_map(radius)))
        }
        (Some(_), None) => return Err(ApiError::invalid("radius", "is needed with `near`")),
        (None, Some(_)) => return Err(ApiError::invalid("near", "is needed with `radius`")),
    };
    Ok((bounds, near))
}

fn parse_bounds(text: &str, units: Units) -> Result<Bounds, ApiError> {
    let form = "x_min,y_min,z_min,x_max,y_max,z_max";
    let numbers = numbers::<6>("bbox", text, form)?.map(|length| units.to_map(length));
    let [x_min, y_min, z_min, x_max, y_max, z_max] = numbers;
    if x_min > x_max || y_min > y_max || z_min > z_max {
        return Err(ApiError::invalid("bbox", "each minimum must be at most its maximum"));
    }
    Ok(Bounds { min: [x_min, y_min, z_min].into(), max: [x_max, y_max, z_max].into() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_a_metric_session_are_metres() {
        let units = Units::new(Some(2.0));
        let (bounds, near) = parse_place(Some("0,0,0,1,2,4"), Some("2,4,6"), Some(3.0), units).unwrap();
        assert_eq!(bounds.unwrap().max, Vector3::new(0.5, 1.0, 2.0));
        assert_eq!(near.unwrap(), (Vector3::new(1.0, 2.0, 3.0), 1.5));
        assert_eq!(units.position(&Vector3::new(0.5, 1.0, 2.0)), [1.0, 2.0, 4.0]);
    }

    #[test]
    fn half_a_ball_is_refused_by_the_name_of_the_other_half() {
        let units = Units::new(None);
        let field =
            |near, radius| parse_place(None, near, radius, units).unwrap_err().violations[0].field.clone();
        assert_eq!(field(Some("1,2,3"), None), "radius");
        assert_eq!(field(None, Some(1.0)), "near");
        assert_eq!(field(Some("1,2,3"), Some(-1.0)), "radius");
    }
}
