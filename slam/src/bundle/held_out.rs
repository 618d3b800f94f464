//! Whether a camera holds in views that it was not fitted to. [method: Self-calibration]

use super::factors::{
    CalibratedReprojectionFactor, CalibrationPriorFactor, CorrectionVector, correction_of, vector_of,
};
use crate::config::CalibrationConfig;
use crate::map::{Keyframe, KeyframeId, Map, SubmapId};
use geometry::nalgebra::Vector3;
use geometry::{CameraCorrection, Pose};
use optim::{Kernel, Problem, SolverOptions, VariableId};
use std::collections::BTreeMap;

/// One keyframe of so many is left out of the fit.
const EVERY: usize = 3;
/// A point must be seen in so many of the others: two define it, the third holds it.
const MIN_VIEWS: usize = 3;
/// A view left out is asked if it sees so many of these points.
const MIN_POINTS: usize = 30;

/// What keyframes left out of a fit say of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HeldOut {
    /// Decrease of χ² in them, with points and camera as the others have them, against the present camera.
    pub gain: f64,
    /// The camera as the others have it.
    pub correction: CameraCorrection,
}

/// Fits the present camera, and one that is free, to two thirds of a submap's keyframes, and compares how
/// well the others, of which only the poses are free, agree with either. `None` if there are too few of them,
/// or `aborted` said so.
pub(crate) fn hold_out(
    map: &Map,
    submap: SubmapId,
    config: &CalibrationConfig,
    aborted: impl Fn() -> bool + Copy,
) -> Option<HeldOut> {
    let mut fit = Fit::of(map, submap, config);
    fit.solve(config.max_iterations, aborted);
    let present = fit.cost_of_others(map, config, aborted)?;
    fit.problem.set_fixed(fit.correction, false);
    fit.solve(2 * config.max_iterations, aborted);
    let found = fit.cost_of_others(map, config, aborted)?;
    let correction = correction_of(fit.problem.value(fit.correction));
    (!aborted()).then_some(HeldOut { gain: 2.0 * (present - found), correction })
}

/// A keyframe and which of its features.
type Sighting = (KeyframeId, usize);

/// Bundle adjustment of the keyframes that are not left out.
struct Fit {
    problem: Problem,
    correction: VariableId<CorrectionVector>,
    /// Points, with the observations in keyframes left out: which, and of which feature.
    points: Vec<(VariableId<Vector3<f64>>, Vec<Sighting>)>,
}

impl Fit {
    fn of(map: &Map, submap: SubmapId, config: &CalibrationConfig) -> Self {
        let mut problem = Problem::new();
        let mut poses = BTreeMap::new();
        // The oldest keyframe and the newest settle position, attitude and scale.
        let keyframes: Vec<&Keyframe> = map.keyframes_of(submap).collect();
        let n_keyframes = keyframes.len();
        for (idx, keyframe) in keyframes.iter().enumerate() {
            let is_left_out = idx % EVERY == EVERY - 1 && idx + 1 < n_keyframes;
            if !is_left_out {
                let variable = problem.add_variable(keyframe.camera_from_world);
                problem.set_fixed(variable, poses.is_empty());
                poses.insert(keyframe.id, variable);
            }
        }
        let correction = problem.add_variable(vector_of(&map.correction()));
        problem.set_fixed(correction, true);
        let (mut points, mut factors) = (Vec::new(), Vec::new());
        for point in map.points().filter(|point| point.submap == submap) {
            let is_fitted = |id: &KeyframeId| poses.contains_key(id);
            if point.observations.iter().filter(|seen| is_fitted(&seen.keyframe)).count() < MIN_VIEWS {
                continue;
            }
            let variable = problem.add_landmark(point.position);
            let mut left_out = Vec::new();
            for seen in &point.observations {
                let feature_idx = seen.feature_idx as usize;
                match poses.get(&seen.keyframe) {
                    Some(pose) => {
                        let Some(keyframe) = map.keyframe(seen.keyframe) else { continue };
                        factors.push((
                            (*pose, correction, variable),
                            CalibratedReprojectionFactor::of(keyframe, feature_idx),
                        ));
                    }
                    None => left_out.push((seen.keyframe, feature_idx)),
                }
            }
            points.push((variable, left_out));
        }
        problem.add_factors(Kernel::huber_95(2), factors);
        let knowledge = config.knowledge();
        let inverse_sigmas = knowledge.sigmas.map(|sigma| config.given_inflation.sqrt() / sigma);
        let prior = CalibrationPriorFactor { mean: knowledge.mean, inverse_sigmas };
        problem.add_factors(Kernel::None, [((correction,), prior)]);
        let poses: Vec<_> = poses.into_iter().collect();
        super::calibration::settle_scale(&mut problem, &poses);
        Self { problem, correction, points }
    }

    fn solve(&mut self, max_iterations: usize, aborted: impl Fn() -> bool) {
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        self.problem.solve(&options, aborted);
    }

    /// What the keyframes left out cost with points and camera held.
    fn cost_of_others(
        &self,
        map: &Map,
        config: &CalibrationConfig,
        aborted: impl Fn() -> bool + Copy,
    ) -> Option<f64> {
        let mut seen: BTreeMap<KeyframeId, Vec<(Vector3<f64>, usize)>> = BTreeMap::new();
        for (variable, left_out) in &self.points {
            let position = *self.problem.value(*variable);
            for (keyframe, feature_idx) in left_out {
                seen.entry(*keyframe).or_default().push((position, *feature_idx));
            }
        }
        let mut problem = Problem::new();
        let correction = problem.add_variable(*self.problem.value(self.correction));
        problem.set_fixed(correction, true);
        let mut factors = Vec::new();
        for (id, points) in seen.into_iter().filter(|(_, points)| points.len() >= MIN_POINTS) {
            let Some(keyframe) = map.keyframe(id) else { continue };
            let pose: VariableId<Pose> = problem.add_variable(keyframe.camera_from_world);
            for (position, feature_idx) in points {
                let point = problem.add_variable(position);
                problem.set_fixed(point, true);
                factors.push((
                    (pose, correction, point),
                    CalibratedReprojectionFactor::of(keyframe, feature_idx),
                ));
            }
        }
        if factors.is_empty() {
            return None;
        }
        let group = problem.add_factors(Kernel::huber_95(2), factors);
        let options = SolverOptions { max_iterations: config.max_iterations, ..SolverOptions::default() };
        problem.solve(&options, aborted);
        Some(problem.cost_of(group).robust)
    }
}
