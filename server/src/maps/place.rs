//! Places in questions.

use crate::error::ApiError;
use crate::model::Units;
use geometry::nalgebra::Vector3;
use store::Bounds;

/// Where landmarks are wanted; every condition given must hold. Lengths are as the session's scale says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Place {
    /// In this box.
    pub bbox: Option<BoundingBox>,
    /// Around this place; needs `radius`.
    pub near: Option<[f64; 3]>,
    /// How far from `near`.
    pub radius: Option<f64>,
}

/// A box with sides along the axes, its faces included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    /// Least coordinates.
    pub min: [f64; 3],
    /// Greatest coordinates.
    pub max: [f64; 3],
}

/// A center and a radius, map units.
type Ball = (Vector3<f64>, f64);

impl Place {
    /// The box and the ball asked for, in map units.
    ///
    /// # Errors
    /// If a number is not finite, the box is inside out, or half of the ball is missing.
    pub(super) fn in_map_units(&self, units: Units) -> Result<(Option<Bounds>, Option<Ball>), ApiError> {
        Ok((self.bbox.map(|bbox| bbox.in_map_units(units)).transpose()?, self.ball(units)?))
    }

    fn ball(&self, units: Units) -> Result<Option<Ball>, ApiError> {
        match (self.near, self.radius) {
            (None, None) => Ok(None),
            (Some(near), Some(radius)) => {
                check_finite("near", &near)?;
                if !(radius.is_finite() && radius >= 0.0) {
                    return Err(ApiError::invalid("radius", "must be a finite number, 0 or more"));
                }
                let center = near.map(|length| units.to_map(length)).into();
                Ok(Some((center, units.to_map(radius))))
            }
            (Some(_), None) => Err(ApiError::invalid("radius", "is needed with `near`")),
            (None, Some(_)) => Err(ApiError::invalid("near", "is needed with `radius`")),
        }
    }
}

impl BoundingBox {
    fn in_map_units(&self, units: Units) -> Result<Bounds, ApiError> {
        let Self { min, max } = self;
        check_finite("bbox", min)?;
        check_finite("bbox", max)?;
        if min.iter().zip(max).any(|(min, max)| min > max) {
            return Err(ApiError::invalid("bbox", "each minimum must be at most its maximum"));
        }
        let [min, max] = [min, max].map(|corner| corner.map(|length| units.to_map(length)).into());
        Ok(Bounds { min, max })
    }
}

fn check_finite(field: &str, numbers: &[f64]) -> Result<(), ApiError> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(());
    }
    Err(ApiError::invalid(field, "must be of finite numbers"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_a_metric_session_are_metres() {
        let units = Units::new(Some(2.0));
        let bbox = Some(BoundingBox { min: [0.0; 3], max: [1.0, 2.0, 4.0] });
        let place = Place { bbox, near: Some([2.0, 4.0, 6.0]), radius: Some(3.0) };
        let (bounds, near) = place.in_map_units(units).unwrap();
        assert_eq!(bounds.unwrap().max, Vector3::new(0.5, 1.0, 2.0));
        assert_eq!(near.unwrap(), (Vector3::new(1.0, 2.0, 3.0), 1.5));
        assert_eq!(units.position(&Vector3::new(0.5, 1.0, 2.0)), [1.0, 2.0, 4.0]);
    }

    #[test]
    fn half_a_ball_is_refused_by_the_name_of_the_other_half() {
        let field = |near, radius| {
            let error = Place { bbox: None, near, radius }.in_map_units(Units::new(None)).unwrap_err();
            error.violations[0].field.clone()
        };
        assert_eq!(field(Some([1.0, 2.0, 3.0]), None), "radius");
        assert_eq!(field(None, Some(1.0)), "near");
        assert_eq!(field(Some([1.0, 2.0, 3.0]), Some(-1.0)), "radius");
        assert_eq!(field(Some([1.0, f64::NAN, 3.0]), Some(1.0)), "near");
    }

    #[test]
    fn a_box_that_is_inside_out_or_endless_is_refused() {
        for (min, max) in [([0.0; 3], [1.0, 1.0, -1.0]), ([f64::NEG_INFINITY, 0.0, 0.0], [1.0; 3])] {
            let bbox = Some(BoundingBox { min, max });
            let error = Place { bbox, ..Place::default() }.in_map_units(Units::new(None)).unwrap_err();
            assert_eq!(error.violations[0].field, "bbox");
        }
    }
}
