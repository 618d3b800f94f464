//! The figures of one comparison.

use geometry::nalgebra::Vector3;
use geometry::{Pose, Similarity, so3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::segments::{SegmentErrors, segment_errors};
use super::{Alignment, Match, associate};
use crate::Trajectory;

/// Fewest matched poses from which a similarity can be found.
const MIN_MATCHES: usize = 3;

/// How to compare two trajectories.
#[derive(Clone, Copy, Debug)]
pub struct EvaluationOptions {
    /// What is taken out before the comparison. Default: a similarity.
    pub alignment: Alignment,
    /// Poses further apart in time than this are not of the same image, nanoseconds. Default 0.01 s, as in
    /// `evo`: a third of the interval between frames at 30 Hz.
    pub max_dt_ns: i64,
    /// Images in the recording, to measure coverage against; without it, the number of true poses.
    pub n_frames: Option<usize>,
}

impl Default for EvaluationOptions {
    fn default() -> Self {
        Self { alignment: Alignment::Sim3, max_dt_ns: 10_000_000, n_frames: None }
    }
}

/// The figures of one comparison. Lengths are in the units of the true trajectory.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Evaluation {
    /// What was taken out before the comparison.
    pub alignment: Alignment,
    /// Images in the recording, or true poses where that is not known.
    pub frames: usize,
    /// Estimated poses.
    pub poses: usize,
    /// Estimated poses with a true pose at the same time.
    pub matched: usize,
    /// `matched / poses`: the other figures speak of these alone.
    #[serde(default)]
    pub matched_share: f64,
    /// `poses / frames`: a short trajectory flatters the other figures.
    pub coverage: f64,
    /// Root mean square distance of the positions after alignment: the absolute trajectory error.
    pub ate_rmse: f64,
    /// Mean distance.
    pub ate_mean: f64,
    /// Median distance.
    pub ate_median: f64,
    /// Greatest distance.
    pub ate_max: f64,
    /// Root mean square angle between the orientations after alignment.
    pub rot_rmse_deg: f64,
    /// Root mean square translation error of the motion between consecutive matched poses.
    pub rpe_trans_rmse: f64,
    /// Root mean square rotation error of the motion between consecutive matched poses.
    pub rpe_rot_rmse_deg: f64,
    /// Scale of the alignment: true units per unit of the estimate.
    pub scale: f64,
    /// Local scale of the second half of the matched poses over that of the first; one without drift.
    ///
    /// The local scale of a half is `√(Σ|g - ḡ|² / Σ|e - ē|²)` over its true positions `g` and estimated
    /// positions `e`, which needs no rotation and treats both alike [Horn 1987, section 2.E]. Absent if a
    /// half does not move.
    pub scale_drift: Option<f64>,
    /// Length of the true path through the matched poses.
    pub path: f64,
    /// `ate_rmse` in percent of `path`; absent when there is no path.
    pub ate_percent_of_path: Option<f64>,
    /// Errors of segments of 100 to 800 m, as the KITTI benchmark has them; absent if the path is shorter.
    #[serde(default)]
    pub segments: Option<SegmentErrors>,
}

/// Why two trajectories cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EvaluationError {
    /// The times hardly overlap.
    #[error(
        "{n_matched} of {n_estimated} estimated poses have one of {n_true} true poses within {max_dt_ms} ms; \
         {MIN_MATCHES} are needed"
    )]
    TooFewMatches {
        /// Pairs found.
        n_matched: usize,
        /// Poses of the estimate.
        n_estimated: usize,
        /// True poses.
        n_true: usize,
        /// The limit, milliseconds.
        max_dt_ms: i64,
    },
    /// The positions do not determine the alignment.
    #[error("the {n_matched} matched positions lie on one line or in one point, so no rotation aligns them")]
    Degenerate {
        /// Pairs found.
        n_matched: usize,
    },
}

/// Compares an estimated trajectory with the true one.
///
/// # Errors
/// An [`EvaluationError`] if there are too few common times or the motion does not determine the alignment.
pub fn evaluate(
    truth: &Trajectory,
    estimate: &Trajectory,
    options: &EvaluationOptions,
) -> Result<Evaluation, EvaluationError> {
    let matches = associate(truth, estimate, options.max_dt_ns);
    if matches.len() < MIN_MATCHES {
        return Err(EvaluationError::TooFewMatches {
            n_matched: matches.len(),
            n_estimated: estimate.len(),
            n_true: truth.len(),
            max_dt_ms: options.max_dt_ns / 1_000_000,
        });
    }
    let pairs = PosePairs::new(truth, estimate, &matches);
    let (true_positions, estimated_positions) = (positions(&pairs.truth), positions(&pairs.estimate));
    let truth_from_estimate = options
        .alignment
        .truth_from_estimate(&true_positions, &estimated_positions)
        .ok_or(EvaluationError::Degenerate { n_matched: matches.len() })?;

    let mut distances: Vec<f64> = true_positions
        .iter()
        .zip(&estimated_positions)
        .map(|(g, e)| (g - truth_from_estimate * *e).norm())
        .collect();
    let ate_rmse = root_mean_square(distances.iter().copied());
    distances.sort_unstable_by(f64::total_cmp);
    let (rpe_trans_rmse, rpe_rot_rmse_deg) = pairs.relative_errors(truth_from_estimate.scale);
    let path: f64 = true_positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let frames = options.n_frames.unwrap_or(truth.len());
    Ok(Evaluation {
        alignment: options.alignment,
        frames,
        poses: estimate.len(),
        matched: matches.len(),
        matched_share: matches.len() as f64 / estimate.len().max(1) as f64,
        coverage: estimate.len() as f64 / frames.max(1) as f64,
        ate_rmse,
        ate_mean: distances.iter().sum::<f64>() / distances.len() as f64,
        ate_median: median_of_sorted(&distances),
        ate_max: distances[distances.len() - 1],
        rot_rmse_deg: pairs.rotation_error_deg(&truth_from_estimate),
        rpe_trans_rmse,
        rpe_rot_rmse_deg,
        scale: truth_from_estimate.scale,
        scale_drift: scale_drift(&true_positions, &estimated_positions),
        path,
        ate_percent_of_path: (path > 0.0).then(|| 100.0 * ate_rmse / path),
        segments: segment_errors(&pairs.truth, &pairs.estimate, truth_from_estimate.scale),
    })
}

