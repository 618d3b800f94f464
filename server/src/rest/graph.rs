//! What ties key frames to one another.

use super::extract::Params;
use super::model::Scale;
use super::units::Units;
use super::{App, Problem};
use crate::error::ApiError;
use crate::session::SessionId;
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use slam::map::{GlobalPrimitive, KeyframeId};
use std::collections::{BTreeMap, BTreeSet};
use store::{Covisibility, KeyframeRecord, SharedLandmarks};
use utoipa::{IntoParams, ToSchema};

/// Covisible key frames of the essential graph share at least so many landmarks: what ORB-SLAM (2015) takes as strong.
const ESSENTIAL_WEIGHT: u32 = 100;

/// Which graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// Key frames that see the same points and lines.
    #[default]
    Covisibility,
    /// Key frames that show the same global primitive, each pair with whether the two see anything in common besides.
    Primitives,
    /// The spanning tree, and pairs of key frames that share a hundred landmarks or more.
    Essential,
}

/// A key frame.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Node {
    /// Identity within the session.
    id: u64,
    /// The submap whose frame of reference the position is in.
    submap_id: u32,
    /// The client's number of the frame.
    sequence: u64,
    /// The client's time of the frame, nanoseconds.
    timestamp_ns: i64,
    /// The camera's position.
    position: [f64; 3],
}

/// Two key frames that are tied.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(super) struct Edge {
    /// The older key frame; of the spanning tree, the parent.
    from: u64,
    /// The other key frame.
    to: u64,
    /// Landmarks that both see.
    weight: u32,
    /// Points that both see.
    n_points: u32,
    /// Lines that both see.
    n_lines: u32,
    /// Primitives: which one both show.
    #[serde(skip_serializing_if = "Option::is_none")]
    primitive_id: Option<u64>,
    /// Primitives: whether both see anything in common. Ties without overlap are those no other landmark makes.
    #[serde(skip_serializing_if = "Option::is_none")]
    overlap: Option<bool>,
    /// Essential: whether the tie is one of the spanning tree.
    #[serde(skip_serializing_if = "Option::is_none")]
    spanning: Option<bool>,
}

/// Key frames and what ties them.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Graph {
    /// The session.
    session_id: String,
    /// Which graph.
    kind: Kind,
    /// What a length of 1 means.
    scale: Scale,
    /// The key frames in the order of their ids.
    nodes: Vec<Node>,
    /// The ties; of the primitives' graph in the order of the primitives' ids, otherwise of the key frames'.
    edges: Vec<Edge>,
}

/// Which graph and which part of it.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// Which graph.
    #[param(inline)]
    kind: Kind,
    /// Ties of this key frame only.
    keyframe_id: Option<u64>,
    /// Ties between key frames that share at least so many landmarks only. The spanning tree is whole all the same.
    min_weight: u32,
}

/// The session's graph of key frames, as of the last commit.
#[utoipa::path(get, path = "/v1/sessions/{id}/graph", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The graph", body = Graph),
    (status = 400, description = "A parameter is wrong", body = Problem, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json")
))]
pub(super) async fn graph(
    State(app): State<App>,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let id = SessionId::parse(&id, "id")?;
    let mut snapshot = app.service.store().snapshot(id.as_str()).await?;
    let units = Units::new(snapshot.record().metres_per_unit);
    let mut keyframes: Vec<KeyframeRecord> = Vec::new();
    loop {
        let step = snapshot.keyframes_after(keyframes.last().map(|last| last.id)).await?;
        if step.is_empty() {
            break;
        }
        keyframes.extend(step);
    }
    let primitives = match wanted.kind {
        Kind::Primitives => snapshot.primitives().await?,
        Kind::Covisibility | Kind::Essential => Vec::new(),
    };
    let shared = snapshot.covisibility().await?;
    drop(snapshot);

    let parts = Ties { shared, keyframes, primitives };
    let nodes: Vec<Node> = parts.keyframes.iter().map(|record| Node::new(record, units)).collect();
    let head = GraphHead { session_id: id.as_str(), kind: wanted.kind, scale: units.scale(), nodes };
    let mut head = serde_json::to_string(&head).map_err(ApiError::internal)?;
    // The edges follow in the same object.
    head.pop();
    head.push_str(",\"edges\":[");
    let edges = parts.into_edges(wanted.kind).filter(move |edge| wanted.wants(edge));
    let pieces = std::iter::once(head).chain(joined(edges)).chain(std::iter::once("\n]}\n".to_owned()));
    let body =
        Body::from_stream(tokio_stream::iter(pieces.map(|piece| Ok::<_, ApiError>(Bytes::from(piece)))));
    Ok(([(CONTENT_TYPE, "application/json")], body))
}

