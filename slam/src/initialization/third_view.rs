//! The test of a first map: does a view that had no part in making it agree?

use super::matching::match_views;
use super::{InitialPair, REFERENCE_WIDTH_PX};
use crate::config::InitializationConfig;
use crate::features::View;
use geometry::absolute_pose::{PoseObservation, ransac_pose};
use geometry::ransac::RansacConfig;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Places the third view by the pair's points. Returns how many of the points found in it agree with the
/// pose, and how many were found.
pub(super) fn confirm(
    pair: &InitialPair,
    third: &View,
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> (usize, usize) {
    let features = &third.features;
    let radius_px = config.search_radius_px * features.width_px() / REFERENCE_WIDTH_PX;
    let counterparts: BTreeMap<usize, usize> =
        match_views(&pair.first.features, features, radius_px).into_iter().collect();
    let focal_px = features.pinhole.mean_focal_px();
    let observations: Vec<PoseObservation> = pair
        .points
        .iter()
        .filter_map(|(first_idx, _, position)| {
            let third_idx = *counterparts.get(first_idx)?;
            Some(PoseObservation {
                bearing: features.pinhole.bearing(&features.undistorted[third_idx]),
                point: *position,
                sigma_rad: features.sigma_px(third_idx) / focal_px,
            })
        })
        .collect();
    let search = RansacConfig { max_iterations: config.max_iterations, ..RansacConfig::default() };
    let n_agreeing = ransac_pose(&observations, &search, rng).map_or(0, |report| report.n_inliers);
    (n_agreeing, observations.len())
}
