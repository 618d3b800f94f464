//! Self-calibration: bundle adjustment of a submap with the intrinsics (focal length and principal point)
//! free. [method: Self-calibration]

use super::factors::{CalibratedReprojectionFactor, CalibrationPriorFactor, correction_of, vector_of};
use crate::config::CalibrationConfig;
use crate::map::{KeyframeId, Map, PointId, SubmapId};
use geometry::nalgebra::Vector3;
use geometry::{PinholeCorrection, Pose};
use optim::{GroupId, Kernel, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::BTreeMap;

/// The camera by which a submap's points are explained best, with the poses and points that belong to it.
#[derive(Clone, Debug)]
pub(crate) struct Estimate {
    /// How it differs from the calibration.
    pub correction: PinholeCorrection,
    /// Decrease of χ² against the present camera.
    pub gain: f64,
    /// What χ² it costs that the calibration is held to be right within its tolerance.
    pub conflict: f64,
    /// How the camera would differ if nothing were known of it.
    pub unheld: PinholeCorrection,
    poses: Vec<(KeyframeId, Pose)>,
    points: Vec<(PointId, Vector3<f64>)>,
}

/// What makes a camera doubtful.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IntrinsicsDoubt {
    /// How it seems to differ from the calibration.
    correction: PinholeCorrection,
    /// How it would differ if nothing were known of it, where that is by more than a calibration can be wrong
    /// by.
    contradiction: Option<PinholeCorrection>,
}

/// What the images say of the camera.
#[derive(Clone, Debug)]
pub(crate) enum IntrinsicsFinding {
    /// Nothing against the present one.
    Confirmed,
    /// It may be another; the next look at it will tell.
    Doubtful(IntrinsicsDoubt),
    /// It is another, to within the tolerance of the calibration.
    Refined(Estimate),
    /// It would have to be another beyond that, so that something else must be wrong with the calibration.
    Contradicted(PinholeCorrection),
}

struct Calibration {
    problem: Problem,
    poses: Vec<(KeyframeId, VariableId<Pose>)>,
    correction: VariableId<Vector3<f64>>,
    points: Vec<(PointId, VariableId<Vector3<f64>>)>,
    observations: GroupId<CalibratedReprojectionFactor>,
    prior: GroupId<CalibrationPriorFactor>,
}

/// Looks at the camera of a submap. `before` is what made the last look doubtful. `None` if `aborted` said
/// so.
///
/// Errors of keypoints that are not independent feign small errors of the camera, with a χ² that looks
/// significant. They differ from one look to the next, while the camera stays the same: hence two looks have
/// to agree, unless one is beyond doubt.
pub(crate) fn refine_intrinsics(
    map: &Map,
    submap: SubmapId,
    before: Option<IntrinsicsDoubt>,
    config: &CalibrationConfig,
    aborted: impl Fn() -> bool + Copy,
) -> Option<IntrinsicsFinding> {
    let estimate = estimate(map, submap, config, aborted)?;
    let Estimate { correction, gain, conflict, unheld, .. } = &estimate;
    tracing::debug!(%submap, ?correction, gain, conflict, ?unheld, "camera that explains the submap best");
    let doubt = IntrinsicsDoubt {
        correction: *correction,
        contradiction: (*conflict > chi2_95(3)).then_some(*unheld),
    };
    Some(if *gain < config.min_gain {
        IntrinsicsFinding::Confirmed
    } else if before.is_some_and(|before| doubt.is_contradicted_as(&before, config)) {
        IntrinsicsFinding::Contradicted(*unheld)
    } else if doubt.contradiction.is_none()
        && (*gain >= config.certain_gain
            || before.is_some_and(|before| agree(&before.correction, correction, config)))
    {
        IntrinsicsFinding::Refined(estimate)
    } else {
        IntrinsicsFinding::Doubtful(doubt)
    })
}

impl IntrinsicsDoubt {
    /// Whether both looks contradict the calibration, and in the same way.
    fn is_contradicted_as(&self, before: &Self, config: &CalibrationConfig) -> bool {
        let both = before.contradiction.zip(self.contradiction);
        both.is_some_and(|(before, now)| agree(&before, &now, config))
    }
}