/// The matched poses, as `world_from_camera`.
struct PosePairs {
    truth: Vec<Pose>,
    estimate: Vec<Pose>,
}

impl PosePairs {
    fn new(truth: &Trajectory, estimate: &Trajectory, matches: &[Match]) -> Self {
        Self {
            truth: matches.iter().map(|m| truth.poses()[m.truth_idx].world_from_camera).collect(),
            estimate: matches.iter().map(|m| estimate.poses()[m.estimate_idx].world_from_camera).collect(),
        }
    }

    fn rotation_error_deg(&self, truth_from_estimate: &Similarity) -> f64 {
        let errors = self.truth.iter().zip(&self.estimate).map(|(g, e)| {
            so3::angle_between(&g.rotation, &(truth_from_estimate.rotation * e.rotation)).to_degrees()
        });
        root_mean_square(errors)
    }

    /// Translation and rotation error of `(Gᵢ⁻¹ Gⱼ)⁻¹ (Eᵢ⁻¹ Eⱼ)` over consecutive pairs [Sturm et al. 2012,
    /// eq. 1], the estimate brought to the true scale.
    fn relative_errors(&self, scale: f64) -> (f64, f64) {
        let motion = |pair: &[Pose], scale: f64| {
            let motion = pair[0].inverse() * pair[1];
            Pose::new(motion.rotation, scale * motion.translation)
        };
        let errors: Vec<Pose> = self
            .truth
            .windows(2)
            .zip(self.estimate.windows(2))
            .map(|(g, e)| motion(g, 1.0).inverse() * motion(e, scale))
            .collect();
        (
            root_mean_square(errors.iter().map(|e| e.translation.norm())),
            root_mean_square(errors.iter().map(|e| so3::log(&e.rotation).norm().to_degrees())),
        )
    }
}

fn positions(poses: &[Pose]) -> Vec<Vector3<f64>> {
    poses.iter().map(|pose| pose.translation).collect()
}

/// See [`Evaluation::scale_drift`].
fn scale_drift(truth: &[Vector3<f64>], estimate: &[Vector3<f64>]) -> Option<f64> {
    let middle = truth.len() / 2;
    let local_scale =
        |range: std::ops::Range<usize>| spread(&truth[range.clone()]) / spread(&estimate[range]);
    let ratio = (local_scale(middle..truth.len()) / local_scale(0..middle)).sqrt();
    (ratio.is_finite() && ratio > 0.0).then_some(ratio)
}

/// Sum of the squared distances from the mean.
fn spread(points: &[Vector3<f64>]) -> f64 {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    points.iter().map(|point| (point - mean).norm_squared()).sum()
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0usize), |(sum, n), x| (sum + x * x, n + 1));
    (sum / n.max(1) as f64).sqrt()
}

