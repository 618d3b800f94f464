//! The readout of a rolling shutter: bundle adjustment of a submap with it free, beside the camera as far as
//! that may be wrong. What bends a map that was made without regard to the shutter is then free to unbend.
//! [method: Rolling shutter]

use super::calibration::settle_scale;
use super::factors::{
    CalibratedReprojectionFactor, RolledReprojectionFactor, RollingCamera, RollingCameraPriorFactor,
    vector_of,
};
use crate::config::CalibrationConfig;
use crate::map::{Keyframe, KeyframeId, Map, Observation, PointId, SubmapId};
use crate::rolling_shutter::{Motions, RollingShutter};
use geometry::Pose;
use geometry::nalgebra::Vector3;
use optim::{GroupId, Kernel, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::BTreeMap;

/// One keyframe of so many is left out of the fit that the others are asked about.
const EVERY: usize = 3;
/// A point of that fit must be seen in so many keyframes: two define it, the third holds it.
const MIN_VIEWS: usize = 3;
/// A keyframe left out is asked if it sees so many of these points.
const MIN_POINTS: usize = 30;
/// A coefficient that is not to be changed is held this tightly; a readout, in seconds, too.
const HELD_SIGMA: f64 = 1e-6;
/// Nanoseconds in a second.
const NS: f64 = 1e9;

/// What is known of a submap's keyframes, and how they are looked at.
#[derive(Clone, Copy)]
pub(crate) struct Rolling<'a> {
    pub map: &'a Map,
    pub submap: SubmapId,
    pub shutter: &'a RollingShutter,
    /// How the camera moved at each keyframe; others are passed over.
    pub motions: &'a Motions,
    pub calibration: &'a CalibrationConfig,
}

/// The readout by which a submap's points are explained best, with the poses and points that belong to it.
#[derive(Clone, Debug)]
pub(crate) struct ReadoutEstimate {
    /// How much longer it is than the present one, nanoseconds.
    pub change_ns: f64,
    /// Its standard deviation, with errors of keypoints as correlated as they turned out to be; infinite if
    /// undetermined.
    pub sigma_ns: f64,
    poses: Vec<(KeyframeId, Pose)>,
    points: Vec<(PointId, Vector3<f64>)>,
}

/// What keyframes left out of a fit say of the readout.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HeldOutReadout {
    /// Decrease of χ² in them, with points and readout as the others have them, against the present readout.
    pub gain: f64,
    /// The change of the readout as the others have it, nanoseconds.
    pub change_ns: f64,
}

