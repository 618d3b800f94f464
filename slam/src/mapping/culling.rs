//! Map-point and keyframe culling: points that are not found again, keyframes whose landmarks others see as
//! well.

use crate::config::{MappingConfig, SlamConfig};
use crate::map::{Keyframe, KeyframeId, Map, PointId};

/// Observations that a point needs to survive its probation, or all there are keyframes for.
const MIN_OBSERVATIONS: usize = 3;
/// Keyframes other than the judged one that must see a point for it to count as redundant.
const N_REDUNDANT_OBSERVERS: usize = 3;
/// Largest difference between the units of a culled keyframe and of the one that takes its place, as a
/// logarithm.
const MAX_LOCAL_SCALE_STEP: f64 = 0.05;
/// Keyframes of a camera that are never culled, counted from the newest: they carry the tracking.
const N_PROTECTED: u64 = 2;

/// Judges young points: out if rarely found, or not seen by three keyframes soon enough.
pub(super) fn cull_recent_points(
    map: &mut Map,
    recent: &mut Vec<PointId>,
    newest: KeyframeId,
    config: &MappingConfig,
) {
    recent.retain(|id| {
        let Some(point) = map.point(*id) else { return false };
        let age = map.age(point.created_by, newest, config.probation_keyframes);
        let unreliable = point.found_ratio() < config.min_found_ratio;
        let unconfirmed = age >= config.probation_keyframes && point.observations.len() < MIN_OBSERVATIONS;
        if unreliable || unconfirmed {
            map.remove_point(*id);
            return false;
        }
        age <= config.probation_keyframes
    });
}

/// Takes out keyframes near the new one whose points others see just as well, and keeps the map below its
/// cap.
pub(super) fn cull_keyframes(map: &mut Map, newest: KeyframeId, config: &SlamConfig) {
    let neighbors: Vec<KeyframeId> = map
        .keyframe(newest)
        .map_or(Vec::new(), |keyframe| keyframe.covisible().iter().map(|(id, _)| *id).collect());
    for id in neighbors {
        if is_protected(map, id, newest) {
            continue;
        }
        let share = map.keyframe(id).map_or(0.0, |keyframe| redundancy(map, keyframe));
        if share >= config.mapping.redundant_share {
            remove(map, id);
        }
    }
    if map.n_keyframes() > config.keyframes.max_keyframes {
        remove_most_redundant(map, newest);
    }
}

/// Share of a keyframe's points and lines that enough others see, points at the same or a finer level.
fn redundancy(map: &Map, keyframe: &Keyframe) -> f64 {
    let (mut n_landmarks, mut n_redundant) = (0usize, 0usize);
    for (feature_idx, id) in keyframe.observed_points() {
        let Some(point) = map.point(id) else { continue };
        n_landmarks += 1;
        if point.observations.len() <= N_REDUNDANT_OBSERVERS {
            continue;
        }
        let octave = keyframe.features.keypoints[feature_idx].octave;
        let observers = point.observations.iter().filter(|seen| seen.keyframe != keyframe.id);
        let as_good = observers.filter(|seen| {
            map.keyframe(seen.keyframe)
                .is_some_and(|other| other.features.keypoints[seen.feature_idx as usize].octave <= octave + 1)
        });
        n_redundant += usize::from(as_good.take(N_REDUNDANT_OBSERVERS).count() == N_REDUNDANT_OBSERVERS);
    }
    for line in keyframe.observed_lines().filter_map(|(_, id)| map.line(id)) {
        n_landmarks += 1;
        n_redundant += usize::from(line.observations.len() > N_REDUNDANT_OBSERVERS);
    }
    n_redundant as f64 / n_landmarks.max(1) as f64
}

fn is_protected(map: &Map, id: KeyframeId, newest: KeyframeId) -> bool {
    let keyframe = map.keyframe(id);
    let parent = keyframe.and_then(|keyframe| map.keyframe(keyframe.parent?));
    // What hangs on a removed keyframe is measured in its unit, so only one of the same unit can take its
    // place.
    let same_unit = |keyframe: &Keyframe, parent: &Keyframe| {
        (keyframe.local_scale / parent.local_scale).ln().abs() < MAX_LOCAL_SCALE_STEP
    };
    let is_held = !keyframe.zip(parent).is_some_and(|(keyframe, parent)| same_unit(keyframe, parent));
    is_held || map.age(id, newest, N_PROTECTED) <= N_PROTECTED
}

fn remove(map: &mut Map, id: KeyframeId) {
    let anchor = map.keyframe(id).and_then(|keyframe| keyframe.parent);
    if let Some(anchor) = anchor {
        map.remove_keyframe(id, anchor);
    }
}

fn remove_most_redundant(map: &mut Map, newest: KeyframeId) {
    let candidates = map.keyframes().filter(|keyframe| !is_protected(map, keyframe.id, newest));
    let most = candidates
        .map(|keyframe| (redundancy(map, keyframe), keyframe.id))
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
    if let Some((_, id)) = most {
        remove(map, id);
    }
}
