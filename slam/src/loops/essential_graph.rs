//! Spreading what a loop has shown over the whole submap: a pose graph over similarities. [ALGORITHMS 7.6]

use crate::bundle::factors::RelativeSimilarityFactor;
use crate::config::LoopConfig;
use crate::landmarks::Corrections;
use crate::map::{KeyframeId, Map, median_depth};
use geometry::Similarity;
use optim::{Kernel, Problem, SolverOptions};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviations of what one key frame drifts against the next: attitude (radians), place (share of the scene's
/// depth) and scale (logarithm). Only their ratios matter; scale drifts most with one camera.
const DRIFT_SIGMAS: [f64; 3] = [0.002, 0.003, 0.006];
/// Key frames whose numbers are at least this far apart see the same because a loop was closed there.
const LOOP_SEPARATION: u64 = 20;
/// Shared points with which such a pair is a loop edge.
const MIN_LOOP_POINTS: u32 = 30;

/// A newly measured relation of key frames `i` and `j`.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoopEdge {
    pub i: KeyframeId,
    pub j: KeyframeId,
    pub j_from_i: Similarity,
}

/// Optimises the poses of a submap's key frames, given as `camera_from_world` with a scale: as they were `measured`
/// along the way, and where the optimisation starts, which is where the map's landmarks are. Returns how each key
/// frame's part of the world is moved by the result.
pub(super) fn optimise(
    map: &Map,
    measured: &BTreeMap<KeyframeId, Similarity>,
    initial: &BTreeMap<KeyframeId, Similarity>,
    loop_edges: &[LoopEdge],
    config: &LoopConfig,
) -> Corrections {
    let mut problem = Problem::new();
    let variables: BTreeMap<KeyframeId, _> =
        initial.iter().map(|(id, start)| (*id, problem.add_variable(*start))).collect();
    // One key frame must stay: the oldest, so that the submap's frame of reference does.
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

/// The essential graph: spanning tree, strong ties, and ties across time that earlier loops have left. The latter can be
/// told by the numbers of the key frames, so nothing needs to be stored of them.
pub(super) fn edges(
    map: &Map,
    among: &BTreeMap<KeyframeId, Similarity>,
    config: &LoopConfig,
) -> BTreeSet<(KeyframeId, KeyframeId)> {
    let mut edges = BTreeSet::new();
    for keyframe in among.keys().filter_map(|id| map.keyframe(*id)) {
        edges.extend(keyframe.parent.map(|parent| ordered(keyframe.id, parent)));
        let strong = keyframe.covisible().iter().filter(|(_, n)| *n >= config.min_essential_points);
        edges.extend(strong.map(|(other, _)| ordered(keyframe.id, *other)));
        let across = |other: KeyframeId| keyframe.id.get().abs_diff(other.get()) >= LOOP_SEPARATION;
        let strongest =
            keyframe.covisible().iter().find(|(other, n)| *n >= MIN_LOOP_POINTS && across(*other));
        edges.extend(strongest.map(|(other, _)| ordered(keyframe.id, *other)));
    }
    edges.retain(|(i, j)| among.contains_key(i) && among.contains_key(j));
    edges
}

fn ordered(i: KeyframeId, j: KeyframeId) -> (KeyframeId, KeyframeId) {
    (i.min(j), i.max(j))
}
