//! Self-calibration: bundle adjustment of a submap with the camera free: focal length, principal point and,
//! where they are not given, radial distortion. [method: Self-calibration]

use super::factors::{
    BaselineLengthFactor, CalibratedReprojectionFactor, CalibrationPriorFactor, CorrectionVector,
    OrthogonalityFactor, correction_of, vector_of,
};
use crate::config::{CalibrationConfig, CalibrationTrust};
use crate::features::FrameFeatures;
use crate::map::{KeyframeId, Map, PointId, PrimitiveId, SubmapId};
use geometry::nalgebra::{DMatrix, Vector3};
use geometry::{CameraCorrection, Pose};
use optim::{Factor as _, GroupId, Kernel, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::BTreeMap;

/// Standard deviation of the length that settles the free scale, as a share of it.
const SCALE_SIGMA: f64 = 1e-3;
/// How tightly a focal length under trial is held, in its logarithm.
const HELD_FOCAL_SIGMA: f64 = 1e-4;

/// What is known of a camera before its images are seen: expectation and standard deviation of the logarithm
/// of its focal length, of its principal point and of its radial distortion, all as members of a correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Knowledge {
    pub mean: CorrectionVector,
    pub sigmas: CorrectionVector,
}

/// A coefficient that is not to be changed is held this tightly.
const HELD_SIGMA: f64 = 1e-6;

impl CalibrationConfig {
    /// What is known of the camera by what was said of it.
    pub(crate) fn knowledge(&self) -> Knowledge {
        let sigmas = match self.trust {
            CalibrationTrust::Given => {
                [self.focal_sigma, self.center_sigma, self.center_sigma, HELD_SIGMA, HELD_SIGMA]
            }
            CalibrationTrust::Approximate => self.loose(self.approximate_focal_sigma, 1.0),
            CalibrationTrust::Unknown => self.loose(self.unknown_focal_sigma, 1.0),
        };
        Knowledge { mean: CorrectionVector::zeros(), sigmas: CorrectionVector::from(sigmas) }
    }

    /// What is known of a camera by the size of its image alone, as a correction of the calibration that the
    /// features are of.
    pub(crate) fn knowledge_of_size(&self, features: &FrameFeatures) -> Knowledge {
        let nominal = features.nominal_pinhole;
        let (low, high) = features.nominal_corners();
        let (size, center) = (high - low, (low + high) * 0.5);
        let focal = self.unknown_focal_share * size.x.max(size.y) / nominal.mean_focal_px();
        let off = [(center.x - nominal.cx) / nominal.fx, (center.y - nominal.cy) / nominal.fy];
        Knowledge {
            mean: CorrectionVector::from([focal.ln(), off[0], off[1], 0.0, 0.0]),
            sigmas: CorrectionVector::from(self.loose(self.unknown_focal_sigma, focal)),
        }
    }

    /// Standard deviations of a camera that was not calibrated and whose focal length is expected to be this
    /// many times the nominal one.
    fn loose(&self, focal_sigma: f64, focal: f64) -> [f64; 5] {
        let center_sigma = self.unknown_center_sigma * focal;
        [focal_sigma, center_sigma, center_sigma, self.radial_sigma, self.second_radial_sigma]
    }
}

/// The camera by which a submap's points are explained best, with the poses and points that belong to it.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// How it differs from the calibration.
    pub correction: CameraCorrection,
    /// Standard deviations of its members, with what was known before and with errors of keypoints that are
    /// correlated as they turned out to be; infinite if undetermined.
    pub sigmas: CorrectionVector,
    /// How many times as large the variance is that those errors show, as it would be without correlation.
    pub inflation: f64,
    /// Decrease of χ² against the present camera, for errors as correlated as they turned out to be.
    pub gain: f64,
    /// The same by the images alone, without what was known before.
    pub image_gain: f64,
    poses: Vec<(KeyframeId, Pose)>,
    points: Vec<(PointId, Vector3<f64>)>,
}

