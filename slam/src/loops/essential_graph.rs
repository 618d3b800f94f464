//! Pose-graph optimization over the essential graph, which spreads a loop's correction over the submap by
//! similarities. [method: Loop detection and correction]

use crate::bundle::factors::RelativeSimilarityFactor;
use crate::config::LoopConfig;
use crate::landmarks::Corrections;
use crate::map::{Keyframe, KeyframeId, Map, median_depth};
use geometry::Similarity;
use optim::{Kernel, Problem, SolverOptions};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviations of what one keyframe drifts against the next: attitude (radians), place (share of the
/// scene's depth) and scale (logarithm). Only their ratios matter; scale drifts most with one camera.
const DRIFT_SIGMAS: [f64; 3] = [0.002, 0.003, 0.006];
/// Keyframes whose numbers are at least this far apart see the same because a loop was closed there.
const LOOP_SEPARATION: u64 = 20;
/// Shared points with which such a pair is a loop edge.
const MIN_LOOP_POINTS: u32 = 30;

/// A newly measured relation of keyframes `i` and `j`.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoopEdge {
    pub i: KeyframeId,
    pub j: KeyframeId,
    pub j_from_i: Similarity,
}

/// Optimizes the poses of a submap's keyframes, given as `camera_from_world` with a scale: as they were
/// `measured` along the way, and where the optimization starts, which is where the map's landmarks are.
/// Returns how each keyframe's part of the world is moved by the result.
pub(super) fn optimize(
    map: &Map,
    measured: &BTreeMap<KeyframeId, Similarity>,
    initial: &BTreeMap<KeyframeId, Similarity>,
    loop_edges: &[LoopEdge],
    config: &LoopConfig,
) -> Corrections {
    let mut problem = Problem::new();
    let variables: BTreeMap<KeyframeId, _> =
        initial.iter().map(|(id, start)| (*id, problem.add_variable(*start))).collect();
    // One keyframe must stay: the oldest, so that the submap's frame of reference does.
    if let Some(oldest) = variables.values().next() {
        problem.set_fixed(*oldest, true);
    }
    let depth =
        initial.keys().next_back().and_then(|id| median_depth(map, map.keyframe(*id)?)).unwrap_or(1.0);
    let [rotation, translation, scale] = DRIFT_SIGMAS;
    let inverse_sigmas = [1.0 / rotation, 1.0 / (translation * depth), 1.0 / scale];
    let mut factors = Vec::new();
    let mut add = |i: KeyframeId, j: KeyframeId, j_from_i: &Similarity| {
        if let (Some(i), Some(j)) = (variables.get(&i), variables.get(&j)) {
            factors
                .push(((*i, *j), RelativeSimilarityFactor { i_from_j: j_from_i.inverse(), inverse_sigmas }));
        }
    };
    let new_pairs: BTreeSet<_> = loop_edges.iter().map(|edge| ordered(edge.i, edge.j)).collect();
    for (i, j) in edges(map, measured, config).difference(&new_pairs) {
        add(*i, *j, &(measured[j] * measured[i].inverse()));
    }
    for edge in loop_edges {
        add(edge.i, edge.j, &edge.j_from_i);
    }
    problem.add_factors(Kernel::None, factors);
    let options = SolverOptions { max_iterations: config.essential_iterations, ..SolverOptions::default() };
    problem.solve(&options, || false);
    variables
        .iter()
        .map(|(id, variable)| (*id, problem.value(*variable).inverse() * initial[id]))
        .filter(|(_, correction)| correction.is_finite())
        .collect()
}

/// The essential graph of some keyframes of a map.
pub(super) fn edges(
    map: &Map,
    among: &BTreeMap<KeyframeId, Similarity>,
    config: &LoopConfig,
) -> BTreeSet<(KeyframeId, KeyframeId)> {
    let ties: Vec<KeyframeTies> =
        among.keys().filter_map(|id| map.keyframe(*id)).map(KeyframeTies::of).collect();
    essential_edges(&ties, config)
}

/// What the essential graph is chosen by: a keyframe's place in the spanning tree and what it shares with
/// others.
#[derive(Clone, Copy, Debug)]
pub struct KeyframeTies<'a> {
    /// The keyframe.
    pub id: KeyframeId,
    /// The keyframe it hangs on in the spanning tree.
    pub parent: Option<KeyframeId>,
    /// Keyframes with which it shares points and lines and how many, most first; see
    /// [`Keyframe::covisible`].
    pub covisible: &'a [(KeyframeId, u32)],
}

impl<'a> KeyframeTies<'a> {
    /// The ties of a keyframe of a map.
    pub fn of(keyframe: &'a Keyframe) -> Self {
        Self { id: keyframe.id, parent: keyframe.parent, covisible: keyframe.covisible() }
    }
}

/// The essential graph of a submap's keyframes: spanning tree, strong ties, and ties across time that
/// earlier loops have left. The latter can be told by the numbers of the keyframes, so nothing needs to be
/// stored of them. Pairs of which one is not among the keyframes given are left out; the lower id comes
/// first.
pub fn essential_edges(
    keyframes: &[KeyframeTies],
    config: &LoopConfig,
) -> BTreeSet<(KeyframeId, KeyframeId)> {
    let mut edges = BTreeSet::new();
    for keyframe in keyframes {
        edges.extend(keyframe.parent.map(|parent| ordered(keyframe.id, parent)));
        let strong = keyframe.covisible.iter().filter(|(_, n)| *n >= config.min_essential_points);
        edges.extend(strong.map(|(other, _)| ordered(keyframe.id, *other)));
        let across = |other: KeyframeId| keyframe.id.get().abs_diff(other.get()) >= LOOP_SEPARATION;
        let strongest = keyframe.covisible.iter().find(|(other, n)| *n >= MIN_LOOP_POINTS && across(*other));
        edges.extend(strongest.map(|(other, _)| ordered(keyframe.id, *other)));
    }
    let among: BTreeSet<KeyframeId> = keyframes.iter().map(|keyframe| keyframe.id).collect();
    edges.retain(|(i, j)| among.contains(i) && among.contains(j));
    edges
}

fn ordered(i: KeyframeId, j: KeyframeId) -> (KeyframeId, KeyframeId) {
    (i.min(j), i.max(j))
}
