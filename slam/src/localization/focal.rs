//! The focal length of an image nobody knows the camera of, from what it shows of a map.
//!
//! Few matches agree with a pose under a focal length that is far off. So several are tried with the places
//! that look like the image, and the best ones are then fitted together with the pose.

use super::{Localizer, N_MATCHED_NEIGHBORS, Near, simple_camera};
use crate::bundle::factors::PointReprojectionFactor;
use crate::clock::{NoClock, Stopwatch};
use crate::features::FrameFeatures;
use crate::input::ResumeError;
use crate::map::Map;
use crate::matching::match_place;
use crate::tracking::frame::TrackedFrame;
use geometry::absolute_pose::{PoseObservation, ransac_pose};
use geometry::nalgebra::{Vector2, Vector3};
use geometry::ransac::RansacConfig;
use geometry::{Pinhole, Pose};
use optim::{HoldSecond, Kernel, SingleOptions, UnaryGroup, chi2_95, optimize_single};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use vision::GrayImage;

/// The focal length most cameras have, as a share of the larger side: 61 degrees.
const USUAL_FOCAL_SHARE: f64 = 0.85;
/// Focal lengths tried, as shares of the usual one: from 115 to 20 degrees, each a sixth longer than the one
/// before, which leaves errors at the image's border of a few pixels.
const LADDER: [f64; 11] = [0.38, 0.46, 0.55, 0.66, 0.78, 0.91, 1.06, 1.25, 1.55, 2.1, 3.3];
/// Fewest matches with a place that are worth a try: one more unknown than a known camera has.
const MIN_MATCHES: usize = 16;
/// Fewest of them that must agree with a pose.
const MIN_INLIERS: usize = 11;
/// Samples drawn for each focal length, at most.
const MAX_ITERATIONS: usize = 150;
/// Guesses handed on, at most.
const MAX_GUESSES: usize = 3;
/// How far a focal length is looked for around a guess, as factors, and how well it is found.
const REACH: f64 = 1.25;
const PRECISION: f64 = 5e-4;

/// A focal length, and what speaks for it.
struct Guess {
    focal_px: f64,
    n_inliers: usize,
}

/// A keypoint and its place in the map.
struct Sighting {
    /// From the principal point, pixels.
    offset_px: Vector2<f64>,
    point: Vector3<f64>,
    sigma_px: f64,
}

impl Localizer {
    /// Focal lengths, in pixels of the image, that what it shows of the map speaks for; best first.
    pub(super) fn guess_focals(
        &mut self,
        image: &GrayImage,
        near: Option<Near>,
    ) -> Result<Vec<f64>, ResumeError> {
        let usual_px = USUAL_FOCAL_SHARE * f64::from(image.width().max(image.height()));
        let Some(camera) = simple_camera(image, usual_px) else { return Ok(Vec::new()) };
        let scaled = self.at_map_resolution(&camera);
        let mut config = self.config_of_others();
        config.features.lines = false;
        config.features.global_primitives = false;
        let mut stopwatch = Stopwatch::start(Arc::new(NoClock));
        let (view, _) = self.view(image, &scaled, &config, false, &mut stopwatch)?;
        let to_image_px = usual_px / view.features.pinhole.mean_focal_px();
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        let mut guesses = Vec::new();
        for id in self.tracker.places_like(&view, &self.map, near.map(|near| (near.position, near.radius))) {
            let Some(keyframe) = self.map.keyframe(id) else { continue };
            let matches = match_place(keyframe, &view.features, &self.map, N_MATCHED_NEIGHBORS);
            let sightings: Vec<Sighting> = matches
                .iter()
                .filter_map(|(feature_idx, point)| {
                    sighting(&view.features, *feature_idx, self.map.point(*point)?.position)
                })
                .collect();
            if sightings.len() >= MIN_MATCHES {
                guesses.extend(guess(&sightings, &view.features.pinhole, &mut rng));
            }
        }
        guesses.sort_by_key(|guess| std::cmp::Reverse(guess.n_inliers));
        guesses.truncate(MAX_GUESSES);
        Ok(guesses.into_iter().map(|guess| guess.focal_px * to_image_px).collect())
    }
}

fn sighting(features: &FrameFeatures, feature_idx: usize, point: Vector3<f64>) -> Option<Sighting> {
    let pinhole = &features.pinhole;
    let offset_px = features.undistorted[feature_idx] - Vector2::new(pinhole.cx, pinhole.cy);
    Some(Sighting { offset_px, point, sigma_px: features.sigma_px(feature_idx) })
}

