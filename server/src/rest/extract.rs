//! Parts of a request, with errors that name what is wrong.

use crate::access::Caller;
use crate::error::{ApiError, ErrorCode};
use crate::page::PageRequest;
use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::request::Parts;
use axum::http::{StatusCode, Uri};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use utoipa::IntoParams;

/// Who asks, as the door found out.
pub struct AskedBy(pub Caller);

impl<S: Send + Sync> FromRequestParts<S> for AskedBy {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let caller = parts.extensions.get::<Caller>().cloned();
        caller.map(Self).ok_or_else(|| ApiError::internal("a route is not behind the door"))
    }
}

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

/// The part of the address after the question mark, of a list: which page of it, and the conditions.
pub struct Paged<T>(pub PageRequest, pub T);

/// Which page.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageParams {
    /// Entries on the page, at most 1000; 0 means 100.
    page_size: u32,
    /// `next_page_token` of the page before.
    page_token: String,
}

/// A list that is not asked anything but the page.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoConditions {}

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Paged<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, ApiError> {
        let query = parts.uri.query().unwrap_or_default();
        let is_of_page = |pair: &&str| pair.starts_with("page_size=") || pair.starts_with("page_token=");
        // Each half knows its own names only and refuses every other one.
        let (page, conditions): (Vec<_>, Vec<_>) =
            query.split('&').filter(|pair| !pair.is_empty()).partition(is_of_page);
        let PageParams { page_size, page_token } = parse_query(&page)?;
        Ok(Self(PageRequest::new(page_size, page_token)?, parse_query(&conditions)?))
    }
}

fn parse_query<T: DeserializeOwned>(pairs: &[&str]) -> Result<T, ApiError> {
    let uri = Uri::try_from(format!("/?{}", pairs.join("&"))).map_err(ApiError::internal)?;
    let parsed = Query::try_from_uri(&uri);
    parsed.map(|Query(parsed)| parsed).map_err(|rejection| ApiError::invalid("query", rejection.body_text()))
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
