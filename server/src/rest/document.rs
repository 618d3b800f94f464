//! What the OpenAPI document says of every route alike: how the door refuses.

use super::conditional::is_of_map;
use crate::access::rules::{Need, of_route};
use axum::http::Method;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, Response, ResponseBuilder};

/// What is answered before a handler is asked, and whom it concerns.
const REFUSALS: [(&str, Concerned, &str); 8] = [
    ("304", Concerned::Maps, "It is the one named by If-None-Match"),
    ("400", Concerned::Parameters, "A parameter is wrong"),
    ("401", Concerned::Callers, "A token is needed, or this one is not good"),
    ("403", Concerned::Callers, "The token's role does not suffice, or a page of somebody else asks"),
    ("413", Concerned::Bodies, "The body is too large"),
    ("415", Concerned::Bodies, "The body is of another type"),
    ("429", Concerned::All, "Too much is asked at once; `Retry-After` says for how long not to"),
    ("503", Concerned::All, "The server is about to stop, has too many connections, or its storage fails"),
];

#[derive(Clone, Copy, PartialEq, Eq)]
enum Concerned {
    All,
    /// Routes that need a caller.
    Callers,
    /// Routes with parameters.
    Parameters,
    /// Routes that take a JSON body.
    Bodies,
    /// What is asked of maps.
    Maps,
}

/// Adds them where a route does not tell of them itself.
pub(super) fn complete(document: &mut OpenApi) {
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations(item) {
            let Some(operation) = operation else { continue };
            for (status, concerned, description) in REFUSALS {
                if is_concerned(concerned, &method, path, operation) {
                    let all = &mut operation.responses.responses;
                    all.entry(status.to_owned()).or_insert_with(|| refusal(status, description).into());
                }
            }
        }
    }
}

fn is_concerned(concerned: Concerned, method: &Method, path: &str, operation: &Operation) -> bool {
    match concerned {
        Concerned::All => true,
        Concerned::Callers => of_route(method, path) != Need::Nothing,
        Concerned::Parameters => operation.parameters.as_ref().is_some_and(|all| !all.is_empty()),
        Concerned::Bodies => operation.request_body.is_some(),
        Concerned::Maps => *method == Method::GET && is_of_map(path),
    }
}

fn refusal(status: &str, description: &str) -> Response {
    let response = ResponseBuilder::new().description(description);
    if status == "304" {
        return response.build();
    }
    let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDetails"))).build();
    response.content("application/problem+json", problem).build()
}

fn operations(item: &mut PathItem) -> [(Method, &mut Option<Operation>); 5] {
    [
        (Method::GET, &mut item.get),
        (Method::POST, &mut item.post),
        (Method::PUT, &mut item.put),
        (Method::PATCH, &mut item.patch),
        (Method::DELETE, &mut item.delete),
    ]
}
