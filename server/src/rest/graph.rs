//! What ties keyframes to one another, as one JSON object that is made while it is sent.

use super::extract::{AskedBy, Params};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::maps::{Edge, GraphKind, GraphQuery, Node};
use crate::model::Scale;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Keyframes and what ties them.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Graph {
    /// The session.
    session_id: String,
    /// Which graph.
    kind: GraphKind,
    /// What a length of 1 means.
    scale: Scale,
    /// The keyframes in the order of their ids.
    nodes: Vec<Node>,
    /// The ties; of the primitives' graph in the order of the primitives' ids, otherwise of the keyframes'.
    edges: Vec<Edge>,
}

/// Which graph and which part of it.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// Which graph.
    #[param(inline)]
    kind: GraphKind,
    /// Ties of this keyframe only.
    keyframe_id: Option<u64>,
    /// Ties between keyframes that share at least so many landmarks only. The spanning tree is whole all the
    /// same.
    min_weight: u32,
}

/// The session's graph of keyframes, as of the last commit.
#[utoipa::path(get, path = "/v1/sessions/{id}/graph", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The graph", body = Graph),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn graph(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let id = caller.session(&id, "id")?;
    let Wanted { kind, keyframe_id, min_weight } = wanted;
    let query = GraphQuery { kind, keyframe_id, min_weight };
    let graph = app.service.maps().graph(&id, &query).await?;
    let head =
        Graph { session_id: id.to_string(), kind, scale: graph.scale, nodes: graph.nodes, edges: Vec::new() };
    let mut head = serde_json::to_string(&head).map_err(ApiError::internal)?;
    // The edges follow where the object has an empty list of them.
    head.truncate(head.len() - "]}".len());
    let pieces = std::iter::once(head).chain(joined(graph.edges)).chain(std::iter::once("\n]}\n".to_owned()));
    let body =
        Body::from_stream(tokio_stream::iter(pieces.map(|piece| Ok::<_, ApiError>(Bytes::from(piece)))));
    Ok(([(CONTENT_TYPE, "application/json")], body))
}

/// Edges sent at a time, some hundred bytes each.
const EDGES_PER_PIECE: usize = 256;

/// Edges as JSON, with commas between.
fn joined(edges: impl Iterator<Item = Edge>) -> impl Iterator<Item = String> {
    let mut edges = edges.peekable();
    let mut separator = "\n";
    std::iter::from_fn(move || {
        edges.peek()?;
        let mut piece = String::new();
        for edge in edges.by_ref().take(EDGES_PER_PIECE) {
            piece.push_str(separator);
            // Numbers and words only: nothing that JSON cannot say.
            piece.push_str(&serde_json::to_string(&edge).unwrap_or_default());
            separator = ",\n";
        }
        Some(piece)
    })
}
