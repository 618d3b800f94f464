//! Deadlines of calls, as clients send them in `grpc-timeout`.

use axum::extract::Request;
use axum::http::HeaderMap;
use axum::middleware::Next;
use axum::response::Response;
use std::time::Duration;
use tonic::Status;

/// Gives up a call whose answer has not begun when its client stops waiting.
pub async fn keep(request: Request, next: Next) -> Response {
    let Some(timeout) = timeout(request.headers()) else { return next.run(request).await };
    let answered = tokio::time::timeout(timeout, next.run(request)).await;
    answered.unwrap_or_else(|_elapsed| {
        Status::deadline_exceeded("the answer was not there when the call's deadline came").into_http()
    })
}

/// Up to eight digits and a unit [gRPC over HTTP/2, "Timeout"].
fn timeout(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let n: u64 = digits.parse().ok().filter(|_| (1..=8).contains(&digits.len()))?;
    match unit {
        "H" => Some(Duration::from_secs(n * 3600)),
        "M" => Some(Duration::from_secs(n * 60)),
        "S" => Some(Duration::from_secs(n)),
        "m" => Some(Duration::from_millis(n)),
        "u" => Some(Duration::from_micros(n)),
        "n" => Some(Duration::from_nanos(n)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn timeouts_are_read_as_they_are_sent() {
        let read = |text| {
            timeout(&HeaderMap::from_iter([(
                "grpc-timeout".parse().unwrap(),
                HeaderValue::from_static(text),
            )]))
        };
        assert_eq!(read("250m"), Some(Duration::from_millis(250)));
        assert_eq!(read("3H"), Some(Duration::from_secs(10_800)));
        for text in ["", "S", "5", "5d", "123456789S", "-1S"] {
            assert_eq!(read(text), None, "{text}");
        }
    }
}
