//! Two-view relative pose by essential matrix and homography, whether the scene is planar or not.

use super::correspondence::Correspondence;
use super::motion::{self, RelativeMotion};
use crate::bundle::factors::PointReprojectionFactor;
use crate::config::InitializationConfig;
use crate::features::FrameFeatures;
use crate::report::InitializationWait;
use geometry::nalgebra::{Matrix3, Vector3};
use geometry::ransac::{Estimator, RansacConfig, ransac};
use geometry::{Pose, so3, triangulation, two_view};
use optim::chi2_95;
use rand_chacha::ChaCha8Rng;

/// A triangulated point must reproject within this, squared standard deviations: two pixels at the finest
/// level.
const MAX_REPROJECTION_CHI2: f64 = 4.0;
/// The parallax that counts is that of the point of this rank.
const PARALLAX_RANK: usize = 50;
/// Rays closer to parallel than this tell nothing of the sign of the depth, as a cosine.
const PARALLEL_COSINE: f64 = 0.999_98;

/// A match without a depth agrees if it is within this of where the rotation alone puts it, squared standard
/// deviations: four of them, for the noise of both views and the little parallax it may have.
const FAR_CHI2: f64 = 16.0;

/// A motion with the points it gives.
#[derive(Clone, Debug)]
pub(super) struct TwoViewMotion {
    pub second_from_first: Pose,
    /// Index of the match, position in the first camera's frame (unit baseline).
    pub points: Vec<(usize, Vector3<f64>)>,
    /// Matches that agree: the points, and what is too far away to have a depth over this baseline.
    pub n_agreeing: usize,
    pub parallax_deg: f64,
}

