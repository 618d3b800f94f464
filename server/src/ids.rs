//! Numbers of things in a map, as callers write them.

use crate::error::ApiError;
use slam::map::{KeyframeId, LineId, PointId, PrimitiveId};
use std::fmt::Display;

/// A number that names a row of a map.
pub trait RowId: Copy + Display + Send + 'static {
    /// What it names, with its article.
    const NAME: &'static str;

    /// The id of this number, counted from 1.
    fn from_number(number: u64) -> Option<Self>;
}

macro_rules! row_id {
    ($id:ident, $name:literal) => {
        impl RowId for $id {
            const NAME: &'static str = $name;

            fn from_number(number: u64) -> Option<Self> {
                Self::new(number)
            }
        }
    };
}
row_id!(KeyframeId, "a keyframe");
row_id!(PointId, "a point");
row_id!(LineId, "a line");
row_id!(PrimitiveId, "a primitive");

/// An id that the database can look for; `field` is what an error calls it.
///
/// # Errors
/// If the number is 0 or larger than any that is stored.
pub fn checked_id<K: RowId>(field: &str, number: u64) -> Result<K, ApiError> {
    let storable = Some(number).filter(|number| i64::try_from(*number).is_ok());
    storable.and_then(K::from_number).ok_or_else(|| no_number_of::<K>(field))
}

/// An id in text; as [`checked_id`].
///
/// # Errors
/// If the text is no such number.
pub fn parse_id<K: RowId>(field: &str, text: &str) -> Result<K, ApiError> {
    let number = text.parse().map_err(|_| no_number_of::<K>(field))?;
    checked_id(field, number)
}

fn no_number_of<K: RowId>(field: &str) -> ApiError {
    ApiError::invalid(field, format!("must be the number of {}, from 1 on", K::NAME))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_that_can_be_stored_are_ids() {
        assert_eq!(parse_id::<KeyframeId>("kf", "7").unwrap().get(), 7);
        let largest = i64::MAX as u64;
        assert_eq!(checked_id::<LineId>("x", largest).unwrap().get(), largest);
        for text in ["", "0", "-1", "1.0", " 1", "a", "9223372036854775808", "99999999999999999999"] {
            let error = parse_id::<PointId>("page_token", text).unwrap_err();
            assert_eq!(error.violations[0].field, "page_token", "{text:?}");
            assert!(error.message.contains("a point"), "{}", error.message);
        }
    }
}
