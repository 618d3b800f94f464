//! Errors as RFC 9457 `application/problem+json`.

use crate::error::{ApiError, ErrorCode};
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

/// Says where the server is reached by HTTP that works with the session.
const OWNER: HeaderName = HeaderName::from_static("monoslam-owner");

/// What went wrong (RFC 9457).
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ProblemDetails {
    /// Names the kind of problem; the end is `code`.
    #[serde(rename = "type")]
    #[schema(example = "urn:monoslam:error:SESSION_NOT_FOUND")]
    pub kind: String,
    /// The kind of problem in plain words.
    pub title: &'static str,
    /// The HTTP status.
    pub status: u16,
    /// What happened this time, in a plain sentence.
    pub detail: String,
    /// Stable name of the kind of problem.
    pub code: &'static str,
    /// The fields that are wrong.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub violations: Vec<Violation>,
}

/// One field that is wrong.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Violation {
    /// Path of the field.
    #[schema(example = "camera.fx")]
    pub field: String,
    /// What is wrong with it, in a plain sentence.
    pub description: String,
}

impl From<ApiError> for ProblemDetails {
    fn from(error: ApiError) -> Self {
        let ApiError { code, message, violations, retry_after: _, owner: _ } = error;
        Self {
            kind: format!("urn:monoslam:error:{}", code.name()),
            title: code.title(),
            status: code.http().as_u16(),
            detail: message,
            code: code.name(),
            violations: violations
                .into_iter()
                .map(|violation| Violation { field: violation.field, description: violation.description })
                .collect(),
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let status = self.code.http();
        let (retry_after, owner) = (self.retry_after, self.owner.clone());
        let body = serde_json::to_vec(&ProblemDetails::from(self)).unwrap_or_default();
        let mut response = (status, [(CONTENT_TYPE, "application/problem+json")], body).into_response();
        if let Some(wait) = retry_after {
            response.headers_mut().insert(RETRY_AFTER, HeaderValue::from(wait.as_secs_f64().ceil() as u64));
        }
        if let Some(url) = owner.and_then(|owner| HeaderValue::try_from(owner.http_url).ok()) {
            response.headers_mut().insert(OWNER, url);
        }
        if status == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer realm=\"monoslam\"");
            response.headers_mut().insert(WWW_AUTHENTICATE, scheme);
        }
        response
    }
}

/// Answer to a path there is not.
pub(super) async fn not_found(uri: axum::http::Uri) -> ApiError {
    ApiError::new(ErrorCode::NotFound, format!("there is nothing at {}", uri.path()))
}

/// Answer to a method a path does not take.
pub(super) async fn method_not_allowed(method: axum::http::Method, uri: axum::http::Uri) -> ApiError {
    ApiError::new(ErrorCode::MethodNotAllowed, format!("{} does not take {method}", uri.path()))
}
