//! Parts of a request, with errors that name what is wrong.

use crate::access::Caller;
use crate::error::{ApiError, ErrorCode};
use crate::page::PageRequest;
use axum::Json;
use axum::extract::multipart::{Multipart, MultipartError};
use axum::extract::rejection::JsonRejection;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::http::{StatusCode, Uri};
use bytes::Bytes;
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

/// Why a body was not let in, if that is what keeps it from being read.
fn refusal_in(error: &(dyn std::error::Error + 'static)) -> Option<ApiError> {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.filter_map(|error| error.downcast_ref::<ApiError>()).next().cloned()
}

fn body_error(rejection: &JsonRejection) -> ApiError {
    if let Some(refusal) = refusal_in(rejection) {
        return refusal;
    }
    if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
        return ApiError::new(ErrorCode::MessageTooLarge, rejection.body_text());
    }
    if rejection.status() == StatusCode::UNSUPPORTED_MEDIA_TYPE {
        let sentence = "a JSON body is needed, with the header `content-type: application/json`";
        return ApiError::new(ErrorCode::UnsupportedMediaType, sentence);
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

/// A file in a body: the body itself, whatever image it is said to be, since its bytes tell; or, of a form,
/// its part of that name, else its first with a file.
///
/// # Errors
/// If the body is said to be something else than an image, is too large, or cannot be read.
pub async fn file_of(request: Request, part: &str) -> Result<Bytes, ApiError> {
    let said = request.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let essence = said.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "multipart/form-data" => part_of(request, part).await,
        // The second is what curl says of any data that it is not told of.
        "" | "application/x-www-form-urlencoded" | "application/octet-stream" | "binary/octet-stream" => {
            body_of(request).await
        }
        image if image.starts_with("image/") => body_of(request).await,
        other => {
            let sentence =
                format!("{other:?} is no image: send the file with a type such as image/jpeg, or in a form");
            Err(ApiError::new(ErrorCode::UnsupportedMediaType, sentence))
        }
    }
}

const FILE_TOO_LARGE: &str = "the image is larger than the server takes";

async fn body_of(request: Request) -> Result<Bytes, ApiError> {
    Bytes::from_request(request, &()).await.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => ApiError::new(ErrorCode::MessageTooLarge, FILE_TOO_LARGE),
        _ => refusal_in(&rejection).unwrap_or_else(|| ApiError::invalid("body", rejection.body_text())),
    })
}

async fn part_of(request: Request, wanted: &str) -> Result<Bytes, ApiError> {
    let refused = |error: MultipartError| match error.status() {
        StatusCode::PAYLOAD_TOO_LARGE => ApiError::new(ErrorCode::MessageTooLarge, FILE_TOO_LARGE),
        _ => refusal_in(&error).unwrap_or_else(|| ApiError::invalid("body", error.body_text())),
    };
    let form = Multipart::from_request(request, &()).await;
    let mut form = form.map_err(|rejection| ApiError::invalid("body", rejection.body_text()))?;
    let mut first = None;
    while let Some(part) = form.next_field().await.map_err(refused)? {
        let (is_wanted, is_file) = (part.name() == Some(wanted), part.file_name().is_some());
        if is_wanted {
            return part.bytes().await.map_err(refused);
        }
        if is_file && first.is_none() {
            first = Some(part.bytes().await.map_err(refused)?);
        }
    }
    first
        .ok_or_else(|| ApiError::invalid(wanted, format!("the form has no file: send it as part {wanted:?}")))
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
