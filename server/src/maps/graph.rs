//! Graphs of keyframes: covisibility, primitives, essential graph.

use super::MapQueries;
use crate::error::ApiError;
use crate::model::{Scale, Units};
use crate::options::{SessionOptions, engine_config};
use crate::session::SessionId;
use serde::{Deserialize, Serialize};
use slam::map::{GlobalPrimitive, KeyframeId, SubmapId};
use slam::{KeyframeTies, LoopConfig, essential_edges};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use store::{Covisibility, KeyframeRecord, MapSnapshot, SharedLandmarks};
use utoipa::ToSchema;

/// Which graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = Kind)]
pub enum GraphKind {
    /// Keyframes that see the same points and lines.
    #[default]
    Covisibility,
    /// Keyframes that show the same global primitive, each pair with whether the two see anything in common
    /// besides.
    Primitives,
    /// What loops are closed on: the spanning tree, pairs of keyframes that share many landmarks, and pairs
    /// far apart in time that share some since a loop was closed between them.
    Essential,
}

/// Which graph is wanted, and which part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GraphQuery {
    /// Which graph.
    pub kind: GraphKind,
    /// Ties of this keyframe only.
    pub keyframe_id: Option<u64>,
    /// Ties between keyframes that share at least so many landmarks only. The spanning tree is whole all the
    /// same.
    pub min_weight: u32,
}

/// A keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Node {
    /// Identity within the session.
    pub id: u64,
    /// The submap whose frame of reference the position is in.
    pub submap_id: u32,
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// The same in text, for programs whose numbers do not hold all its digits, such as JavaScript's.
    pub timestamp_ns_text: String,
    /// The camera's position.
    pub position: [f64; 3],
}

/// Two keyframes that are tied.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Edge {
    /// The older keyframe; of the spanning tree, the parent.
    pub from: u64,
    /// The other keyframe.
    pub to: u64,
    /// Landmarks that both see.
    pub weight: u32,
    /// Points that both see.
    pub n_points: u32,
    /// Lines that both see.
    pub n_lines: u32,
    /// Primitives: which one both show.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub primitive_id: Option<u64>,
    /// Primitives: whether both see anything in common. Ties without overlap are those no other landmark
    /// makes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overlap: Option<bool>,
    /// Essential: whether the tie is one of the spanning tree.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spanning: Option<bool>,
}

/// Keyframes and what ties them.
pub struct Graph {
    /// What a length of 1 means.
    pub scale: Scale,
    /// The keyframes in the order of their ids.
    pub nodes: Vec<Node>,
    /// The ties; of the primitives' graph in the order of the primitives' ids, otherwise of the keyframes'.
    /// There can be very many, so they are made one by one.
    pub edges: Box<dyn Iterator<Item = Edge> + Send>,
}

impl MapQueries {
    /// A session's graph of keyframes.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn graph(&self, id: &SessionId, query: &GraphQuery) -> Result<Graph, ApiError> {
        let mut snapshot = self.store.snapshot(id.as_str()).await?;
        let record = snapshot.record();
        let units = Units::new(record.metres_per_unit);
        let loops = engine_config(&SessionOptions::from(record.options.clone()))?.loops;
        let keyframes = read_keyframes(&mut snapshot).await?;
        let primitives = match query.kind {
            GraphKind::Primitives => snapshot.primitives().await?,
            GraphKind::Covisibility | GraphKind::Essential => Vec::new(),
        };
        let shared = snapshot.covisibility().await?;
        drop(snapshot);

        let nodes = keyframes.iter().map(|record| Node::new(record, units)).collect();
        let (query, ties) = (*query, Ties { shared, keyframes, primitives });
        // Choosing edges takes as long as there are keyframes.
        let edges = tokio::task::spawn_blocking(move || ties.into_edges(query.kind, &loops)).await;
        let edges = edges.map_err(ApiError::internal)?.filter(move |edge| query.wants(edge));
        Ok(Graph { scale: units.scale(), nodes, edges: Box::new(edges) })
    }
}

async fn read_keyframes(snapshot: &mut MapSnapshot) -> Result<Vec<KeyframeRecord>, ApiError> {
    let mut keyframes: Vec<KeyframeRecord> = Vec::new();
    loop {
        let step = snapshot.keyframes_after(keyframes.last().map(|last| last.id)).await?;
        if step.is_empty() {
            return Ok(keyframes);
        }
        keyframes.extend(step);
    }
}

