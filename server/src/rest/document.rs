//! What the OpenAPI document says of every route alike: how the door refuses.

use crate::access::rules::{Need, of_route};
use axum::http::Method;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, ResponseBuilder};

/// What is answered before a handler is asked.
const REFUSALS: [(&str, &str); 3] = [
    ("401", "A token is needed, or this one is not good"),
    ("403", "The token's role does not suffice, or a page of somebody else asks"),
    ("429", "Too much is asked at once; `Retry-After` says for how long not to"),
];

/// Adds them where a route does not tell of them itself.
pub(super) fn complete(document: &mut OpenApi) {
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations(item) {
            let Some(operation) = operation else { continue };
            let is_open = of_route(&method, path) == Need::Nothing;
            for (status, description) in REFUSALS {
                if is_open && status != "429" {
                    continue;
                }
                let response = ResponseBuilder::new().description(description).content(
                    "application/problem+json",
                    ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDetails"))).build(),
                );
                operation
                    .responses
                    .responses
                    .entry(status.to_owned())
                    .or_insert_with(|| response.build().into());
            }
        }
    }
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
