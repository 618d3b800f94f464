//! Data association: which global primitive a vanishing point belongs to.
//! [method: Association of vanishing points]

use crate::config::PrimitiveConfig;
use crate::landmarks::{estimate_direction, in_world, sigma_rad};
use crate::map::{GlobalPrimitive, Keyframe, KeyframeId, Map, PrimitiveId, PrimitiveObservation};
use geometry::Direction;
use std::collections::{BTreeMap, BTreeSet};

/// Gives the keyframe's vanishing points the primitives they show: by the lines they share, then by angle,
/// one to one.
pub(super) fn associate(map: &mut Map, id: KeyframeId, config: &PrimitiveConfig) {
    let Some(keyframe) = map.keyframe(id) else { return };
    let mut pairs: Vec<(f64, u32, PrimitiveId)> = Vec::new();
    for vanishing_idx in 0..keyframe.vanishing.len() as u32 {
        let votes = votes(map, keyframe, vanishing_idx);
        let ranked = candidates(map, keyframe, vanishing_idx, &votes, config);
        if let Some((share, primitive)) = clear_best(&ranked, config.min_runner_up_ratio) {
            pairs.push((share, vanishing_idx, primitive));
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    for (_, vanishing_idx, primitive) in pairs {
        // Refused where the primitive or the vanishing point is taken by a better pair.
        map.add_primitive_observation(primitive, PrimitiveObservation { keyframe: id, vanishing_idx });
    }
}

/// Per primitive, how many of the vanishing point's segments see lines of it.
fn votes(map: &Map, keyframe: &Keyframe, vanishing_idx: u32) -> BTreeMap<PrimitiveId, usize> {
    let mut votes = BTreeMap::new();
    let segments = &keyframe.vanishing[vanishing_idx as usize].segments;
    for line in segments.iter().filter_map(|idx| keyframe.lines[*idx as usize]) {
        if let Some(primitive) = map.line(line).and_then(|line| line.primitive) {
            *votes.entry(primitive).or_default() += 1;
        }
    }
    votes
}

/// Primitives within their gates: angle as a share of the gate, least first.
fn candidates(
    map: &Map,
    keyframe: &Keyframe,
    vanishing_idx: u32,
    votes: &BTreeMap<PrimitiveId, usize>,
    config: &PrimitiveConfig,
) -> Vec<(f64, PrimitiveId)> {
    let Some(direction) = in_world(keyframe, vanishing_idx) else { return Vec::new() };
    let own_sigma = sigma_rad(&keyframe.vanishing[vanishing_idx as usize].covariance);
    let share_of_gate = |primitive: &GlobalPrimitive| {
        let has_votes = votes.get(&primitive.id).is_some_and(|n| *n >= config.min_votes);
        let sigma = own_sigma.hypot(sigma_rad(&primitive.covariance)).to_degrees();
        let by_angle = (config.gate_sigmas * sigma).clamp(config.min_gate_deg, config.max_gate_deg);
        let gate = if has_votes { config.voted_gate_deg } else { by_angle };
        primitive.direction.angle(&direction).to_degrees() / gate
    };
    let mut ranked: Vec<(f64, PrimitiveId)> = map
        .primitives()
        .filter(|primitive| primitive.submap == keyframe.submap)
        .map(|primitive| (share_of_gate(primitive), primitive.id))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    ranked
}

/// The best if it is within its gate and the second is much farther.
fn clear_best(ranked: &[(f64, PrimitiveId)], min_runner_up_ratio: f64) -> Option<(f64, PrimitiveId)> {
    let (best, runner_up) = (ranked.first()?, ranked.get(1));
    let is_clear = runner_up.is_none_or(|second| second.0 >= min_runner_up_ratio * best.0);
    (best.0 <= 1.0 && is_clear).then_some(*best)
}

/// Makes a primitive of a vanishing point that enough keyframes show and no primitive explains.
pub(super) fn create(map: &mut Map, id: KeyframeId, config: &PrimitiveConfig) {
    let n_vanishing = map.keyframe(id).map_or(0, |keyframe| keyframe.vanishing.len());
    for vanishing_idx in 0..n_vanishing as u32 {
        let Some((submap, sharing)) = sharing_keyframes(map, id, vanishing_idx, config) else { continue };
        let Some(estimate) = estimate_direction(map, sharing.iter().copied()) else { continue };
        let Some(covariance) = estimate.covariance() else { continue };
        if let Some(primitive) = map.add_primitive(submap, estimate.direction, covariance, id) {
            for seen in sharing {
                map.add_primitive_observation(primitive, seen);
            }
        }
    }
}

/// The unexplained vanishing points of other keyframes that agree with this one, and itself; `None` if they
/// are too few, have too few segments, or a primitive is near by already.
fn sharing_keyframes(
    map: &Map,
    id: KeyframeId,
    vanishing_idx: u32,
    config: &PrimitiveConfig,
) -> Option<(crate::map::SubmapId, Vec<PrimitiveObservation>)> {
    let keyframe = map.keyframe(id)?;
    if keyframe.vanishing[vanishing_idx as usize].primitive.is_some() {
        return None;
    }
    let direction = in_world(keyframe, vanishing_idx)?;
    let is_near = |primitive: &GlobalPrimitive| {
        primitive.submap == keyframe.submap
            && primitive.direction.angle(&direction).to_degrees() < config.max_gate_deg
    };
    if map.primitives().any(is_near) || is_contradicted(map, keyframe, vanishing_idx, &direction, config) {
        return None;
    }
    let own_sigma = sigma_rad(&keyframe.vanishing[vanishing_idx as usize].covariance);
    let mut sharing = vec![PrimitiveObservation { keyframe: id, vanishing_idx }];
    let others = map.keyframes().filter(|other| other.id != id && other.submap == keyframe.submap);
    for other in others {
        let agreeing = other.vanishing.iter().enumerate().find(|(idx, vanishing)| {
            let gate = (config.gate_sigmas * own_sigma.hypot(sigma_rad(&vanishing.covariance)).to_degrees())
                .clamp(config.min_gate_deg, config.max_gate_deg);
            vanishing.primitive.is_none()
                && in_world(other, *idx as u32)
                    .is_some_and(|theirs| theirs.angle(&direction).to_degrees() <= gate)
        });
        sharing.extend(
            agreeing.map(|(idx, _)| PrimitiveObservation { keyframe: other.id, vanishing_idx: idx as u32 }),
        );
    }
    let n_segments = |seen: &PrimitiveObservation| {
        map.keyframe(seen.keyframe)
            .map_or(0, |keyframe| keyframe.vanishing[seen.vanishing_idx as usize].segments.len())
    };
    let most_segments = sharing.iter().map(n_segments).max().unwrap_or(0);
    let n_keyframes = sharing.iter().map(|seen| seen.keyframe).collect::<BTreeSet<_>>().len();
    (n_keyframes >= config.min_keyframes && most_segments >= config.min_segments)
        .then_some((keyframe.submap, sharing))
}

/// Whether more of the lines behind a vanishing point's segments run another way in space than run towards
/// it: edges that only seem to meet, from where the camera stands.
fn is_contradicted(
    map: &Map,
    keyframe: &Keyframe,
    vanishing_idx: u32,
    direction: &Direction,
    config: &PrimitiveConfig,
) -> bool {
    let segments = &keyframe.vanishing[vanishing_idx as usize].segments;
    let lines = segments.iter().filter_map(|idx| map.line(keyframe.lines[*idx as usize]?));
    let max_sine = config.max_gate_deg.to_radians().sin();
    let (n_along, n_across) = lines.fold((0, 0), |(n_along, n_across), line| {
        let is_along = direction.as_vector().cross(line.line.direction()).norm() <= max_sine;
        (n_along + usize::from(is_along), n_across + usize::from(!is_along))
    });
    n_across > n_along
}
