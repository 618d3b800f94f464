//! The pose of one frame from the landmarks it sees, with wrong matches put aside.

use super::frame::TrackedFrame;
use crate::bundle::factors::PointReprojectionFactor;
use crate::map::Map;
use geometry::Pose;
use geometry::nalgebra::{Matrix6, Vector3, Vector6};
use optim::{Factor, Kernel, chi2_95};

/// Rounds of optimisation; after each the matches are judged anew.
const N_ROUNDS: usize = 4;
/// Rounds in which the robust kernel is on; the last is plain least squares on the inliers.
const N_ROBUST_ROUNDS: usize = 3;
/// Steps per round at most.
const MAX_STEPS: usize = 10;
/// A step shorter than this ends a round, radians and map units.
const MIN_STEP: f64 = 1e-7;
/// Fewest inliers that fix six degrees of freedom with something to spare.
const MIN_INLIERS: usize = 4;

/// One keypoint and the fixed point it sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PointSighting {
    pub factor: PointReprojectionFactor,
    pub position: Vector3<f64>,
}

/// The pose that agrees best with the sightings, and which of them agree with it.
#[derive(Clone, Debug)]
pub(crate) struct PoseFit {
    pub camera_from_world: Pose,
    pub inliers: Vec<bool>,
    pub n_inliers: usize,
    /// Information matrix of the pose, tangent order rotation, translation.
    pub information: Matrix6<f64>,
}

/// Finds the pose by iteratively reweighted Gauss-Newton. [ALGORITHMS 7.3]
pub(crate) fn fit_pose(initial: Pose, sightings: &[PointSighting]) -> PoseFit {
    let threshold = chi2_95(2);
    let kernel = Kernel::huber_95(2);
    let mut fit = PoseFit {
        camera_from_world: initial,
        inliers: vec![true; sightings.len()],
        n_inliers: sightings.len(),
        information: Matrix6::zeros(),
    };
    for round in 0..N_ROUNDS {
        let kernel = if round < N_ROBUST_ROUNDS { kernel } else { Kernel::None };
        descend(&mut fit, sightings, kernel);
        fit.n_inliers = 0;
        for (inlier, sighting) in fit.inliers.iter_mut().zip(sightings) {
            let residual = sighting.factor.residual((&fit.camera_from_world, &sighting.position));
            *inlier = residual.is_some_and(|residual| residual.norm_squared() <= threshold);
            fit.n_inliers += usize::from(*inlier);
        }
        if fit.n_inliers < MIN_INLIERS {
            break;
        }
    }
    fit
}

fn descend(fit: &mut PoseFit, sightings: &[PointSighting], kernel: Kernel) {
    let mut last_cost = f64::INFINITY;
    let mut last_pose = fit.camera_from_world;
    for _ in 0..MAX_STEPS {
        let (cost, information, gradient) = normal_equations(fit, sightings, kernel);
        if cost > last_cost {
            fit.camera_from_world = last_pose;
            return;
        }
        fit.information = information;
        let Some(factorised) = information.cholesky() else { return };
        let step: Vector6<f64> = factorised.solve(&-gradient);
        if !step.iter().all(|value| value.is_finite()) {
            return;
        }
        (last_cost, last_pose) = (cost, fit.camera_from_world);
        fit.camera_from_world = fit.camera_from_world.retract(&step);
        if step.norm() < MIN_STEP {
            return;
        }
    }
}

/// Cost, Hessian and gradient over the inliers.
fn normal_equations(fit: &PoseFit, sightings: &[PointSighting], kernel: Kernel) -> (f64, Matrix6<f64>, Vector6<f64>) {
    let (mut cost, mut information, mut gradient) = (0.0, Matrix6::zeros(), Vector6::zeros());
    for (sighting, _) in sightings.iter().zip(&fit.inliers).filter(|(_, inlier)| **inlier) {
        let linearized = sighting.factor.linearize((&fit.camera_from_world, &sighting.position));
        let Some((residual, (d_residual_d_pose, _))) = linearized else { continue };
        let chi2 = residual.norm_squared();
        let weight = kernel.weight(chi2);
        cost += kernel.loss(chi2);
        let weighted = d_residual_d_pose.transpose() * weight;
        information += weighted * d_residual_d_pose;
        gradient += weighted * residual;
    }
    (cost, information, gradient)
}

/// Places a frame by the landmarks it was matched to and drops the matches that disagree.
pub(crate) fn place_frame(frame: &mut TrackedFrame, map: &Map) -> PoseFit {
    let mut sightings = Vec::with_capacity(frame.n_points());
    let mut feature_indices = Vec::with_capacity(sightings.capacity());
    for (feature_idx, slot) in frame.points.iter_mut().enumerate() {
        let Some(id) = *slot else { continue };
        let Some(point) = map.point(id) else {
            *slot = None;
            continue;
        };
        let factor = PointReprojectionFactor {
            pinhole: frame.features.pinhole,
            observed_px: frame.features.undistorted[feature_idx],
            inverse_sigma: 1.0 / frame.features.sigma_px(feature_idx),
        };
        sightings.push(PointSighting { factor, position: point.position });
        feature_indices.push(feature_idx);
    }
    let fit = fit_pose(frame.camera_from_world, &sightings);
    frame.camera_from_world = fit.camera_from_world;
    for (feature_idx, _) in feature_indices.iter().zip(&fit.inliers).filter(|(_, inlier)| !**inlier) {
        frame.points[*feature_idx] = None;
    }
    fit
}
