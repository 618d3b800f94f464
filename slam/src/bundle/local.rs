//! Local bundle adjustment around a new keyframe. [method: Local bundle adjustment]

use super::adjustment::{Adjustment, Scope};
use super::stage_two::StageTwo;
use crate::config::{MappingConfig, SlamConfig};
use crate::cores;
use crate::map::{Keyframe, KeyframeId, LineId, Map, PointId};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};

/// Moves the keyframe, its neighbors and the landmarks they see; other keyframes that see those stay where
/// they are. Observations that disagree in the end are removed. Stops early, with what is reached, when
/// `abort` is set.
///
/// Stage one moves them by points and lines alone. Stage two, where there are primitives in sight, adds what
/// these say, and is taken back where it would turn the new keyframe by more than its own uncertainty
/// allows.
pub(crate) fn optimize(map: &mut Map, center: KeyframeId, config: &SlamConfig, abort: &AtomicBool) {
    let Some(scope) = scope_around(map, center, &config.mapping) else { return };
    let aborted = || {
        cores::let_others();
        abort.load(Ordering::Relaxed)
    };
    let mut adjustment = tracing::debug_span!("stage one").in_scope(|| {
        let mut adjustment = Adjustment::of(map, &scope);
        if config.features.global_primitives {
            adjustment.expect_primitives(map, &config.primitives);
        }
        let (n_first, n_second) = config.mapping.local_iterations;
        adjustment.solve(n_first, aborted);
        if !aborted() {
            adjustment.judge_sightings();
            adjustment.solve(n_second, aborted);
        }
        adjustment
    });
    if !aborted() {
        let added = tracing::debug_span!("stage two")
            .in_scope(|| adjustment.add_primitives(map, &config.primitives, center));
        if added == StageTwo::Refused {
            tracing::info!(keyframe = %center, "primitives would turn the keyframe too far: left out");
        }
    }
    adjustment.result().write_into(map);
}

fn scope_around(map: &Map, center: KeyframeId, config: &MappingConfig) -> Option<Scope> {
    let keyframe = map.keyframe(center)?;
    let neighbors = keyframe.covisible().iter().map(|(id, _)| *id);
    let mut free: BTreeSet<KeyframeId> =
        std::iter::once(center).chain(neighbors).take(config.max_local_keyframes).collect();
    let in_window = || free.iter().filter_map(|id| map.keyframe(*id));
    let points: BTreeSet<PointId> =
        in_window().flat_map(Keyframe::observed_points).map(|(_, id)| id).collect();
    let lines: BTreeSet<LineId> = in_window().flat_map(Keyframe::observed_lines).map(|(_, id)| id).collect();

    let mut outside: BTreeMap<KeyframeId, usize> = BTreeMap::new();
    let of_points = points.iter().filter_map(|id| map.point(*id)).flat_map(|point| &point.observations);
    let of_lines = lines.iter().filter_map(|id| map.line(*id)).flat_map(|line| &line.observations);
    for seen in of_points.chain(of_lines).filter(|seen| !free.contains(&seen.keyframe)) {
        *outside.entry(seen.keyframe).or_default() += 1;
    }
    let mut ranked: Vec<(KeyframeId, usize)> = outside.into_iter().collect();
    ranked.sort_by_key(|(id, n)| (std::cmp::Reverse(*n), *id));
    let mut fixed: BTreeSet<KeyframeId> =
        ranked.into_iter().take(config.max_fixed_keyframes).map(|(id, _)| id).collect();

    // A young map is all window: its oldest keyframe settles position and attitude, and damping the scale.
    // To fix a second one would keep the errors of the first two views for good.
    if fixed.is_empty() {
        let oldest = free.pop_first()?;
        fixed.insert(oldest);
    }
    Some(Scope { free, fixed, points, lines })
}