/// Finds the motion, or says why there is none.
///
/// Both models give starts of a search for the minima of the cost over all matches, and the least minimum
/// wins. A planar scene has two motions that explain it nearly equally well over a short baseline: then the
/// pair is ambiguous.
pub(super) fn solve(
    first: &FrameFeatures,
    second: &FrameFeatures,
    matches: &[(usize, usize)],
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> Result<TwoViewMotion, InitializationWait> {
    let correspondences: Vec<Correspondence> =
        matches.iter().map(|(a, b)| Correspondence::new(first, *a, second, *b)).collect();
    let n_matches = correspondences.len();
    let candidates = promising(candidate_motions(&correspondences, config, rng), &correspondences);
    let starts: Vec<RelativeMotion> = candidates.iter().map(RelativeMotion::of).collect();
    let mut refined: Vec<(f64, TwoViewMotion)> = distinct_minima(&starts, &correspondences)
        .into_iter()
        .map(|(cost, motion)| (cost, judge_both_ways(motion, &correspondences)))
        .collect();
    refined.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut refined = refined.into_iter();
    let nothing = InitializationWait::Ambiguous { n_agreeing: 0, n_runner_up: 0, n_matches };
    let (best_cost, best) = refined.next().ok_or(nothing)?;
    let n_agreeing = best.n_agreeing;
    // Nearly equal motions are the same motion found twice.
    let runner_up = refined.find(|(_, other)| differs(&best.second_from_first, &other.second_from_first));
    let min_cost =
        f64::max(config.min_runner_up_cost_ratio * best_cost, best_cost + config.min_runner_up_lead);
    let is_rivalled = runner_up.as_ref().is_some_and(|(cost, _)| *cost < min_cost);
    let n_runner_up = runner_up.map_or(0, |(_, other)| other.n_agreeing);
    // Without parallax every motion of the same rotation explains the matches, so that is the reason to give.
    if best.parallax_deg < config.min_parallax_deg {
        let (parallax_deg, required_deg) = (best.parallax_deg, config.min_parallax_deg);
        return Err(InitializationWait::TooLittleParallax { parallax_deg, required_deg });
    }
    let too_few = best.points.len() < config.min_points
        || (n_agreeing as f64) < config.min_inlier_share * n_matches as f64;
    if is_rivalled || too_few {
        return Err(InitializationWait::Ambiguous { n_agreeing, n_runner_up, n_matches });
    }
    Ok(best)
}

/// Candidates that explain at least this share of the matches that the best one explains are starts of the
/// search.
const PROMISING_SHARE: f64 = 0.5;
/// Starts of the search at most.
const MAX_PROMISING: usize = 4;
/// Minima looked at at most, best first.
const MAX_MINIMA: usize = 3;
/// Two motions are different hypotheses when they turn or head differently by more than this, radians.
const DISTINCT_ANGLE: f64 = 0.1;

/// The distinct candidates that many matches agree with, best first.
fn promising(motions: Vec<Pose>, correspondences: &[Correspondence]) -> Vec<Pose> {
    let mut judged: Vec<TwoViewMotion> =
        motions.iter().map(|motion| judge(motion, correspondences)).collect();
    judged.sort_by_key(|motion| std::cmp::Reverse(motion.n_agreeing));
    let min_agreeing = judged.first().map_or(0.0, |best| PROMISING_SHARE * best.n_agreeing as f64);
    let mut chosen: Vec<Pose> = Vec::new();
    for motion in judged.into_iter().filter(|motion| motion.n_agreeing as f64 >= min_agreeing) {
        let is_new = chosen.iter().all(|other| differs(&motion.second_from_first, other));
        if is_new && chosen.len() < MAX_PROMISING {
            chosen.push(motion.second_from_first);
        }
    }
    chosen
}

/// The best minima with their costs over all matches, best first.
fn distinct_minima(
    starts: &[RelativeMotion],
    correspondences: &[Correspondence],
) -> Vec<(f64, RelativeMotion)> {
    let cost = |motion: &RelativeMotion| -> f64 {
        let pose = motion.to_pose(1.0);
        let essential = so3::skew(&pose.translation) * pose.rotation_matrix();
        correspondences.iter().map(|c| c.squared_sampson(&essential).min(MAX_REPROJECTION_CHI2)).sum()
    };
    let mut found: Vec<(f64, RelativeMotion)> =
        motion::minima(starts, correspondences).into_iter().map(|motion| (cost(&motion), motion)).collect();
    found.retain(|(cost, motion)| cost.is_finite() && motion.to_pose(1.0).is_finite());
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut distinct: Vec<(f64, RelativeMotion)> = Vec::new();
    for (cost, motion) in found {
        let same = |other: &RelativeMotion| {
            [1.0, -1.0].iter().any(|sign| !differs(&motion.to_pose(*sign), &other.to_pose(1.0)))
        };
        if distinct.len() < MAX_MINIMA && !distinct.iter().any(|(_, other)| same(other)) {
            distinct.push((cost, motion));
        }
    }
    distinct
}

/// The epipolar constraint does not tell forwards from backwards; that the points lie in front does.
fn judge_both_ways(motion: RelativeMotion, correspondences: &[Correspondence]) -> TwoViewMotion {
    let forwards = judge(&motion.to_pose(1.0), correspondences);
    let backwards = judge(&motion.to_pose(-1.0), correspondences);
    if backwards.points.len() > forwards.points.len() { backwards } else { forwards }
}

fn differs(a: &Pose, b: &Pose) -> bool {
    so3::angle_between(&a.rotation, &b.rotation) > DISTINCT_ANGLE
        || a.translation.angle(&b.translation) > DISTINCT_ANGLE
}

/// The factors of a match in the two views.
pub(super) fn factors(
    first: &FrameFeatures,
    second: &FrameFeatures,
    (first_idx, second_idx): (usize, usize),
) -> [PointReprojectionFactor; 2] {
    [(first, first_idx), (second, second_idx)].map(|(features, feature_idx)| PointReprojectionFactor {
        pinhole: features.pinhole,
        observed_px: features.undistorted[feature_idx],
        inverse_sigma: 1.0 / features.sigma_px(feature_idx),
    })
}

/// Motions that either model allows: which of them the scene wants shows in their costs.
fn candidate_motions(
    correspondences: &[Correspondence],
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> Vec<Pose> {
    let search = |max_squared_residual| RansacConfig {
        max_squared_residual,
        max_iterations: config.max_iterations,
        ..RansacConfig::default()
    };
    let general = ransac(&EssentialEstimator { correspondences }, &search(chi2_95(1)), rng);
    let planar = ransac(&HomographyEstimator { correspondences }, &search(chi2_95(2)), rng);
    let mut motions = Vec::new();
    if let Some(found) = general {
        motions.extend(two_view::decompose_essential(&found.model).into_iter().flatten().map(unit_baseline));
    }
    if let Some(found) = planar {
        motions.extend(
            two_view::decompose_homography(&found.model.h).into_iter().map(|(pose, _)| unit_baseline(pose)),
        );
    }
    motions.retain(Pose::is_finite);
    motions
}

fn unit_baseline(pose: Pose) -> Pose {
    Pose::new(pose.rotation, pose.translation.normalize())
}

/// Triangulates every match under a motion and keeps the points that make sense. A match whose rays are
/// parallel to within its noise is of something far away: it agrees and gives no point.
fn judge(second_from_first: &Pose, correspondences: &[Correspondence]) -> TwoViewMotion {
    let mut points = Vec::new();
    let mut parallaxes = Vec::new();
    let mut n_far = 0;
    let second_center = second_from_first.center();
    for (match_idx, c) in correspondences.iter().enumerate() {
        match triangulate(second_from_first, c) {
            Some(point) => {
                parallaxes.push(triangulation::parallax(&Vector3::zeros(), &second_center, &point));
                points.push((match_idx, point));
            }
            None => n_far += usize::from(is_far(second_from_first, c)),
        }
    }
    parallaxes.sort_by(|a, b| b.total_cmp(a));
    let rank = PARALLAX_RANK.min(parallaxes.len()).saturating_sub(1);
    let parallax_deg = parallaxes.get(rank).map_or(0.0, |parallax| parallax.to_degrees());
    let n_agreeing = points.len() + n_far;
    TwoViewMotion { second_from_first: *second_from_first, points, n_agreeing, parallax_deg }
}

/// The point of a match, if it has a depth and both views agree with it.
fn triangulate(second_from_first: &Pose, c: &Correspondence) -> Option<Vector3<f64>> {
    let ray = second_from_first.rotation.inverse() * c.second_bearing;
    let identity = Pose::identity();
    let point = triangulation::two_view(&identity, &c.first_bearing, second_from_first, &c.second_bearing)?;
    let in_second = second_from_first.transform(&point);
    if point.z <= 0.0 || in_second.z <= 0.0 || ray.dot(&c.first_bearing) > PARALLEL_COSINE {
        return None;
    }
    let chi2_first = (point.xy() / point.z - c.first).norm_squared() / c.first_variance;
    let chi2_second = (in_second.xy() / in_second.z - c.second).norm_squared() / c.second_variance;
    (chi2_first.max(chi2_second) <= MAX_REPROJECTION_CHI2).then_some(point)
}

/// Whether a match moved as the rotation alone moves what is at infinity.
fn is_far(second_from_first: &Pose, c: &Correspondence) -> bool {
    let seen = second_from_first.rotation * c.first_bearing;
    seen.z > 0.0 && (seen.xy() / seen.z - c.second).norm_squared() / c.second_variance <= FAR_CHI2
}

struct EssentialEstimator<'a> {
    correspondences: &'a [Correspondence],
}

impl Estimator for EssentialEstimator<'_> {
    type Model = Matrix3<f64>;

    fn sample_size(&self) -> usize {
        5
    }

    fn n_data(&self) -> usize {
        self.correspondences.len()
    }

    fn fit_sample(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        let firsts: Vec<_> = sample.iter().map(|idx| self.correspondences[*idx].first_bearing).collect();
        let seconds: Vec<_> = sample.iter().map(|idx| self.correspondences[*idx].second_bearing).collect();
        models.extend(two_view::essential_five_point(&firsts, &seconds));
    }

    fn squared_residual(&self, essential: &Matrix3<f64>, datum: usize) -> f64 {
        self.correspondences[datum].squared_sampson(essential)
    }

    fn refine(&self, _: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let mut models = Vec::new();
        self.fit_sample(inliers, &mut models);
        let cost = |model: &Matrix3<f64>| -> f64 {
            inliers.iter().map(|idx| self.correspondences[*idx].squared_sampson(model).min(chi2_95(1))).sum()
        };
        models
            .into_iter()
            .map(|model| (cost(&model), model))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, model)| model)
    }
}

