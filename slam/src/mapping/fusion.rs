//! Joining points of neighbouring keyframes that are the same and adding observations that were missed.

use super::neighbours;
use crate::config::SlamConfig;
use crate::map::{KeyframeId, Map, PointId};
use crate::matching::fuse_into;
use std::collections::BTreeSet;

/// Neighbours of each neighbour into which points are fused as well.
const N_SECOND_NEIGHBOURS: usize = 5;

/// Projects the key frame's points into its neighbours and theirs into it.
pub(super) fn fuse_with_neighbours(map: &mut Map, id: KeyframeId, config: &SlamConfig) {
    let targets = targets(map, id, config.mapping.n_fusion_neighbours);
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

fn targets(map: &Map, id: KeyframeId, n_neighbours: usize) -> Vec<KeyframeId> {
    let mut targets = Vec::new();
    for neighbour in neighbours(map, id, n_neighbours) {
        for target in std::iter::once(neighbour).chain(neighbours(map, neighbour, N_SECOND_NEIGHBOURS)) {
            if target != id && !targets.contains(&target) {
                targets.push(target);
            }
        }
    }
    targets
}