/// Bundle adjustment of a submap's points with the camera as a further variable.
pub(crate) struct Calibration<'a> {
    config: &'a CalibrationConfig,
    problem: Problem,
    poses: Vec<(KeyframeId, VariableId<Pose>)>,
    correction: VariableId<CorrectionVector>,
    points: Vec<(PointId, VariableId<Vector3<f64>>)>,
    observations: GroupId<CalibratedReprojectionFactor>,
    /// Which point each observation is of, counted.
    point_of: Vec<usize>,
    /// Which keyframe it was made in, likewise.
    keyframe_of: Vec<usize>,
    /// Right angles between vanishing directions; none where the calibration is given.
    right_angles: GroupId<OrthogonalityFactor>,
    knowledge: Knowledge,
    prior: GroupId<CalibrationPriorFactor>,
    /// Holds a focal length under trial.
    trial: GroupId<CalibrationPriorFactor>,
}

/// The values of all variables at some moment.
struct State {
    correction: CorrectionVector,
    poses: Vec<Pose>,
    points: Vec<Vector3<f64>>,
}

impl<'a> Calibration<'a> {
    /// With the camera held as it is at present.
    pub fn of(map: &Map, submap: SubmapId, knowledge: Knowledge, config: &'a CalibrationConfig) -> Self {
        let mut problem = Problem::new();
        let mut poses = BTreeMap::new();
        for keyframe in map.keyframes_of(submap) {
            let variable = problem.add_variable(keyframe.camera_from_world);
            // The oldest keyframe settles position and attitude.
            problem.set_fixed(variable, poses.is_empty());
            poses.insert(keyframe.id, variable);
        }
        let correction = problem.add_variable(vector_of(&map.correction()));
        problem.set_fixed(correction, true);
        let (mut points, mut factors) = (Vec::new(), Vec::new());
        let (mut point_of, mut keyframe_of) = (Vec::new(), Vec::new());
        let positions: BTreeMap<KeyframeId, usize> =
            poses.keys().enumerate().map(|(position, id)| (*id, position)).collect();
        for point in map.points().filter(|point| point.submap == submap) {
            let variable = problem.add_landmark(point.position);
            for seen in &point.observations {
                let (Some(pose), Some(keyframe)) = (poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
                else {
                    continue;
                };
                let feature_idx = seen.feature_idx as usize;
                let factor = CalibratedReprojectionFactor::of(keyframe, feature_idx);
                factors.push(((*pose, correction, variable), factor));
                point_of.push(points.len());
                keyframe_of.push(positions[&seen.keyframe]);
            }
            points.push((point.id, variable));
        }
        let observations = problem.add_factors(Kernel::huber_95(2), factors);
        let nothing =
            CalibrationPriorFactor { mean: knowledge.mean, inverse_sigmas: CorrectionVector::zeros() };
        let prior = problem.add_factors(Kernel::None, [((correction,), nothing)]);
        let trial = problem.add_factors(Kernel::None, [((correction,), nothing)]);
        problem.set_group_enabled(trial, false);
        let right_angles = right_angles(map, submap, config);
        let right_angles = right_angles.into_iter().map(|factor| ((correction,), factor));
        let right_angles = problem.add_factors(Kernel::cauchy_95(), right_angles);
        if knowledge == config.knowledge() && config.trust == CalibrationTrust::Given {
            problem.set_group_enabled(right_angles, false);
        }
        let poses: Vec<_> = poses.into_iter().collect();
        settle_scale(&mut problem, &poses);
        let mut calibration = Self {
            config,
            problem,
            poses,
            correction,
            points,
            observations,
            point_of,
            keyframe_of,
            right_angles,
            knowledge,
            prior,
            trial,
        };
        calibration.weigh_knowledge(calibration.least_inflation());
        calibration
    }

    /// The camera that explains the points best. With `search` also if that is far from the present one.
    /// `None` if `aborted` said so.
    pub fn estimate(mut self, search: bool, aborted: impl Fn() -> bool + Copy) -> Option<Estimate> {
        let max_iterations = self.config.max_iterations;
        // First all that the present camera can do, so that the difference is the camera's.
        self.solve(max_iterations, aborted);
        if !search {
            self.problem.enable_inliers(self.observations, chi2_95(2));
        }
        self.solve(max_iterations, aborted);
        let present_images = self.problem.cost_of(self.observations).robust;
        let present = *self.problem.value(self.correction);
        self.problem.set_fixed(self.correction, false);
        if search {
            self.search(aborted);
            self.problem.enable_inliers(self.observations, chi2_95(2));
        }
        self.solve(max_iterations, aborted);
        let inflation = self.inflation();
        if !self.is_given() {
            self.weigh_knowledge(inflation);
            self.solve(max_iterations, aborted);
        }
        let sigmas = self.sigmas(inflation);
        // Of the same observations as before.
        if search {
            self.problem.set_group_enabled(self.observations, true);
        }
        let found_images = self.problem.cost_of(self.observations).robust;
        let knowledge_of = |correction: &CorrectionVector| {
            let residual = self.problem.factors(self.prior)[0].residual((correction,));
            residual.map_or(f64::INFINITY, |residual| 0.5 * residual.norm_squared())
        };
        let found = knowledge_of(self.problem.value(self.correction));
        let image_gain = 2.0 * (present_images - found_images) * self.least_inflation() / inflation;
        let gain = 2.0 * (present_images + knowledge_of(&present) - found_images - found);
        // What was gained counts for as much less as errors turned out to be more correlated than was
        // thought.
        let gain = gain * self.least_inflation() / inflation;
        (!aborted()).then(|| self.into_estimate(inflation, [gain, image_gain], sigmas))
    }

    /// Whether the camera is held to a calibration that was given.
    fn is_given(&self) -> bool {
        self.config.trust == CalibrationTrust::Given && self.knowledge == self.config.knowledge()
    }

    /// What errors of keypoints count for at least. A calibration that was given is a measurement like the
    /// images, and how far they are to be believed is told by looks that agree.
    fn least_inflation(&self) -> f64 {
        if self.is_given() { self.config.given_inflation } else { self.config.least_inflation }
    }

    /// Counts what was known before as much as it deserves beside the images: as errors of keypoints are
    /// correlated, they say less than their number suggests.
    fn weigh_knowledge(&mut self, inflation: f64) {
        let inverse_sigmas = self.knowledge.sigmas.map(|sigma| inflation.sqrt() / sigma);
        let factor = CalibrationPriorFactor { mean: self.knowledge.mean, inverse_sigmas };
        self.problem.replace_factor(self.prior, 0, factor);
    }

    /// Goes through focal lengths to either side of the present one, everything else following, and on to
    /// the best of them: from afar the way there is too bent for single steps.
    fn search(&mut self, aborted: impl Fn() -> bool + Copy) {
        self.solve(self.config.max_iterations, aborted);
        let mut best = (self.cost(), self.state());
        let begin = self.state();
        let (mean, sigma) = (self.knowledge.mean[0], self.knowledge.sigmas[0]);
        for direction in [-1.0, 1.0] {
            self.restore(&begin);
            let mut log_focal = begin.correction[0].ln_1p();
            loop {
                log_focal += direction * self.config.search_step;
                if (log_focal - mean).abs() > self.config.search_reach * sigma || aborted() {
                    break;
                }
                self.hold_focal(log_focal);
                self.solve(self.config.search_iterations, aborted);
                let cost = self.cost();
                if cost < best.0 {
                    best = (cost, self.state());
                } else if cost > best.0 + self.config.hopeless_cost * self.least_inflation() {
                    break;
                }
            }
        }
        self.problem.set_group_enabled(self.trial, false);
        self.restore(&best.1);
        self.solve(2 * self.config.max_iterations, aborted);
    }

    /// Moves to a focal length and holds it there.
    fn hold_focal(&mut self, log_focal: f64) {
        let mut correction = *self.problem.value(self.correction);
        correction[0] = log_focal.exp_m1();
        self.problem.set_value(self.correction, correction);
        let mut inverse_sigmas = CorrectionVector::zeros();
        inverse_sigmas[0] = 1.0 / HELD_FOCAL_SIGMA;
        let mut mean = CorrectionVector::zeros();
        mean[0] = log_focal;
        self.problem.replace_factor(self.trial, 0, CalibrationPriorFactor { mean, inverse_sigmas });
        self.problem.set_group_enabled(self.trial, true);
    }

    /// What observations and knowledge cost at present.
    fn cost(&self) -> f64 {
        self.problem.cost_of(self.observations).robust
            + self.problem.cost_of(self.prior).robust
            + self.problem.cost_of(self.right_angles).robust
    }

    /// How many times as large the variance of the camera is, as the residuals show with those of one point
    /// taken as one error, as it would be if they were independent and as large as said: the largest of all
    /// members that the images determine.
    fn inflation(&mut self) -> f64 {
        let least = self.least_inflation();
        let by_keyframe =
            self.problem.clustered_covariance(self.correction, self.observations, &self.keyframe_of);
        let clustered = self.problem.clustered_covariance(self.correction, self.observations, &self.point_of);
        let (Some(by_keyframe), Some(clustered)) = (by_keyframe, clustered) else { return least };
        let weights = self.problem.factors(self.prior)[0].inverse_sigmas;
        let expected_by_images = |axis: usize| {
            let column = clustered.expected.column(axis);
            let by_knowledge: f64 = (0..5).map(|row| (weights[row] * column[row]).powi(2)).sum();
            clustered.expected[(axis, axis)] - by_knowledge
        };
        (0..5)
            .filter(|axis| expected_by_images(*axis) > 0.5 * clustered.expected[(*axis, *axis)])
            .map(|axis| {
                clustered.observed[(axis, axis)].max(by_keyframe.observed[(axis, axis)])
                    / expected_by_images(axis)
            })
            .fold(least, f64::max)
            .min(self.config.most_inflation.max(least))
    }

    /// Standard deviations of the correction's members.
    fn sigmas(&mut self, inflation: f64) -> CorrectionVector {
        let covariance = self.problem.marginal_covariance(self.correction);
        let of = |covariance: &DMatrix<f64>, axis| (inflation * covariance[(axis, axis)]).max(0.0).sqrt();
        match covariance {
            Some(covariance) => CorrectionVector::from_fn(|axis, _| of(&covariance, axis)),
            None => CorrectionVector::repeat(f64::INFINITY),
        }
    }

    /// Iterates, and says what cost remains.
    fn solve(&mut self, max_iterations: usize, aborted: impl Fn() -> bool) -> f64 {
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        self.problem.solve(&options, aborted).last.robust
    }

    fn state(&self) -> State {
        State {
            correction: *self.problem.value(self.correction),
            poses: self.poses.iter().map(|(_, variable)| *self.problem.value(*variable)).collect(),
            points: self.points.iter().map(|(_, variable)| *self.problem.value(*variable)).collect(),
        }
    }

    fn restore(&mut self, state: &State) {
        self.problem.set_value(self.correction, state.correction);
        for ((_, variable), value) in self.poses.iter().zip(&state.poses) {
            self.problem.set_value(*variable, *value);
        }
        for ((_, variable), value) in self.points.iter().zip(&state.points) {
            self.problem.set_value(*variable, *value);
        }
    }

    fn into_estimate(
        self,
        inflation: f64,
        [gain, image_gain]: [f64; 2],
        sigmas: CorrectionVector,
    ) -> Estimate {
        Estimate {
            correction: correction_of(self.problem.value(self.correction)),
            sigmas,
            inflation,
            gain,
            image_gain,
            poses: self.poses.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
            points: self.points.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
        }
    }
}

/// Two vanishing directions of a keyframe that seem to be perpendicular.
struct RightAngle {
    /// The primitives they belong to, if both do.
    pair: Option<[PrimitiveId; 2]>,
    /// Rays of the calibration that the features are of.
    rays: [Vector3<f64>; 2],
    /// Of the cosine between them.
    variance: f64,
}

/// What right angles of a building say of the camera: pairs of vanishing directions of a keyframe that are
/// perpendicular or nearly so. Those of the same two primitives in several keyframes are of the same edges,
/// and count for less the more there are.
fn right_angles(map: &Map, submap: SubmapId, config: &CalibrationConfig) -> Vec<OrthogonalityFactor> {
    let nominal_from_corrected = map.correction().nominal_from_corrected();
    let max_cosine = config.right_angle_gate_deg.to_radians().sin();
    let mut found: Vec<RightAngle> = Vec::new();
    for keyframe in map.keyframes_of(submap) {
        for (idx, first) in keyframe.vanishing.iter().enumerate() {
            for second in &keyframe.vanishing[idx + 1..] {
                let cosine = first.direction.dot(&second.direction);
                if cosine.abs() > max_cosine {
                    continue;
                }
                let variance = first.direction.dot(&(second.covariance * first.direction))
                    + second.direction.dot(&(first.covariance * second.direction))
                    + config.right_angle_sigma_deg.to_radians().powi(2);
                let pair = first.primitive.zip(second.primitive).map(|(a, b)| [a.min(b), a.max(b)]);
                let rays = [first.direction, second.direction].map(|ray| nominal_from_corrected * ray);
                found.push(RightAngle { pair, rays, variance });
            }
        }
    }
    let n_of = |pair: &Option<[PrimitiveId; 2]>| found.iter().filter(|other| other.pair == *pair).count();
    let factor = |angle: &RightAngle| OrthogonalityFactor {
        nominal: angle.rays,
        inverse_sigma: 1.0 / (angle.variance * (n_of(&angle.pair) as f64).sqrt()).sqrt(),
    };
    found.iter().map(factor).collect()
}

/// Settles the free scale by the keyframe that is farthest from the origin.
pub(super) fn settle_scale(problem: &mut Problem, poses: &[(KeyframeId, VariableId<Pose>)]) {
    let length_of = |variable| problem.value::<Pose>(variable).translation.norm();
    let farthest = poses
        .iter()
        .skip(1)
        .map(|(_, variable)| (length_of(*variable), *variable))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((length, variable)) = farthest.filter(|(length, _)| *length > 0.0) {
        let factor = BaselineLengthFactor { length, inverse_sigma: 1.0 / (SCALE_SIGMA * length) };
        problem.add_factors(Kernel::None, [((variable,), factor)]);
    }
}

impl Estimate {
    /// Standard deviation of the focal length, as a share of it.
    pub fn focal_sigma(&self) -> f64 {
        self.sigmas[0] / (1.0 + self.correction.focal)
    }

    /// Whether it differs from a camera by so many of its standard deviations, in any member.
    pub fn moves(&self, from: &CameraCorrection, n_sigmas: f64) -> bool {
        let change = vector_of(&self.correction) - vector_of(from);
        change.iter().zip(&self.sigmas).any(|(change, sigma)| change.abs() > n_sigmas * sigma)
    }

    /// Puts the camera, the poses and the points into a map.
    pub fn write_into(&self, map: &mut Map) {
        map.set_correction(self.correction);
        for (id, pose) in &self.poses {
            map.set_pose(*id, *pose);
        }
        for (id, position) in &self.points {
            map.set_position(*id, *position);
        }
    }
}
