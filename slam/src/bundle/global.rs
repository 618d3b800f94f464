//! Bundle adjustment of a whole submap. It works on a snapshot, beside tracking and mapping; what was added
//! to the map meanwhile is carried along when the result is merged. [method: Global bundle adjustment]

use super::adjustment::{Adjusted, Adjustment, Scope};
use super::calibration::Estimate;
use super::stage_two::StageTwo;
use crate::config::SlamConfig;
use crate::cores;
use crate::landmarks::{Anchoring, apply_corrections};
use crate::map::{Keyframe, KeyframeId, Map, SubmapId};
use crate::work::Stretch;
use geometry::{CameraCorrection, Pose, Similarity};
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};

/// How often a submap is solved, one time after the other.
const N_STAGES: usize = 3;

/// What bundle adjustment of a submap found.
#[derive(Clone, Debug, Default)]
pub(crate) struct GlobalResult {
    submap: SubmapId,
    /// The oldest keyframe, which stays where it is.
    fixed: Option<KeyframeId>,
    adjusted: Adjusted,
    /// The camera it was found with, if that is another than before.
    correction: Option<CameraCorrection>,
}

/// The cost of all sightings of a submap's points and lines (`Adjustment::cost_of_all_sightings`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Costs {
    pub before: f64,
    pub after: f64,
}

/// Adjusts every keyframe of a submap with the points and lines they see: all of it, then without the
/// outliers, then with what primitives say of keyframes that never saw the same place. `None` if `abort` was
/// set meanwhile or there is nothing to adjust.
pub(crate) fn adjust(
    map: &Map,
    submap: SubmapId,
    config: &SlamConfig,
    abort: &AtomicBool,
) -> Option<GlobalResult> {
    let mut adjustment = problem_of(map, submap, config)?;
    solve(&mut adjustment, submap, config, || {
        cores::let_others();
        abort.load(Ordering::Relaxed)
    });
    let adjusted = adjustment.result();
    let fixed = oldest(map, submap);
    (!abort.load(Ordering::Relaxed)).then_some(GlobalResult { submap, fixed, adjusted, correction: None })
}

/// As [`adjust`], telling how far it is, and what it cost before and afterwards.
pub(crate) fn adjust_watched(
    map: &Map,
    submap: SubmapId,
    config: &SlamConfig,
    stretch: &Stretch<'_>,
) -> Option<(GlobalResult, Costs)> {
    let mut adjustment = problem_of(map, submap, config)?;
    let before = adjustment.cost_of_all_sightings();
    let most = (N_STAGES * config.loops.global_iterations.max(1)) as f64;
    let n_begun = Cell::new(0_u32);
    solve(&mut adjustment, submap, config, || {
        n_begun.set(n_begun.get() + 1);
        stretch.count_iteration();
        stretch.reach(f64::from(n_begun.get()) / most)
    });
    if stretch.reach(1.0) {
        return None;
    }
    let (adjusted, fixed) = (adjustment.result(), oldest(map, submap));
    let costs = Costs { before, after: adjustment.cost_of_all_sightings() };
    Some((GlobalResult { submap, fixed, adjusted, correction: None }, costs))
}

/// The oldest keyframe settles position and attitude, and damping the scale.
fn oldest(map: &Map, submap: SubmapId) -> Option<KeyframeId> {
    map.keyframes_of(submap).map(|keyframe| keyframe.id).min()
}

fn problem_of(map: &Map, submap: SubmapId, config: &SlamConfig) -> Option<Adjustment> {
    let mut free: BTreeSet<KeyframeId> = map.keyframes_of(submap).map(|keyframe| keyframe.id).collect();
    let fixed = free.pop_first()?;
    let scope = Scope {
        free,
        fixed: BTreeSet::from([fixed]),
        points: map.points().filter(|point| point.submap == submap).map(|point| point.id).collect(),
        lines: map.lines().filter(|line| line.submap == submap).map(|line| line.id).collect(),
    };
    let mut adjustment = Adjustment::of(map, &scope);
    if config.features.global_primitives {
        adjustment.expect_primitives(map, &config.primitives);
    }
    Some(adjustment)
}

fn solve(adjustment: &mut Adjustment, submap: SubmapId, config: &SlamConfig, aborted: impl Fn() -> bool) {
    let max_iterations = config.loops.global_iterations;
    adjustment.solve(max_iterations, &aborted);
    adjustment.judge_sightings();
    adjustment.solve(max_iterations, &aborted);
    let added = adjustment.add_primitives_everywhere(&config.primitives, max_iterations, &aborted);
    if added == StageTwo::Refused {
        tracing::info!(%submap, "primitives disagree with the submap's points and lines: left out");
    }
}

/// Adjusts a submap to another camera: the one found with its poses and points, or the one of the
/// calibration.
pub(crate) fn adjust_to_camera(
    map: &Map,
    submap: SubmapId,
    refined: Option<&Estimate>,
    config: &SlamConfig,
    abort: &AtomicBool,
) -> Option<GlobalResult> {
    let mut map = map.clone();
    match refined {
        Some(estimate) => estimate.write_into(&mut map),
        None => map.set_correction(CameraCorrection::default()),
    }
    let result = adjust(&map, submap, config, abort)?;
    Some(GlobalResult { correction: Some(map.correction()), ..result })
}

impl GlobalResult {
    /// Takes the result over. Keyframes made since follow the one they hang on in the spanning tree, other
    /// landmarks the keyframe that made them.
    pub fn merge_into(self, map: &mut Map) {
        if let Some(correction) = self.correction {
            map.set_correction(correction);
        }
        let corrections: BTreeMap<KeyframeId, Similarity> = map
            .keyframes_of(self.submap)
            .filter_map(|keyframe| {
                let (adjusted, before) = self.nearest_adjusted(map, keyframe)?;
                Some((keyframe.id, Similarity::from_pose(&(adjusted.inverse() * before))))
            })
            .collect();
        apply_corrections(map, &corrections, &Anchoring::default());
        self.adjusted.write_into(map);
    }

    /// The adjusted and the present pose of the keyframe itself, or of the nearest one above it in the
    /// spanning tree.
    fn nearest_adjusted(&self, map: &Map, keyframe: &Keyframe) -> Option<(Pose, Pose)> {
        let mut current = keyframe;
        // Each step goes one up in the tree; the bound is for safety.
        for _ in 0..=map.n_keyframes() {
            if let Some(adjusted) = self.adjusted.poses.get(&current.id) {
                return Some((*adjusted, current.camera_from_world));
            }
            if self.fixed == Some(current.id) {
                return Some((current.camera_from_world, current.camera_from_world));
            }
            current = map.keyframe(current.parent?)?;
        }
        None
    }
}
