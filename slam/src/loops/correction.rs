//! Loop correction and map merging: the surroundings move onto the recognized place, duplicate landmarks are
//! fused, and the rest of the map follows.

use super::essential_graph::{self, LoopEdge};
use super::{Place, Recognition};
use crate::config::SlamConfig;
use crate::landmarks::{Anchoring, Corrections, apply_corrections};
use crate::map::{Keyframe, KeyframeId, Map, PointId, PrimitiveId, SubmapId};
use crate::matching::fuse_into;
use geometry::Similarity;
use std::collections::{BTreeMap, BTreeSet};

/// Angle up to which directions of two submaps are the same primitive once they are merged, degrees.
const SAME_DIRECTION_DEG: f64 = 3.0;

/// Closes a loop within a submap.
pub(super) fn close_loop(map: &mut Map, recognition: &Recognition, config: &SlamConfig) {
    let Some(submap) = map.keyframe(recognition.current).map(|keyframe| keyframe.submap) else { return };
    let similarity = &recognition.place_from_current;
    let place: BTreeSet<KeyframeId> = recognition.place.keyframes.iter().copied().collect();
    let window: BTreeSet<KeyframeId> =
        window_around(map, recognition.current).into_iter().filter(|id| !place.contains(id)).collect();
    let before: BTreeMap<KeyframeId, Similarity> = map
        .keyframes_of(submap)
        .map(|keyframe| (keyframe.id, Similarity::from_pose(&keyframe.camera_from_world)))
        .collect();
    let known_edges: BTreeSet<(KeyframeId, KeyframeId)> = outward_edges(map, &window);

    let anchoring = move_window(map, &window, &place, similarity);
    join_landmarks(map, &recognition.place, recognition.current, config);

    let now = |id: &KeyframeId| {
        let measured = before[id];
        if window.contains(id) { measured * similarity.inverse() } else { measured }
    };
    let new_edges = outward_edges(map, &window).into_iter().filter(|edge| !known_edges.contains(edge));
    let loop_edges: BTreeSet<(KeyframeId, KeyframeId)> =
        new_edges.chain([(recognition.current, recognition.matched)]).collect();
    let loop_edges: Vec<LoopEdge> = loop_edges
        .into_iter()
        .filter(|(i, j)| before.contains_key(i) && before.contains_key(j))
        .map(|(i, j)| LoopEdge { i, j, j_from_i: now(&j) * now(&i).inverse() })
        .collect();
    let initial: BTreeMap<KeyframeId, Similarity> = before.keys().map(|id| (*id, now(id))).collect();
    let corrections = essential_graph::optimize(map, &before, &initial, &loop_edges, &config.loops);
    apply_corrections(map, &corrections, &anchoring);
}

/// Moves a whole submap into the frame of reference of another and joins the two where they meet.
pub(super) fn merge(
    map: &mut Map,
    recognition: &Recognition,
    absorbed: SubmapId,
    surviving: SubmapId,
    config: &SlamConfig,
) {
    let Some(current_submap) = map.keyframe(recognition.current).map(|keyframe| keyframe.submap) else {
        return;
    };
    let (surviving_from_absorbed, root, parent) = if current_submap == absorbed {
        (recognition.place_from_current, recognition.current, recognition.matched)
    } else {
        (recognition.place_from_current.inverse(), recognition.matched, recognition.current)
    };
    let corrections: Corrections =
        map.keyframes_of(absorbed).map(|keyframe| (keyframe.id, surviving_from_absorbed)).collect();
    apply_corrections(map, &corrections, &Anchoring::default());
    map.rename_submap(absorbed, surviving);
    map.hang_tree(root, parent);
    join_primitives(map, surviving);
    join_landmarks(map, &recognition.place, recognition.current, config);
}

