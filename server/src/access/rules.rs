//! What each route and each call needs. What stands nowhere here needs an administrator, so that a new one is
//! closed until somebody has thought about it.

use super::Role;
use axum::http::Method;

/// What it takes to be let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing: it tells nothing about anybody.
    Nothing,
    /// As an administrator, unless the configuration says that it is public.
    Metrics,
    /// A caller with this role or a higher one.
    Role(Role),
}

/// Full name of the service.
const SERVICE: &str = "monoslam.v1.SlamService";

/// Calls that read.
const READING: [&str; 12] = [
    "GetSession",
    "ListSessions",
    "Localize",
    "WatchMap",
    "ListKeyframes",
    "QueryPoints",
    "QueryLines",
    "ListPrimitives",
    "GetTrajectory",
    "ExportMap",
    "GetOperation",
    "ListOperations",
];

/// Calls that change something.
const WRITING: [&str; 8] = [
    "CreateSession",
    "DeleteSession",
    "UpdateSession",
    "SetScale",
    "OptimizeMap",
    "MergeSessions",
    "CancelOperation",
    "StreamFrames",
];

/// What a gRPC call needs, by its path.
pub fn of_call(path: &str) -> Need {
    let Some((service, method)) = path.trim_start_matches('/').split_once('/') else {
        return Need::Role(Role::Admin);
    };
    match service {
        SERVICE if READING.contains(&method) => Need::Role(Role::Reader),
        SERVICE if WRITING.contains(&method) => Need::Role(Role::Writer),
        // What the service looks like is in every program; whether it lives is for those that watch it.
        "grpc.health.v1.Health"
        | "grpc.reflection.v1.ServerReflection"
        | "grpc.reflection.v1alpha.ServerReflection" => Need::Nothing,
        _ => Need::Role(Role::Admin),
    }
}

/// What a request needs, by its method and path.
pub fn of_route(method: &Method, path: &str) -> Need {
    let segments: Vec<&str> = path.split('/').skip(1).collect();
    let is_reading = matches!(*method, Method::GET | Method::HEAD);
    match (segments.as_slice(), is_reading) {
        (["" | "capture" | "favicon.svg" | "openapi.json" | "healthz" | "readyz"], true) => Need::Nothing,
        (["assets" | "api", ..], true) => Need::Nothing,
        (["metrics"], true) => Need::Metrics,
        // The cookie of who has no token any more can be cleared.
        (["v1", "tickets"], _) if *method == Method::DELETE => Need::Nothing,
        (["v1", "tickets"], _) => Need::Role(Role::Reader),
        // gRPC-Web.
        ([service, _], false) if *service == SERVICE => of_call(path),
        (["v1", "fleet"], true) => Need::Role(Role::Admin),
        (["v1", "sessions", _, "stream"], _) => Need::Role(Role::Writer),
        (["v1", "sessions", _, "localize"], _) => Need::Role(Role::Reader),
        (["v1", "localize"], _) => Need::Role(Role::Reader),
        (["v1", "operations", ..], true) => Need::Role(Role::Reader),
        (["v1", "operations", ..], false) => Need::Role(Role::Writer),
        (["v1", "sessions", ..], true) => Need::Role(Role::Reader),
        (["v1", "sessions", ..], false) => Need::Role(Role::Writer),
        _ => Need::Role(Role::Admin),
    }
}

/// Whether a request can change something, though its method may read.
pub fn is_changing(method: &Method, path: &str) -> bool {
    !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS) || path.ends_with("/stream")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_call_of_the_contract_is_in_one_list() {
        let service = proto::FILE_DESCRIPTOR_SET;
        for method in READING.iter().chain(&WRITING) {
            let there = service.windows(method.len()).any(|window| window == method.as_bytes());
            assert!(there, "the contract has no {method}");
            assert!(!(READING.contains(method) && WRITING.contains(method)));
        }
        assert_eq!(of_call("/monoslam.v1.SlamService/Unheard"), Need::Role(Role::Admin));
        assert_eq!(of_call("/other.Service/GetSession"), Need::Role(Role::Admin));
    }

    #[test]
    fn reading_changing_and_streaming_are_told_apart() {
        let of = |method: Method, path: &str| of_route(&method, path);
        assert_eq!(of(Method::GET, "/v1/sessions/a/map"), Need::Role(Role::Reader));
        assert_eq!(of(Method::GET, "/v1/sessions/a/stream"), Need::Role(Role::Writer));
        assert_eq!(of(Method::POST, "/v1/sessions/a/localize"), Need::Role(Role::Reader));
        assert_eq!(of(Method::DELETE, "/v1/sessions/a"), Need::Role(Role::Writer));
        assert_eq!(of(Method::GET, "/v1/other"), Need::Role(Role::Admin));
        assert_eq!(of(Method::GET, "//v1/sessions"), Need::Role(Role::Admin));
        assert_eq!(of(Method::POST, "/metrics"), Need::Role(Role::Admin));
        assert_eq!(of(Method::POST, "/monoslam.v1.SlamService/GetSession"), Need::Role(Role::Reader));
        assert_eq!(of(Method::POST, "/monoslam.v1.SlamService/DeleteSession"), Need::Role(Role::Writer));
        assert_eq!(of(Method::POST, "/monoslam.v1.SlamService/Unheard"), Need::Role(Role::Admin));
        assert_eq!(of(Method::GET, "/monoslam.v1.SlamService/GetSession"), Need::Role(Role::Admin));
    }
}