impl GraphQuery {
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
            timestamp_ns_text: record.timestamp_ns.to_string(),
            position: units.position(&record.camera_from_world.inverse().translation),
        }
    }
}

impl Edge {
    fn new(from: KeyframeId, to: KeyframeId, shared: SharedLandmarks) -> Self {
        let SharedLandmarks { n_points, n_lines } = shared;
        let (primitive_id, overlap, spanning) = (None, None, None);
        let weight = weight(shared);
        Self { from: from.get(), to: to.get(), weight, n_points, n_lines, primitive_id, overlap, spanning }
    }
}

fn weight(shared: SharedLandmarks) -> u32 {
    shared.n_points.saturating_add(shared.n_lines)
}

/// What graphs are made of.
struct Ties {
    shared: Covisibility,
    keyframes: Vec<KeyframeRecord>,
    primitives: Vec<GlobalPrimitive>,
}

impl Ties {
    fn into_edges(self, kind: GraphKind, loops: &LoopConfig) -> Box<dyn Iterator<Item = Edge> + Send> {
        match kind {
            GraphKind::Covisibility => {
                Box::new(self.shared.into_iter().map(|((a, b), shared)| Edge::new(a, b, shared)))
            }
            GraphKind::Essential => Box::new(self.essential(loops).into_iter()),
            GraphKind::Primitives => Box::new(self.into_primitive_edges()),
        }
    }

    fn shared_by(&self, a: KeyframeId, b: KeyframeId) -> SharedLandmarks {
        self.shared.get(&(a.min(b), a.max(b))).copied().unwrap_or_default()
    }

    /// The edges that the engine would choose, submap by submap, were it to close a loop now.
    fn essential(&self, loops: &LoopConfig) -> Vec<Edge> {
        let covisible = self.covisible();
        let mut submaps: BTreeMap<SubmapId, Vec<KeyframeTies>> = BTreeMap::new();
        for record in &self.keyframes {
            let covisible = covisible.get(&record.id).map(Vec::as_slice).unwrap_or_default();
            let ties = KeyframeTies { id: record.id, parent: record.parent, covisible };
            submaps.entry(record.submap).or_default().push(ties);
        }
        let pairs: BTreeSet<_> = submaps.values().flat_map(|ties| essential_edges(ties, loops)).collect();
        let parents: BTreeMap<KeyframeId, KeyframeId> =
            self.keyframes.iter().filter_map(|record| Some((record.id, record.parent?))).collect();
        let edge = |(a, b): (KeyframeId, KeyframeId)| {
            let (from, to) = if parents.get(&a) == Some(&b) { (b, a) } else { (a, b) };
            let spanning = Some(parents.get(&to) == Some(&from));
            Edge { spanning, ..Edge::new(from, to, self.shared_by(a, b)) }
        };
        pairs.into_iter().map(edge).collect()
    }

    /// What each keyframe shares with others, most first, as the engine keeps it.
    fn covisible(&self) -> BTreeMap<KeyframeId, Vec<(KeyframeId, u32)>> {
        let mut covisible: BTreeMap<KeyframeId, Vec<(KeyframeId, u32)>> = BTreeMap::new();
        for ((a, b), shared) in &self.shared {
            covisible.entry(*a).or_default().push((*b, weight(*shared)));
            covisible.entry(*b).or_default().push((*a, weight(*shared)));
        }
        covisible.values_mut().for_each(|others| others.sort_by_key(|(other, n)| (Reverse(*n), *other)));
        covisible
    }

    /// Each pair of keyframes of each primitive.
    fn into_primitive_edges(self) -> impl Iterator<Item = Edge> + Send {
        let present: BTreeSet<KeyframeId> = self.keyframes.iter().map(|record| record.id).collect();
        let shared = Arc::new(self.shared);
        self.primitives.into_iter().flat_map(move |primitive| {
            let seen = primitive.observations.iter().map(|seen| seen.keyframe);
            let keyframes: Arc<[KeyframeId]> = seen.filter(|id| present.contains(id)).collect();
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