/// Whether two looks found the same.
fn agree(before: &PinholeCorrection, now: &PinholeCorrection, config: &CalibrationConfig) -> bool {
    let (before, now) = (vector_of(before), vector_of(now));
    (now - before).norm() <= config.max_disagreement * now.norm()
}

/// Finds the camera that explains the points of a submap best.
fn estimate(
    map: &Map,
    submap: SubmapId,
    config: &CalibrationConfig,
    aborted: impl Fn() -> bool + Copy,
) -> Option<Estimate> {
    let mut calibration = Calibration::of(map, submap, config);
    // First all that the present camera can do, so that the difference is the camera's.
    calibration.problem.set_fixed(calibration.correction, true);
    calibration.solve(config.max_iterations, aborted);
    calibration.problem.enable_inliers(calibration.observations, chi2_95(2));
    let present = calibration.solve(config.max_iterations, aborted);
    calibration.problem.set_fixed(calibration.correction, false);
    let held = calibration.solve(config.max_iterations, aborted);
    let estimate = calibration.result();
    calibration.problem.set_group_enabled(calibration.prior, false);
    let unheld = calibration.solve(config.max_iterations, aborted);
    (!aborted()).then(|| Estimate {
        gain: 2.0 * (present - held),
        conflict: 2.0 * (held - unheld),
        unheld: correction_of(calibration.problem.value(calibration.correction)),
        ..estimate
    })
}

impl Calibration {
    fn of(map: &Map, submap: SubmapId, config: &CalibrationConfig) -> Self {
        let mut problem = Problem::new();
        let mut poses = BTreeMap::new();
        for keyframe in map.keyframes_of(submap) {
            let variable = problem.add_variable(keyframe.camera_from_world);
            // The oldest keyframe settles position and attitude, and damping the scale.
            problem.set_fixed(variable, poses.is_empty());
            poses.insert(keyframe.id, variable);
        }
        let correction = problem.add_variable(vector_of(&map.correction()));
        let (mut points, mut factors) = (Vec::new(), Vec::new());
        for point in map.points().filter(|point| point.submap == submap) {
            let variable = problem.add_landmark(point.position);
            points.push((point.id, variable));
            for seen in &point.observations {
                let (Some(pose), Some(keyframe)) = (poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
                else {
                    continue;
                };
                let feature_idx = seen.feature_idx as usize;
                let factor = CalibratedReprojectionFactor {
                    nominal: keyframe.features.nominal_pinhole,
                    observed_px: keyframe.features.undistorted[feature_idx],
                    inverse_sigma: 1.0 / keyframe.features.sigma_px(feature_idx),
                };
                factors.push(((*pose, correction, variable), factor));
            }
        }
        let observations = problem.add_factors(Kernel::huber_95(2), factors);
        let (focal, center) = (1.0 / config.focal_sigma, 1.0 / config.center_sigma);
        let prior = CalibrationPriorFactor { inverse_sigmas: Vector3::new(focal, center, center) };
        let prior = problem.add_factors(Kernel::None, [((correction,), prior)]);
        Self { problem, poses: poses.into_iter().collect(), correction, points, observations, prior }
    }

    /// Iterates, and says what cost remains.
    fn solve(&mut self, max_iterations: usize, aborted: impl Fn() -> bool) -> f64 {
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        self.problem.solve(&options, aborted).last.robust
    }

    fn result(&self) -> Estimate {
        Estimate {
            correction: correction_of(self.problem.value(self.correction)),
            gain: 0.0,
            conflict: 0.0,
            unheld: PinholeCorrection::default(),
            poses: self.poses.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
            points: self.points.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
        }
    }
}

impl Estimate {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A look that wants another focal length, by so much.
    fn doubt(focal: f64) -> IntrinsicsDoubt {
        let correction = PinholeCorrection { focal, ..PinholeCorrection::default() };
        IntrinsicsDoubt { correction, contradiction: Some(correction) }
    }

    #[test]
    fn two_contradictions_that_disagree_are_none() {
        let config = CalibrationConfig::default();
        assert!(doubt(-0.06).is_contradicted_as(&doubt(-0.055), &config));
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(-0.02), &config), "these are errors of keypoints");
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(0.06), &config));
        let tolerable = IntrinsicsDoubt { contradiction: None, ..doubt(-0.06) };
        assert!(!doubt(-0.06).is_contradicted_as(&tolerable, &config));
    }
}
