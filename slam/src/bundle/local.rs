//! Local bundle adjustment around a new key frame. [ALGORITHMS 8.3]

use super::factors::PointReprojectionFactor;
use crate::config::MappingConfig;
use crate::map::{Keyframe, KeyframeId, Map, PointId};
use geometry::Pose;
use geometry::nalgebra::Vector3;
use optim::{GroupId, Kernel, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};

/// What local bundle adjustment moves and what holds it in place.
struct Window {
    free: BTreeSet<KeyframeId>,
    points: BTreeSet<PointId>,
    fixed: BTreeSet<KeyframeId>,
}

/// Moves the key frame, its neighbours and the points they see; other key frames that see those points stay where
/// they are. Sightings that disagree in the end are removed. Stops early, with what is reached, when `abort` is set.
pub(crate) fn optimise(map: &mut Map, centre: KeyframeId, config: &MappingConfig, abort: &AtomicBool) {
    let Some(window) = Window::around(map, centre, config) else { return };
    let mut adjustment = Adjustment::of(map, &window);
    let options = |max_iterations| SolverOptions { max_iterations, ..SolverOptions::default() };
    let aborted = || abort.load(Ordering::Relaxed);
    let (n_first, n_second) = config.local_iterations;
    adjustment.problem.solve(&options(n_first), aborted);
    if !aborted() {
        adjustment.problem.enable_inliers(adjustment.group, chi2_95(2));
        adjustment.problem.solve(&options(n_second), aborted);
    }
    adjustment.write_back(map);
}

impl Window {
    fn around(map: &Map, centre: KeyframeId, config: &MappingConfig) -> Option<Self> {
        let keyframe = map.keyframe(centre)?;
        let neighbours = keyframe.covisible().iter().map(|(id, _)| *id);
        let mut free: BTreeSet<KeyframeId> =
            std::iter::once(centre).chain(neighbours).take(config.max_local_keyframes).collect();
        let observed = |id: &KeyframeId| map.keyframe(*id).into_iter().flat_map(Keyframe::observed_points);
        let points: BTreeSet<PointId> = free.iter().flat_map(observed).map(|(_, id)| id).collect();

        let mut outside: BTreeMap<KeyframeId, usize> = BTreeMap::new();
        for point in points.iter().filter_map(|id| map.point(*id)) {
            for seen in point.observations.iter().filter(|seen| !free.contains(&seen.keyframe)) {
                *outside.entry(seen.keyframe).or_default() += 1;
            }
        }
        let mut ranked: Vec<(KeyframeId, usize)> = outside.into_iter().collect();
        ranked.sort_by_key(|(id, n)| (std::cmp::Reverse(*n), *id));
        let mut fixed: BTreeSet<KeyframeId> =
            ranked.into_iter().take(config.max_fixed_keyframes).map(|(id, _)| id).collect();

        // A young map is all window: its oldest key frame settles position and attitude, and damping the scale. To fix
        // a second one would keep the errors of the first two views for good.
        if fixed.is_empty() {
            let oldest = free.pop_first()?;
            fixed.insert(oldest);
        }
        Some(Self { free, points, fixed })
    }
}

/// The optimisation problem with the names of its variables.
struct Adjustment {
    problem: Problem,
    poses: BTreeMap<KeyframeId, VariableId<Pose>>,
    points: Vec<(PointId, VariableId<Vector3<f64>>)>,
    group: GroupId<PointReprojectionFactor>,
    /// Which sighting each factor stands for.
    sightings: Vec<(PointId, KeyframeId)>,
    free: BTreeSet<KeyframeId>,
}

impl Adjustment {
    fn of(map: &Map, window: &Window) -> Self {
        let mut problem = Problem::new();
        let mut poses = BTreeMap::new();
        for id in window.free.iter().chain(&window.fixed) {
            let Some(keyframe) = map.keyframe(*id) else { continue };
            let variable = problem.add_variable(keyframe.camera_from_world);
            problem.set_fixed(variable, window.fixed.contains(id));
            poses.insert(*id, variable);
        }
        let (mut points, mut factors, mut sightings) = (Vec::new(), Vec::new(), Vec::new());
        for point in window.points.iter().filter_map(|id| map.point(*id)) {
            let variable = problem.add_landmark(point.position);
            points.push((point.id, variable));
            for seen in &point.observations {
                let (Some(pose), Some(keyframe)) = (poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
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
                sightings.push((point.id, seen.keyframe));
            }
        }
        let group = problem.add_factors(Kernel::huber_95(2), factors);
        Self { problem, poses, points, group, sightings, free: window.free.clone() }
    }

    fn write_back(&self, map: &mut Map) {
        for id in &self.free {
            if let Some(variable) = self.poses.get(id) {
                map.set_pose(*id, *self.problem.value(*variable));
            }
        }
        for (id, variable) in &self.points {
            map.set_position(*id, *self.problem.value(*variable));
        }
        for (factor_idx, (point, keyframe)) in self.sightings.iter().enumerate() {
            let chi2 = self.problem.chi2(self.group, factor_idx);
            if chi2.is_none_or(|chi2| chi2 > chi2_95(2)) {
                map.remove_observation(*point, *keyframe);
            }
        }
        for (id, _) in &self.points {
            map.refresh_point_geometry(*id);
        }
    }
}