/// The focal length under which the most sightings agree with a pose, fitted to them.
fn guess(sightings: &[Sighting], usual: &Pinhole, rng: &mut ChaCha8Rng) -> Option<Guess> {
    let config = RansacConfig { max_iterations: MAX_ITERATIONS, ..RansacConfig::default() };
    let mut best: Option<(f64, Pose, Vec<bool>, f64)> = None;
    for share in LADDER {
        let focal_px = share * usual.mean_focal_px();
        let observation = |sighting: &Sighting| PoseObservation {
            bearing: (sighting.offset_px / focal_px).push(1.0).normalize(),
            point: sighting.point,
            sigma_rad: sighting.sigma_px / focal_px,
        };
        let observations: Vec<PoseObservation> = sightings.iter().map(observation).collect();
        let Some(found) = ransac_pose(&observations, &config, rng) else { continue };
        if best.as_ref().is_none_or(|(.., score)| found.score > *score) {
            best = Some((focal_px, found.model, found.inliers, found.score));
        }
    }
    let (focal_px, pose, inliers, _) = best?;
    let agreeing: Vec<&Sighting> =
        sightings.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(sighting, _)| sighting).collect();
    let n_inliers = agreeing.len();
    (n_inliers >= MIN_INLIERS).then(|| Guess { focal_px: fit(&agreeing, focal_px, pose), n_inliers })
}

/// By how much the focal length of a placed frame has to be multiplied to suit what it shows best.
pub(super) fn refine(frame: &TrackedFrame, map: &Map, pinhole: &Pinhole) -> Option<f64> {
    let sightings: Vec<Sighting> = frame
        .points
        .iter()
        .enumerate()
        .filter_map(|(feature_idx, id)| sighting(&frame.features, feature_idx, map.point((*id)?)?.position))
        .collect();
    if sightings.len() < MIN_INLIERS {
        return None;
    }
    let focal_px = pinhole.mean_focal_px();
    let all: Vec<&Sighting> = sightings.iter().collect();
    Some(fit(&all, focal_px, frame.camera_from_world) / focal_px)
}

/// The focal length that suits sightings best, each with the pose that does: by golden section.
fn fit(sightings: &[&Sighting], focal_px: f64, pose: Pose) -> f64 {
    let golden = (5_f64.sqrt() - 1.0) / 2.0;
    let cost = |log_factor: f64| cost_with(sightings, focal_px * log_factor.exp(), &pose);
    let (mut low, mut high) = (-REACH.ln(), REACH.ln());
    let inner = |low: f64, high: f64| (high - golden * (high - low), low + golden * (high - low));
    let (mut left, mut right) = inner(low, high);
    let (mut cost_left, mut cost_right) = (cost(left), cost(right));
    while high - low > PRECISION {
        if cost_left < cost_right {
            high = right;
            (right, cost_right) = (left, cost_left);
            left = inner(low, high).0;
            cost_left = cost(left);
        } else {
            low = left;
            (left, cost_left) = (right, cost_right);
            right = inner(low, high).1;
            cost_right = cost(right);
        }
    }
    focal_px * ((low + high) / 2.0).exp()
}

fn cost_with(sightings: &[&Sighting], focal_px: f64, pose: &Pose) -> f64 {
    let pinhole = Pinhole { fx: focal_px, fy: focal_px, cx: 0.0, cy: 0.0 };
    let factor = |sighting: &&Sighting| HoldSecond {
        factor: PointReprojectionFactor {
            pinhole,
            observed_px: sighting.offset_px,
            inverse_sigma: 1.0 / sighting.sigma_px,
        },
        second: sighting.point,
    };
    let factors: Vec<HoldSecond<PointReprojectionFactor, Vector3<f64>>> =
        sightings.iter().map(factor).collect();
    let mut group = UnaryGroup::new(Kernel::huber_95(2), chi2_95(2), factors);
    let options =
        SingleOptions { n_rounds: 1, n_robust_rounds: 1, max_iterations: 20, ..SingleOptions::default() };
    optimize_single::<Pose, 6>(pose, &mut [&mut group], &options).cost.robust
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::UnitQuaternion;

    #[test]
    fn the_focal_length_of_a_deep_scene_is_found() {
        let pose = Pose::new(UnitQuaternion::from_euler_angles(0.1, 0.2, -0.1), Vector3::new(0.2, 0.1, 0.3));
        let (focal_px, mut sightings) = (410.0, Vec::new());
        for i in 0..60 {
            let (x, y) = (f64::from(i % 10) - 4.5, f64::from(i / 10) - 2.5);
            let depth = 4.0 + f64::from(i * 7 % 11) * 0.5;
            let in_camera = Vector3::new(0.12 * x * depth, 0.12 * y * depth, depth);
            let offset_px = in_camera.xy() * (focal_px / in_camera.z);
            let point = pose.inverse().transform(&in_camera);
            sightings.push(Sighting { offset_px, point, sigma_px: 1.0 });
        }
        let usual = Pinhole { fx: 500.0, fy: 500.0, cx: 0.0, cy: 0.0 };
        let found = guess(&sightings, &usual, &mut ChaCha8Rng::seed_from_u64(1)).unwrap();
        assert!(
            found.n_inliers >= MIN_INLIERS && (found.focal_px / focal_px - 1.0).abs() < 2e-3,
            "{}",
            found.focal_px
        );
    }
}