impl Rolling<'_> {
    /// Adjusts the submap with the readout free. `None` if `aborted` said so, or nothing is known of the
    /// motion.
    pub fn estimate(&self, aborted: impl Fn() -> bool + Copy) -> Option<ReadoutEstimate> {
        let mut fit = Fit::of(self, 2, |_| true)?;
        fit.solve(self.calibration.max_iterations, aborted);
        fit.problem.enable_inliers(fit.observations, chi2_95(2));
        fit.solve(self.calibration.max_iterations, aborted);
        let sigma_ns = NS * fit.sigma_s(self.calibration);
        let change_ns = self.change_ns(&fit);
        let pose = |(id, variable): &(KeyframeId, VariableId<Pose>)| (*id, *fit.problem.value(*variable));
        let point = |point: &FittedPoint| (point.id, *fit.problem.value(point.variable));
        (!aborted()).then(|| ReadoutEstimate {
            change_ns,
            sigma_ns,
            poses: fit.poses.iter().map(pose).collect(),
            points: fit.points.iter().map(point).collect(),
        })
    }

    /// Fits the present readout, and one that is free, to two thirds of the keyframes, and compares how well
    /// the others, of which only the poses are free, agree with either. `None` if there are too few of them,
    /// or `aborted` said so.
    pub fn hold_out(&self, aborted: impl Fn() -> bool + Copy) -> Option<HeldOutReadout> {
        let n_keyframes = self.map.keyframes_of(self.submap).count();
        let is_fitted = |idx: usize| idx % EVERY != EVERY - 1 || idx + 1 == n_keyframes;
        let mut fit = Fit::of(self, MIN_VIEWS, is_fitted)?;
        fit.hold_readout(self, true);
        fit.solve(self.calibration.max_iterations, aborted);
        let present = fit.cost_of_others(self, aborted)?;
        fit.hold_readout(self, false);
        fit.solve(self.calibration.max_iterations, aborted);
        let found = fit.cost_of_others(self, aborted)?;
        let change_ns = self.change_ns(&fit);
        (!aborted()).then_some(HeldOutReadout { gain: 2.0 * (present - found), change_ns })
    }

    fn factor(&self, keyframe: &Keyframe, feature_idx: usize) -> Option<RolledReprojectionFactor> {
        let velocity = self.motions.get(&keyframe.id)?;
        let share = self.shutter.share(f64::from(keyframe.features.keypoints[feature_idx].y));
        Some(RolledReprojectionFactor {
            still: CalibratedReprojectionFactor::of(keyframe, feature_idx),
            motion: velocity * (NS * share),
            middle_from_place: Pose::exp(&(keyframe.features.unrolled * -share)),
        })
    }

    /// The camera may be off by what a calibration can be wrong by, so that what is the lens's is not taken
    /// for the shutter's.
    fn prior(&self, holds_readout: bool) -> RollingCameraPriorFactor {
        let CalibrationConfig { focal_sigma, center_sigma, given_inflation, .. } = *self.calibration;
        let sigmas = [focal_sigma, center_sigma, center_sigma, HELD_SIGMA, HELD_SIGMA, HELD_SIGMA];
        let mut inverse_sigmas = RollingCamera::from(sigmas).map(|sigma| given_inflation.sqrt() / sigma);
        if !holds_readout {
            inverse_sigmas[5] = 0.0;
        }
        RollingCameraPriorFactor { mean: self.present(), inverse_sigmas }
    }

    fn present(&self) -> RollingCamera {
        let mut camera = RollingCamera::zeros();
        camera.fixed_rows_mut::<5>(0).copy_from(&vector_of(&self.map.correction()));
        camera[5] = self.shutter.readout_ns() as f64 / NS;
        camera
    }

    /// By how much a fit's readout is longer than the present one, nanoseconds.
    fn change_ns(&self, fit: &Fit) -> f64 {
        NS * (fit.problem.value(fit.camera)[5] - self.present()[5])
    }
}

/// Bundle adjustment of some keyframes of a submap.
struct Fit {
    problem: Problem,
    camera: VariableId<RollingCamera>,
    poses: Vec<(KeyframeId, VariableId<Pose>)>,
    points: Vec<FittedPoint>,
    observations: GroupId<RolledReprojectionFactor>,
    prior: GroupId<RollingCameraPriorFactor>,
    /// Which point each observation is of, counted.
    point_of: Vec<usize>,
    /// Which keyframe it was made in, likewise.
    keyframe_of: Vec<usize>,
}

struct FittedPoint {
    id: PointId,
    variable: VariableId<Vector3<f64>>,
    /// Those in keyframes that are not fitted.
    left_out: Vec<Observation>,
}

impl Fit {
    /// Of the keyframes whose motion is known and that `is_fitted` says by their number, and of the points
    /// that so many of them see.
    fn of(rolling: &Rolling, min_views: usize, is_fitted: impl Fn(usize) -> bool) -> Option<Self> {
        let Rolling { map, submap, motions, .. } = *rolling;
        let mut problem = Problem::new();
        let mut variables: BTreeMap<KeyframeId, (usize, VariableId<Pose>)> = BTreeMap::new();
        for (_, keyframe) in map.keyframes_of(submap).enumerate().filter(|(idx, _)| is_fitted(*idx)) {
            if motions.contains_key(&keyframe.id) {
                let variable = problem.add_variable(keyframe.camera_from_world);
                // The oldest keyframe settles position and attitude.
                problem.set_fixed(variable, variables.is_empty());
                variables.insert(keyframe.id, (variables.len(), variable));
            }
        }
        let camera = problem.add_variable(rolling.present());
        let (mut points, mut factors) = (Vec::new(), Vec::new());
        let (mut point_of, mut keyframe_of) = (Vec::new(), Vec::new());
        for point in map.points().filter(|point| point.submap == submap) {
            let is_fitted = |seen: &&Observation| variables.contains_key(&seen.keyframe);
            if point.observations.iter().filter(is_fitted).count() < min_views {
                continue;
            }
            let variable = problem.add_landmark(point.position);
            let mut left_out = Vec::new();
            for seen in &point.observations {
                let Some((position, pose)) = variables.get(&seen.keyframe) else {
                    left_out.push(*seen);
                    continue;
                };
                let Some(factor) = map
                    .keyframe(seen.keyframe)
                    .and_then(|keyframe| rolling.factor(keyframe, seen.feature_idx as usize))
                else {
                    continue;
                };
                factors.push(((*pose, camera, variable), factor));
                point_of.push(points.len());
                keyframe_of.push(*position);
            }
            points.push(FittedPoint { id: point.id, variable, left_out });
        }
        if factors.is_empty() {
            return None;
        }
        let observations = problem.add_factors(Kernel::huber_95(2), factors);
        let prior = problem.add_factors(Kernel::None, [((camera,), rolling.prior(false))]);
        let poses: Vec<_> = variables.into_iter().map(|(id, (_, variable))| (id, variable)).collect();
        settle_scale(&mut problem, &poses);
        Some(Self { problem, camera, poses, points, observations, prior, point_of, keyframe_of })
    }

