//! Bundle adjustment of a whole submap. It works on a snapshot, beside tracking and mapping; what was added to the map
//! meanwhile is carried along when the result is merged. [ALGORITHMS 7.6, 8.3]

use super::factors::PointReprojectionFactor;
use crate::loops::{Anchoring, apply_corrections};
use crate::map::{Keyframe, KeyframeId, Map, PointId, SubmapId};
use geometry::nalgebra::Vector3;
use geometry::{Pose, Similarity};
use optim::{GroupId, Kernel, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// What bundle adjustment found.
#[derive(Clone, Debug, Default)]
pub(crate) struct GlobalResult {
    submap: SubmapId,
    poses: BTreeMap<KeyframeId, Pose>,
    points: Vec<(PointId, Vector3<f64>)>,
    /// Sightings that disagree with it.
    outliers: Vec<(PointId, KeyframeId)>,
}

/// Adjusts every key frame of a submap and what they see, in two rounds: all of it, then without the outliers. `None` if
/// `abort` was set meanwhile or there is nothing to adjust.
pub(crate) fn adjust(
    map: &Map,
    submap: SubmapId,
    max_iterations: usize,
    abort: &AtomicBool,
) -> Option<GlobalResult> {
    let mut adjustment = Adjustment::of(map, submap)?;
    adjustment.add_points(map);
    adjustment.solve(max_iterations, abort);
    (!abort.load(Ordering::Relaxed)).then(|| adjustment.result())
}

/// The optimisation problem with the names of its variables. A kind of landmark is one `add_…` that makes variables and
/// factors, and its lines in [`solve`](Self::solve) and [`result`](Self::result).
struct Adjustment {
    submap: SubmapId,
    problem: Problem,
    poses: BTreeMap<KeyframeId, VariableId<Pose>>,
    points: Vec<(PointId, VariableId<Vector3<f64>>)>,
    point_group: Option<GroupId<PointReprojectionFactor>>,
    /// Which sighting each factor of the points stands for.
    point_sightings: Vec<(PointId, KeyframeId)>,
}

impl Adjustment {
    /// The key frames. The oldest stays where it is, and damping settles the scale.
    fn of(map: &Map, submap: SubmapId) -> Option<Self> {
        let mut problem = Problem::new();
        let poses: BTreeMap<KeyframeId, VariableId<Pose>> = map
            .keyframes_of(submap)
            .map(|keyframe| (keyframe.id, problem.add_variable(keyframe.camera_from_world)))
            .collect();
        problem.set_fixed(*poses.values().next()?, true);
        Some(Self {
            submap,
            problem,
            poses,
            points: Vec::new(),
            point_group: None,
            point_sightings: Vec::new(),
        })
    }

    fn add_points(&mut self, map: &Map) {
        let mut factors = Vec::new();
        for point in map.points().filter(|point| point.submap == self.submap) {
            let variable = self.problem.add_landmark(point.position);
            self.points.push((point.id, variable));
            for seen in &point.observations {
                let (Some(pose), Some(keyframe)) =
                    (self.poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
                else {
                    continue;
                };
                let feature_idx = seen.feature_idx as usize;
                let factor = PointReprojectionFactor {
                    pinhole: keyframe.features.pinhole,
                    observed_px: keyframe.features.undistorted[feature_idx],
                    inverse_sigma: 1.0 / keyframe.features.sigma_px(feature_idx),
                };
                factors.push(((*pose, variable), factor));
                self.point_sightings.push((point.id, seen.keyframe));
            }
        }
        self.point_group = Some(self.problem.add_factors(Kernel::huber_95(2), factors));
    }

    fn solve(&mut self, max_iterations: usize, abort: &AtomicBool) {
        let aborted = || abort.load(Ordering::Relaxed);
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        self.problem.solve(&options, aborted);
        if let Some(group) = self.point_group {
            self.problem.enable_inliers(group, chi2_95(2));
        }
        self.problem.solve(&options, aborted);
    }

    fn result(&self) -> GlobalResult {
        let disagrees = |factor_idx: usize| {
            let chi2 = self.point_group.and_then(|group| self.problem.chi2(group, factor_idx));
            chi2.is_none_or(|chi2| chi2 > chi2_95(2))
        };
        GlobalResult {
            submap: self.submap,
            poses: self.poses.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
            points: self.points.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
            outliers: (0..self.point_sightings.len())
                .filter(|factor_idx| disagrees(*factor_idx))
                .map(|factor_idx| self.point_sightings[factor_idx])
                .collect(),
        }
    }
}

impl GlobalResult {
    /// Takes the result over. Key frames made since follow the one they hang on in the spanning tree, other landmarks the
    /// key frame that made them.
    pub fn merge_into(self, map: &mut Map) {
        let corrections: BTreeMap<KeyframeId, Similarity> = map
            .keyframes_of(self.submap)
            .filter_map(|keyframe| {
                let (adjusted, before) = self.nearest_adjusted(map, keyframe)?;
                Some((keyframe.id, Similarity::from_pose(&(adjusted.inverse() * before))))
            })
            .collect();
        apply_corrections(map, &corrections, &Anchoring::default());
        for (id, position) in &self.points {
            map.set_position(*id, *position);
        }
        for (point, keyframe) in &self.outliers {
            map.remove_observation(*point, *keyframe);
        }
        for (id, _) in &self.points {
            map.refresh_point_geometry(*id);
        }
    }

    /// The adjusted and the present pose of the key frame itself, or of the nearest one above it in the spanning tree.
    fn nearest_adjusted(&self, map: &Map, keyframe: &Keyframe) -> Option<(Pose, Pose)> {
        let mut current = keyframe;
        // Each step goes one up in the tree; the bound is for safety.
        for _ in 0..=map.n_keyframes() {
            if let Some(adjusted) = self.poses.get(&current.id) {
                return Some((*adjusted, current.camera_from_world));
            }
            current = map.keyframe(current.parent?)?;
        }
        None
    }
}
