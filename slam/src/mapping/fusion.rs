//! Joining points of neighboring keyframes that are the same and adding observations that were missed.

use super::neighbors;
use crate::config::SlamConfig;
use crate::map::{KeyframeId, Map, PointId};
use crate::matching::fuse_into;
use std::collections::BTreeSet;

/// Neighbors of each neighbor into which points are fused as well.
const N_SECOND_NEIGHBORS: usize = 5;

/// Projects the keyframe's points into its neighbors and theirs into it.
pub(super) fn fuse_with_neighbors(map: &mut Map, id: KeyframeId, config: &SlamConfig) {
    let targets = targets(map, id, config.mapping.n_fusion_neighbors);
    let own: Vec<PointId> = observed(map, id).into_iter().collect();
    for target in &targets {
        fuse_into(map, &own, *target, config);
    }
    let mut theirs = BTreeSet::new();
    for target in &targets {
        theirs.extend(observed(map, *target));
    }
    let theirs: Vec<PointId> = theirs.into_iter().collect();
    fuse_into(map, &theirs, id, config);
    for point in observed(map, id) {
        map.refresh_point(point);
    }
    map.refresh_covisibility(id, config.mapping.min_covisible_points);
}

fn observed(map: &Map, id: KeyframeId) -> BTreeSet<PointId> {
    map.keyframe(id)
        .map_or(BTreeSet::new(), |keyframe| keyframe.observed_points().map(|(_, id)| id).collect())
}

fn targets(map: &Map, id: KeyframeId, n_neighbors: usize) -> Vec<KeyframeId> {
    let mut targets = Vec::new();
    for neighbor in neighbors(map, id, n_neighbors) {
        for target in std::iter::once(neighbor).chain(neighbors(map, neighbor, N_SECOND_NEIGHBORS)) {
            if target != id && !targets.contains(&target) {
                targets.push(target);
            }
        }
    }
    targets
}