fn median_of_sorted(values: &[f64]) -> f64 {
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { (values[middle - 1] + values[middle]) / 2.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StampedPose;
    use geometry::nalgebra::SVector;

    /// A bent path through space with turning orientation, a hundred frames at 10 Hz.
    fn helix() -> Trajectory {
        let pose = |i: i32| {
            let t = 0.1 * f64::from(i);
            let rotation = so3::exp(&Vector3::new(0.1 * t, 0.3 * t, 0.2 * t.sin()));
            let world_from_camera = Pose::new(rotation, Vector3::new(t.cos(), t.sin(), 0.3 * t));
            StampedPose { timestamp_ns: i64::from(i) * 100_000_000, world_from_camera }
        };
        Trajectory::new((0..100).map(pose).collect())
    }

    fn map(trajectory: &Trajectory, change: impl Fn(usize, Pose) -> Pose) -> Trajectory {
        let poses = trajectory.poses().iter().enumerate();
        let changed =
            poses.map(|(i, p)| StampedPose { world_from_camera: change(i, p.world_from_camera), ..*p });
        Trajectory::new(changed.collect())
    }

    fn moved(trajectory: &Trajectory, target_from_source: &Similarity) -> Trajectory {
        map(trajectory, |_, pose| {
            Pose::new(target_from_source.rotation * pose.rotation, *target_from_source * pose.translation)
        })
    }

    #[test]
    fn a_similar_trajectory_has_no_error_and_its_scale_is_found() {
        let truth = helix();
        let similarity = Similarity::exp(&SVector::from([0.3, -0.5, 0.9, 4.0, 5.0, -6.0, 0.7]));
        let estimate = moved(&truth, &similarity);
        let evaluation = evaluate(&truth, &estimate, &EvaluationOptions::default()).unwrap();
        assert!(evaluation.ate_max < 1e-12 && evaluation.rot_rmse_deg < 1e-6);
        assert!(evaluation.rpe_trans_rmse < 1e-12 && evaluation.rpe_rot_rmse_deg < 1e-6);
        assert!((evaluation.scale - (-0.7f64).exp()).abs() < 1e-12);
        assert!((evaluation.scale_drift.unwrap() - 1.0).abs() < 1e-12);
        assert_eq!((evaluation.matched, evaluation.coverage), (100, 1.0));
    }

    #[test]
    fn each_alignment_takes_out_only_what_it_says() {
        let truth = helix();
        let doubled =
            moved(&truth, &Similarity::exp(&SVector::from([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2f64.ln()])));
        let shifted = map(&truth, |_, p| Pose::new(p.rotation, p.translation + Vector3::new(3.0, 0.0, 4.0)));
        let rmse = |estimate: &Trajectory, alignment| {
            evaluate(&truth, estimate, &EvaluationOptions { alignment, ..Default::default() })
                .unwrap()
                .ate_rmse
        };
        assert!(rmse(&shifted, Alignment::Se3) < 1e-12);
        assert!((rmse(&shifted, Alignment::None) - 5.0).abs() < 1e-12);
        assert!(rmse(&doubled, Alignment::Sim3) < 1e-12);
        // Twice the size: after rigid alignment each point is off by its distance from the mean.
        let positions = positions(&truth.poses().iter().map(|p| p.world_from_camera).collect::<Vec<_>>());
        let expected = (spread(&positions) / positions.len() as f64).sqrt();
        assert!((rmse(&doubled, Alignment::Se3) - expected).abs() < 1e-12);
    }

    #[test]
    fn a_known_offset_gives_a_known_rotation_error_and_relative_error() {
        let truth = helix();
        // Every camera looks 2 degrees aside of where it should: no position changes.
        let aside = so3::exp(&Vector3::new(0.0, 2f64.to_radians(), 0.0));
        let turned = map(&truth, |_, p| Pose::new(p.rotation * aside, p.translation));
        let evaluation = evaluate(&truth, &turned, &EvaluationOptions::default()).unwrap();
        assert!(evaluation.ate_rmse < 1e-12);
        assert!((evaluation.rot_rmse_deg - 2.0).abs() < 1e-9);
        // Every second camera is 1 cm off to the side of the others: every step is 1 cm wrong.
        let options = EvaluationOptions { alignment: Alignment::None, ..Default::default() };
        let zigzag = map(&truth, |i, p| {
            Pose::new(p.rotation, p.translation + Vector3::new(0.01 * (i % 2) as f64, 0.0, 0.0))
        });
        let evaluation = evaluate(&truth, &zigzag, &options).unwrap();
        assert!((evaluation.rpe_trans_rmse - 0.01).abs() < 1e-12);
    }

    #[test]
    fn scale_drift_is_the_ratio_of_the_halves() {
        let truth = helix();
        let shrinking = map(&truth, |i, p| {
            Pose::new(p.rotation, if i < 50 { p.translation } else { 0.8 * p.translation })
        });
        let evaluation = evaluate(&truth, &shrinking, &EvaluationOptions::default()).unwrap();
        assert!((evaluation.scale_drift.unwrap() - 1.25).abs() < 1e-9);
    }

    #[test]
    fn coverage_counts_frames_without_a_pose() {
        let truth = helix();
        let half = Trajectory::new(truth.poses()[..50].to_vec());
        let options = EvaluationOptions { n_frames: Some(200), ..Default::default() };
        let evaluation = evaluate(&truth, &half, &options).unwrap();
        assert_eq!((evaluation.poses, evaluation.frames, evaluation.coverage), (50, 200, 0.25));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let truth = helix();
        let late = Trajectory::new(
            truth
                .poses()
                .iter()
                .map(|p| StampedPose { timestamp_ns: p.timestamp_ns + 50_000_000, ..*p })
                .collect(),
        );
        let options = EvaluationOptions::default();
        assert!(matches!(
            evaluate(&truth, &late, &options),
            Err(EvaluationError::TooFewMatches { n_matched: 0, n_estimated: 100, .. })
        ));
        let straight = map(&truth, |i, p| Pose::new(p.rotation, Vector3::new(i as f64, 0.0, 0.0)));
        assert_eq!(
            evaluate(&straight, &truth, &options).unwrap_err(),
            EvaluationError::Degenerate { n_matched: 100 }
        );
    }
}
