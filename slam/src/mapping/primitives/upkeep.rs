//! Maintenance of primitives: directions after poses moved, merging, removal, and which lines belong to them.

use crate::config::PrimitiveConfig;
use crate::landmarks::estimate_direction;
use crate::map::{GlobalPrimitive, Keyframe, KeyframeId, LineId, Map, PrimitiveId};
use std::collections::BTreeMap;

/// Joins primitives that are the same: close, and never two vanishing points of one keyframe. Also finds the
/// directions of those the keyframe shows again.
pub(super) fn merge(map: &mut Map, id: KeyframeId, config: &PrimitiveConfig) {
    for primitive in primitives_of(map, id) {
        refresh_direction(map, primitive);
    }
    for kept in primitives_of(map, id) {
        let Some(primitive) = map.primitive(kept) else { continue };
        let same: Vec<PrimitiveId> = map
            .primitives()
            .filter(|other| other.id != kept && are_same(primitive, other, config))
            .map(|other| other.id)
            .collect();
        for other in same {
            let n_observations = |id| map.primitive(id).map_or(0, |primitive| primitive.observations.len());
            let (kept, gone) =
                if n_observations(other) > n_observations(kept) { (other, kept) } else { (kept, other) };
            map.fuse_primitives(kept, gone);
            refresh_direction(map, kept);
        }
    }
}

fn are_same(a: &GlobalPrimitive, b: &GlobalPrimitive, config: &PrimitiveConfig) -> bool {
    a.submap == b.submap
        && a.direction.angle(&b.direction).to_degrees() < config.merge_deg
        && b.observations.iter().all(|seen| a.observation_in(seen.keyframe).is_none())
}

/// Drops primitives that few keyframes showed and none has for long.
pub(super) fn retire(map: &mut Map, newest: KeyframeId, config: &PrimitiveConfig) {
    let is_forgotten = |primitive: &GlobalPrimitive| {
        let last = primitive.observations.last().map_or(primitive.created_by, |seen| seen.keyframe);
        primitive.observations.len() < config.min_keyframes_to_keep
            && newest.get().saturating_sub(last.get()) > config.retire_after_keyframes
    };
    let forgotten: Vec<PrimitiveId> =
        map.primitives().filter(|primitive| is_forgotten(primitive)).map(|primitive| primitive.id).collect();
    forgotten.into_iter().for_each(|id| map.remove_primitive(id));
}

/// Says which lines of the keyframe have the direction of a primitive: those that most of their segments
/// vote for and that agree in space.
pub(super) fn vote_for_lines(map: &mut Map, id: KeyframeId, config: &PrimitiveConfig) {
    let lines: Vec<LineId> =
        map.keyframe(id).into_iter().flat_map(Keyframe::observed_lines).map(|(_, line)| line).collect();
    for line in lines {
        let primitive = elect(map, line, config);
        map.set_line_primitive(line, primitive);
    }
}

fn elect(map: &Map, id: LineId, config: &PrimitiveConfig) -> Option<PrimitiveId> {
    let line = map.line(id)?;
    let mut votes: BTreeMap<PrimitiveId, usize> = BTreeMap::new();
    for seen in &line.observations {
        let Some(keyframe) = map.keyframe(seen.keyframe) else { continue };
        let supported =
            keyframe.vanishing.iter().find(|vanishing| vanishing.segments.contains(&seen.feature_idx));
        if let Some(primitive) = supported.and_then(|vanishing| vanishing.primitive) {
            *votes.entry(primitive).or_default() += 1;
        }
    }
    let (elected, n_votes) = votes.into_iter().max_by_key(|(id, n)| (*n, std::cmp::Reverse(*id)))?;
    let direction = map.primitive(elected)?.direction;
    let sine = direction.as_vector().cross(line.line.direction()).norm();
    let agrees = sine <= config.max_line_angle_deg.to_radians().sin();
    (agrees && 2 * n_votes > line.observations.len()).then_some(elected)
}

fn primitives_of(map: &Map, id: KeyframeId) -> Vec<PrimitiveId> {
    map.keyframe(id)
        .into_iter()
        .flat_map(|keyframe| &keyframe.vanishing)
        .filter_map(|seen| seen.primitive)
        .collect()
}

fn refresh_direction(map: &mut Map, id: PrimitiveId) {
    let Some(primitive) = map.primitive(id) else { return };
    let observations = primitive.observations.clone();
    let Some(estimate) = estimate_direction(map, observations.iter().copied()) else { return };
    if let Some(covariance) = estimate.covariance() {
        map.set_primitive_direction(id, estimate.direction, covariance);
    }
}