/// A graph without its edges.
#[derive(Serialize)]
struct GraphHead<'a> {
    session_id: &'a str,
    kind: Kind,
    scale: Scale,
    nodes: Vec<Node>,
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

impl Wanted {
    fn wants(&self, edge: &Edge) -> bool {
        self.keyframe_id.is_none_or(|id| edge.from == id || edge.to == id)
            && (edge.weight >= self.min_weight || edge.spanning == Some(true))
    }
}

impl Node {
    fn new(record: &KeyframeRecord, units: Units) -> Self {
        Self {
            id: record.id.get(),
            submap_id: record.submap.0,
            sequence: record.sequence,
            timestamp_ns: record.timestamp_ns,
            position: units.position(&record.camera_from_world.inverse().translation),
        }
    }
}

impl Edge {
    fn new(from: KeyframeId, to: KeyframeId, shared: SharedLandmarks) -> Self {
        let SharedLandmarks { n_points, n_lines } = shared;
        let (primitive_id, overlap, spanning) = (None, None, None);
        let weight = n_points.saturating_add(n_lines);
        Self { from: from.get(), to: to.get(), weight, n_points, n_lines, primitive_id, overlap, spanning }
    }
}

/// What graphs are made of.
struct Ties {
    shared: Covisibility,
    keyframes: Vec<KeyframeRecord>,
    primitives: Vec<GlobalPrimitive>,
}

impl Ties {
    fn into_edges(self, kind: Kind) -> Box<dyn Iterator<Item = Edge> + Send> {
        match kind {
            Kind::Covisibility => {
                Box::new(self.shared.into_iter().map(|((a, b), shared)| Edge::new(a, b, shared)))
            }
            Kind::Essential => Box::new(self.essential().into_values()),
            Kind::Primitives => Box::new(self.into_primitive_edges()),
        }
    }

    fn shared_by(&self, a: KeyframeId, b: KeyframeId) -> SharedLandmarks {
        self.shared.get(&(a.min(b), a.max(b))).copied().unwrap_or_default()
    }

    /// By their key frames, the lower id first.
    fn essential(&self) -> BTreeMap<(KeyframeId, KeyframeId), Edge> {
        let strong = self
            .shared
            .iter()
            .map(|((a, b), shared)| ((*a, *b), Edge { spanning: Some(false), ..Edge::new(*a, *b, *shared) }));
        let mut edges: BTreeMap<_, _> = strong.filter(|(_, edge)| edge.weight >= ESSENTIAL_WEIGHT).collect();
        for record in &self.keyframes {
            if let Some(parent) = record.parent {
                let edge = Edge::new(parent, record.id, self.shared_by(parent, record.id));
                let pair = (parent.min(record.id), parent.max(record.id));
                edges.insert(pair, Edge { spanning: Some(true), ..edge });
            }
        }
        edges
    }

    /// Each pair of key frames of each primitive. There can be very many, so they are made one by one.
    fn into_primitive_edges(self) -> impl Iterator<Item = Edge> + Send {
        let present: BTreeSet<KeyframeId> = self.keyframes.iter().map(|record| record.id).collect();
        let shared = std::sync::Arc::new(self.shared);
        self.primitives.into_iter().flat_map(move |primitive| {
            let seen = primitive.observations.iter().map(|seen| seen.keyframe);
            let keyframes: std::sync::Arc<[KeyframeId]> = seen.filter(|id| present.contains(id)).collect();
            let (shared, primitive_id) = (shared.clone(), Some(primitive.id.get()));
            let n = keyframes.len();
            let pairs = (0..n).flat_map(move |first| (first + 1..n).map(move |second| (first, second)));
            pairs.map(move |(first, second)| {
                let (a, b) = (keyframes[first], keyframes[second]);
                let both = shared.get(&(a, b)).copied();
                let edge = Edge::new(a, b, both.unwrap_or_default());
                Edge { primitive_id, overlap: Some(both.is_some()), ..edge }
            })
        })
    }
}
