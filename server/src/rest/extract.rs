//! Parts of a request, with errors that name what is wrong.

use crate::error::{ApiError, ErrorCode};
use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::StatusCode;
use axum::http::request::Parts;
use serde::de::DeserializeOwned;

/// A JSON body.
pub struct Body<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, state: &S) -> Result<Self, ApiError> {
        match Json::from_request(request, state).await {
            Ok(Json(body)) => Ok(Self(body)),
            Err(rejection) => Err(body_error(&rejection)),
        }
    }
}

fn body_error(rejection: &JsonRejection) -> ApiError {
    if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
        return ApiError::new(ErrorCode::MessageTooLarge, rejection.body_text());
    }
    ApiError::invalid("body", rejection.body_text())
}

/// The part of the address after the question mark.
pub struct Params<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        match Query::from_request_parts(parts, state).await {
            Ok(Query(params)) => Ok(Self(params)),
            Err(rejection) => Err(ApiError::invalid("query", rejection.body_text())),
        }
    }
}

/// Comma-separated finite numbers, exactly `N` of them.
///
/// # Errors
/// A sentence that says what is expected.
pub fn numbers<const N: usize>(field: &str, text: &str, form: &str) -> Result<[f64; N], ApiError> {
    let parsed: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    parsed
        .ok()
        .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| {
            ApiError::invalid(field, format!("must be {form}, {N} finite numbers with commas between"))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_counted_and_finite() {
        assert_eq!(numbers::<3>("near", "1, -2.5,3e2", "x,y,z").unwrap(), [1.0, -2.5, 300.0]);
        for text in ["", "1,2", "1,2,3,4", "1,2,NaN", "1,2,inf", "a,b,c", "1,,2"] {
            let error = numbers::<3>("near", text, "x,y,z").unwrap_err();
            assert_eq!(error.violations[0].field, "near", "{text}");
        }
    }
}