#[derive(Clone, Debug)]
struct Planar {
    h: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

impl Planar {
    /// The larger squared transfer error of the two directions, in standard deviations.
    #[inline]
    fn squared_transfer(&self, matched: &Correspondence) -> f64 {
        let (forward, backward) = (self.h * matched.first.push(1.0), self.inverse * matched.second.push(1.0));
        let error_second =
            (forward.xy() / forward.z - matched.second).norm_squared() / matched.second_variance;
        let error_first =
            (backward.xy() / backward.z - matched.first).norm_squared() / matched.first_variance;
        error_first.max(error_second)
    }
}

struct HomographyEstimator<'a> {
    correspondences: &'a [Correspondence],
}

impl HomographyEstimator<'_> {
    fn fit(&self, indices: &[usize]) -> Option<Planar> {
        let firsts: Vec<_> = indices.iter().map(|idx| self.correspondences[*idx].first).collect();
        let seconds: Vec<_> = indices.iter().map(|idx| self.correspondences[*idx].second).collect();
        let h = two_view::homography_four_point(&firsts, &seconds)?;
        let inverse = h.try_inverse()?;
        Some(Planar { h, inverse })
    }
}

impl Estimator for HomographyEstimator<'_> {
    type Model = Planar;

    fn sample_size(&self) -> usize {
        4
    }

    fn n_data(&self) -> usize {
        self.correspondences.len()
    }

    fn fit_sample(&self, sample: &[usize], models: &mut Vec<Planar>) {
        models.extend(self.fit(sample));
    }

    fn squared_residual(&self, planar: &Planar, datum: usize) -> f64 {
        planar.squared_transfer(&self.correspondences[datum])
    }

    fn refine(&self, _: &Planar, inliers: &[usize]) -> Option<Planar> {
        self.fit(inliers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector2;

    const SIGMA: f64 = 1.0 / 500.0;

    fn seen(motion: &Pose, point: Vector3<f64>) -> Correspondence {
        let in_second = motion.transform(&point);
        let of = |p: Vector3<f64>| -> Vector2<f64> { p.xy() / p.z };
        Correspondence::of_normalized(of(point), of(in_second), SIGMA * SIGMA)
    }

    #[test]
    fn what_is_far_away_agrees_and_gives_no_point() {
        let motion = Pose::exp(&geometry::nalgebra::Vector6::new(0.01, -0.02, 0.005, 0.3, 0.1, -0.2));
        let near = (0..40).map(|i| Vector3::new(f64::from(i % 8) - 4.0, f64::from(i / 8) - 2.0, 8.0));
        let far = (0..60)
            .map(|i| 5000.0 * Vector3::new(0.1 * f64::from(i % 9) - 0.4, 0.05 * f64::from(i / 9), 1.0));
        let matches: Vec<Correspondence> = near.chain(far).map(|point| seen(&motion, point)).collect();
        let judged = judge(&motion, &matches);
        assert_eq!((judged.points.len(), judged.n_agreeing), (40, 100));
        // Turned by another degree, what is far away disagrees.
        let turned =
            Pose::new(so3::exp(&Vector3::new(0.0, 0.0175, 0.0)) * motion.rotation, motion.translation);
        assert!(judge(&turned, &matches).n_agreeing < 30);
    }
}