    fn hold_readout(&mut self, rolling: &Rolling, holds: bool) {
        self.problem.replace_factor(self.prior, 0, rolling.prior(holds));
    }

    fn solve(&mut self, max_iterations: usize, aborted: impl Fn() -> bool) {
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        self.problem.solve(&options, aborted);
    }

    /// Standard deviation of the readout, seconds: with the errors of one point, or of one keyframe, taken as
    /// one error, whichever says more, and no less than if all errors were independent and as large as said:
    /// few keyframes show their errors too small.
    fn sigma_s(&mut self, calibration: &CalibrationConfig) -> f64 {
        let mut of = |cluster_of: &[usize]| {
            let covariance = self.problem.clustered_covariance(self.camera, self.observations, cluster_of)?;
            Some((covariance.expected[(5, 5)], covariance.observed[(5, 5)]))
        };
        let (Some((expected, by_point)), Some((_, by_keyframe))) =
            (of(&self.point_of), of(&self.keyframe_of))
        else {
            return f64::INFINITY;
        };
        let variance = (calibration.given_inflation * by_point.max(by_keyframe)).max(expected);
        tracing::debug!(expected, by_point, by_keyframe, "variances of the readout, squared seconds");
        variance.sqrt()
    }

    /// What the keyframes left out cost with points and camera held.
    fn cost_of_others(&self, rolling: &Rolling, aborted: impl Fn() -> bool + Copy) -> Option<f64> {
        let mut seen: BTreeMap<KeyframeId, Vec<(Vector3<f64>, usize)>> = BTreeMap::new();
        for point in &self.points {
            let position = *self.problem.value(point.variable);
            for left_out in &point.left_out {
                seen.entry(left_out.keyframe).or_default().push((position, left_out.feature_idx as usize));
            }
        }
        let mut problem = Problem::new();
        let camera = problem.add_variable(*self.problem.value(self.camera));
        problem.set_fixed(camera, true);
        let mut factors = Vec::new();
        for (id, points) in seen.into_iter().filter(|(_, points)| points.len() >= MIN_POINTS) {
            let Some(keyframe) = rolling.map.keyframe(id) else { continue };
            let pose: VariableId<Pose> = problem.add_variable(keyframe.camera_from_world);
            for (position, feature_idx) in points {
                let Some(factor) = rolling.factor(keyframe, feature_idx) else { continue };
                let point = problem.add_variable(position);
                problem.set_fixed(point, true);
                factors.push(((pose, camera, point), factor));
            }
        }
        if factors.is_empty() {
            return None;
        }
        let group = problem.add_factors(Kernel::huber_95(2), factors);
        let max_iterations = rolling.calibration.max_iterations;
        problem.solve(&SolverOptions { max_iterations, ..SolverOptions::default() }, aborted);
        Some(problem.cost_of(group).robust)
    }
}

impl ReadoutEstimate {
    /// Puts the poses and the points into a map.
    pub fn write_into(&self, map: &mut Map) {
        for (id, pose) in &self.poses {
            map.set_pose(*id, *pose);
        }
        for (id, position) in &self.points {
            map.set_position(*id, *position);
        }
    }
}