/// Joins the points of a place with those of a keyframe and its neighbors, which are in the right place by
/// now.
pub(super) fn join_landmarks(map: &mut Map, place: &Place, current: KeyframeId, config: &SlamConfig) {
    let window = window_around(map, current);
    for id in &window {
        let known: Vec<PointId> =
            place.points.iter().copied().filter(|id| map.point(*id).is_some()).collect();
        fuse_into(map, &known, *id, config);
    }
    let seen: BTreeSet<PointId> = window
        .iter()
        .filter_map(|id| map.keyframe(*id))
        .flat_map(|keyframe| keyframe.observed_points().map(|(_, id)| id))
        .collect();
    for id in seen {
        map.refresh_point(id);
    }
    for id in window {
        map.refresh_covisibility(id, config.mapping.min_covisible_points);
    }
}

/// A keyframe and those that share points with it.
fn window_around(map: &Map, id: KeyframeId) -> BTreeSet<KeyframeId> {
    let neighbors =
        map.keyframe(id).into_iter().flat_map(|keyframe| keyframe.covisible().iter().map(|(id, _)| *id));
    std::iter::once(id).chain(neighbors).collect()
}

/// Ties of keyframes in the window with ones outside.
fn outward_edges(map: &Map, window: &BTreeSet<KeyframeId>) -> BTreeSet<(KeyframeId, KeyframeId)> {
    window
        .iter()
        .filter_map(|id| map.keyframe(*id))
        .flat_map(|keyframe| keyframe.covisible().iter().map(|(other, _)| (keyframe.id, *other)))
        .filter(|(_, other)| !window.contains(other))
        .collect()
}

/// Moves the window with the landmarks only it sees; what the place sees stays. Returns which landmarks now
/// move with which side.
fn move_window(
    map: &mut Map,
    window: &BTreeSet<KeyframeId>,
    place: &BTreeSet<KeyframeId>,
    similarity: &Similarity,
) -> Anchoring {
    let seen_in =
        |keyframe: &Keyframe| (keyframe.id, keyframe.observed_points().map(|(_, id)| id).collect::<Vec<_>>());
    let lines_in =
        |keyframe: &Keyframe| (keyframe.id, keyframe.observed_lines().map(|(_, id)| id).collect::<Vec<_>>());
    let keyframes =
        |ids: &BTreeSet<KeyframeId>| ids.iter().filter_map(|id| map.keyframe(*id)).collect::<Vec<_>>();
    let mut anchoring = Anchoring::default();
    for (side, is_place) in [(window, false), (place, true)] {
        for (id, points) in keyframes(side).into_iter().map(seen_in) {
            for point in points {
                // The place has the last word.
                let anchor = anchoring.points.entry(point).or_insert(id);
                *anchor = if is_place { id } else { *anchor };
            }
        }
        for (id, lines) in keyframes(side).into_iter().map(lines_in) {
            for line in lines {
                let anchor = anchoring.lines.entry(line).or_insert(id);
                *anchor = if is_place { id } else { *anchor };
            }
        }
    }
    for id in window {
        map.move_keyframe(*id, similarity);
    }
    let moved = |anchor: &KeyframeId| window.contains(anchor);
    for (id, _) in anchoring.points.iter().filter(|(_, anchor)| moved(anchor)) {
        map.move_point(*id, similarity);
    }
    for (id, _) in anchoring.lines.iter().filter(|(_, anchor)| moved(anchor)) {
        map.move_line(*id, similarity);
    }
    anchoring
}

/// Joins primitives of one submap that have become the same direction.
fn join_primitives(map: &mut Map, submap: SubmapId) {
    let ids: Vec<PrimitiveId> = map
        .primitives()
        .filter(|primitive| primitive.submap == submap)
        .map(|primitive| primitive.id)
        .collect();
    for (position, surviving) in ids.iter().enumerate() {
        for absorbed in &ids[position + 1..] {
            let (Some(a), Some(b)) = (map.primitive(*surviving), map.primitive(*absorbed)) else { continue };
            if a.direction.angle(&b.direction).to_degrees() <= SAME_DIRECTION_DEG {
                map.fuse_primitives(*surviving, *absorbed);
            }
        }
    }
}
