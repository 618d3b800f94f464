//! Map point fusion: looking for points in a keyframe and joining those that are the same.

use super::search::{PredictedView, Window, find_in_window};
use crate::config::SlamConfig;
use crate::map::{KeyframeId, Map, Observation, PointId};
use optim::chi2_95;
use vision::matching::STRICT_DISTANCE;

/// Looks for points in a keyframe: one already explained there is joined with what explains it, a free one
/// seen.
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

/// The keypoint with which a keyframe sees a point that it is not known to see.
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
    let center = keyframe.camera_from_world.center();
    let view =
        PredictedView::of(point, &keyframe.camera_from_world, &center, &keyframe.features, min_view_cosine)?;
    let features = &keyframe.features;
    // Keypoints that disagree with the projection are passed over, so that a neighbor of the right one
    // cannot win.
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
