//! Views that had no part in making a first map, placed by its points.

use super::matching::match_views;
use super::{InitialPair, REFERENCE_WIDTH_PX};
use crate::config::InitializationConfig;
use crate::features::View;
use geometry::Pose;
use geometry::absolute_pose::{PoseObservation, ransac_pose};
use geometry::nalgebra::Vector3;
use geometry::ransac::{RansacConfig, RansacReport};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Whether a third view agrees with a first map: how many of the points found in it agree with one pose, and
/// how many were found.
pub(super) fn confirm(
    pair: &InitialPair,
    third: &View,
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> (usize, usize) {
    let points = pair.points.iter().map(|(idx, _, position)| (*idx, *position));
    let (placed, n_found) = place(&pair.first, points, third, config, rng);
    (placed.map_or(0, |report| report.n_inliers), n_found)
}

/// Places a view by points that are keypoints of another one, in whatever frame the points are. Also returns
/// how many of them were found in it.
pub(super) fn place(
    known: &View,
    points: impl Iterator<Item = (usize, Vector3<f64>)>,
    other: &View,
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> (Option<RansacReport<Pose>>, usize) {
    let features = &other.features;
    let radius_px = config.search_radius_px * features.width_px() / REFERENCE_WIDTH_PX;
    let counterparts: BTreeMap<usize, usize> =
        match_views(&known.features, features, radius_px).into_iter().collect();
    let focal_px = features.pinhole.mean_focal_px();
    let observations: Vec<PoseObservation> = points
        .filter_map(|(idx, point)| {
            let other_idx = *counterparts.get(&idx)?;
            let bearing = features.pinhole.bearing(&features.undistorted[other_idx]);
            Some(PoseObservation { bearing, point, sigma_rad: features.sigma_px(other_idx) / focal_px })
        })
        .collect();
    let search = RansacConfig { max_iterations: config.max_iterations, ..RansacConfig::default() };
    (ransac_pose(&observations, &search, rng), observations.len())
}
