//! Joining points that are the same and adding sightings that were missed.

use super::neighbours;
use crate::config::SlamConfig;
use crate::map::{KeyframeId, Map, Observation, PointId};
use crate::tracking::search::{PredictedView, Window, find_in_window};
use optim::chi2_95;
use std::collections::BTreeSet;
use vision::matching::STRICT_DISTANCE;

/// Neighbours of each neighbour into which points are fused as well.
const N_SECOND_NEIGHBOURS: usize = 5;

/// Projects the key frame's points into its neighbours and theirs into it.
pub(super) fn fuse_with_neighbours(map: &mut Map, id: KeyframeId, config: &SlamConfig) {
    let targets = targets(map, id, config.mapping.n_fusion_neighbours);
    let own: Vec<PointId> = observed(map, id).into_iter().collect();
    for target in &targets {
        fuse_into(map, &own, *target, config);
    }
    let mut theirs = BTreeSet::new();
    for target in &targets {
        theirs.extend(observed(map, *target));
    }
    let theirs: Vec<PointId> = theirs.into_iter().collect();
    fuse_into(map, &theirs, id, config);
    for point in observed(map, id) {
        map.refresh_point(point);
    }
    map.refresh_covisibility(id, config.mapping.min_covisible_points);
}

fn observed(map: &Map, id: KeyframeId) -> BTreeSet<PointId> {
    map.keyframe(id)
        .map_or(BTreeSet::new(), |keyframe| keyframe.observed_points().map(|(_, id)| id).collect())
}

fn targets(map: &Map, id: KeyframeId, n_neighbours: usize) -> Vec<KeyframeId> {
    let mut targets = Vec::new();
    for neighbour in neighbours(map, id, n_neighbours) {
        for target in std::iter::once(neighbour).chain(neighbours(map, neighbour, N_SECOND_NEIGHBOURS)) {
            if target != id && !targets.contains(&target) {
                targets.push(target);
            }
        }
    }
    targets
}

/// Looks for points in a key frame: one already explained there is joined with what explains it, a free one seen.
pub(crate) fn fuse_into(map: &mut Map, points: &[PointId], target: KeyframeId, config: &SlamConfig) -> usize {
    let min_view_cosine = config.tracking.max_view_angle_deg.to_radians().cos();
    let mut n_fused = 0;
    for id in points {
        let Some(feature_idx) =
            find_in_keyframe(map, *id, target, config.mapping.fusion_radius_px, min_view_cosine)
        else {
            continue;
        };
        let Some(keyframe) = map.keyframe(target) else { return n_fused };
        match keyframe.points[feature_idx] {
            Some(other) if other != *id => {
                let n_observations = |id| map.point(id).map_or(0, |point| point.observations.len());
                let (kept, gone) =
                    if n_observations(other) > n_observations(*id) { (other, *id) } else { (*id, other) };
                map.fuse_points(kept, gone);
            }
            Some(_) => continue,
            None => {
                map.add_observation(*id, Observation { keyframe: target, feature_idx: feature_idx as u32 });
            }
        }
        n_fused += 1;
    }
    n_fused
}

/// The keypoint with which a key frame sees a point that it is not known to see.
fn find_in_keyframe(
    map: &Map,
    id: PointId,
    target: KeyframeId,
    radius_px: f64,
    min_view_cosine: f64,
) -> Option<usize> {
    let point = map.point(id)?;
    let keyframe = map.keyframe(target)?;
    if point.observation_in(target).is_some() {
        return None;
    }
    let centre = keyframe.camera_from_world.centre();
    let view =
        PredictedView::of(point, &keyframe.camera_from_world, &centre, &keyframe.features, min_view_cosine)?;
    let features = &keyframe.features;
    // Keypoints that disagree with the projection are passed over, so that a neighbour of the right one cannot win.
    let disagrees = |idx: usize| {
        let sigma = features.sigma_px(idx);
        (features.undistorted[idx] - view.pixel).norm_squared() > chi2_95(2) * sigma * sigma
    };
    let window = Window {
        pixel: view.pixel,
        radius_px: radius_px * features.pyramid.scale(view.octave),
        octaves: view.octaves(),
        ratio: None,
        max_distance: STRICT_DISTANCE,
    };
    find_in_window(features, &point.descriptor, &window, disagrees)
}
