//! Loop verification: what the neighbors see, where the world's directions point, and whether drift can
//! explain the difference.

use super::Place;
use super::alignment::{MAX_SQUARED_ERROR, camera_from_place, find_place_points};
use crate::config::{LoopConfig, SlamConfig};
use crate::map::{Keyframe, KeyframeId, Map, PointLandmark, PrimitiveId, median_depth};
use crate::matching::PredictedView;
use geometry::nalgebra::Vector3;
use geometry::{Direction, Similarity};
use std::collections::BTreeMap;

/// Neighbors of the new keyframe that are asked, most shared points first.
const N_ASKED_NEIGHBORS: usize = 6;
/// Axes farther apart than this have nothing to do with one another, degrees: one side does not show the
/// other's.
const UNRELATED_DEG: f64 = 15.0;
/// Shift that is always allowed, as a share of the scene's depth: the way since a place was seen may be
/// short.
const FREE_SHIFT: f64 = 0.2;

/// How many points of the place the keyframe finds, if everything speaks for the place.
pub(super) fn verify(
    map: &Map,
    current: KeyframeId,
    place: &Place,
    place_from_current: &Similarity,
    config: &SlamConfig,
) -> Option<usize> {
    let loops = &config.loops;
    let keyframe = map.keyframe(current)?;
    let matched = map.keyframe(*place.keyframes.first()?)?;
    if keyframe.submap == matched.submap && !is_drift(map, keyframe, matched, place_from_current, loops) {
        return None;
    }
    let count = |keyframe: &Keyframe| n_agreeing(map, keyframe, place, place_from_current, config);
    let n_matches = count(keyframe);
    if n_matches < loops.min_projected_matches {
        return None;
    }
    // Where two places look alike, it is what both have that is found, not the rest.
    let n_expected = n_visible(map, keyframe, place, place_from_current, config);
    if (n_matches as f64) < loops.min_found_share * n_expected as f64 {
        return None;
    }
    let neighbors: Vec<&Keyframe> =
        keyframe.covisible().iter().take(N_ASKED_NEIGHBORS).filter_map(|(id, _)| map.keyframe(*id)).collect();
    let n_required = loops.n_confirmations.min(neighbors.len());
    let confirming = neighbors.iter().filter(|neighbor| count(neighbor) >= loops.min_confirming_matches);
    if confirming.take(n_required).count() < n_required {
        return None;
    }
    directions_agree(map, keyframe, &neighbors, place, place_from_current, loops.max_direction_error_deg)
        .then_some(n_matches)
}

/// Points of the place that the keyframe finds where the similarity puts them.
fn n_agreeing(
    map: &Map,
    keyframe: &Keyframe,
    place: &Place,
    place_from_current: &Similarity,
    config: &SlamConfig,
) -> usize {
    let camera = camera_from_place(keyframe, place_from_current);
    let radius_px = 0.5 * config.loops.search_radius_px;
    let matches = find_place_points(map, keyframe, place, place_from_current, radius_px, config);
    let agrees = |(feature_idx, id): (&usize, &crate::map::PointId)| {
        let Some(point) = map.point(*id) else { return false };
        let projected = keyframe.features.pinhole.project(&camera.transform(&point.position));
        let error = (keyframe.features.undistorted[*feature_idx] - projected)
            / keyframe.features.sigma_px(*feature_idx);
        error.norm_squared() <= MAX_SQUARED_ERROR
    };
    matches.iter().filter(|found| agrees(*found)).count()
}

/// Points of the place that the keyframe should show if the similarity is right.
fn n_visible(
    map: &Map,
    keyframe: &Keyframe,
    place: &Place,
    place_from_current: &Similarity,
    config: &SlamConfig,
) -> usize {
    let camera = camera_from_place(keyframe, place_from_current);
    let center = camera.center();
    let min_view_cosine = config.tracking.max_view_angle_deg.to_radians().cos();
    let is_visible = |point: &&PointLandmark| {
        PredictedView::of(point, &camera, &center, &keyframe.features, min_view_cosine).is_some()
    };
    let n_visible = place.points.iter().filter_map(|id| map.point(*id)).filter(is_visible).count();
    // Of crowded places the extractor picks only so many keypoints.
    n_visible.min(keyframe.features.len())
}

/// Whether drift since the place was seen can be as large as the correction. Two places that look alike
/// differ by the whole way between them.
fn is_drift(
    map: &Map,
    current: &Keyframe,
    matched: &Keyframe,
    place_from_current: &Similarity,
    config: &LoopConfig,
) -> bool {
    let (first, last) = (current.id.min(matched.id), current.id.max(matched.id));
    let centers: Vec<Vector3<f64>> = map
        .keyframes_of(current.submap)
        .filter(|keyframe| (first..=last).contains(&keyframe.id))
        .map(|keyframe| keyframe.camera_from_world.center())
        .collect();
    let way: f64 = centers.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let center = current.camera_from_world.center();
    let shift = (place_from_current.transform(&center) - center).norm();
    let free = FREE_SHIFT * median_depth(map, current).unwrap_or(0.0);
    shift <= config.max_drift_share * way + free
        && place_from_current.rotation.angle() <= config.max_turn_deg.to_radians()
        && place_from_current.scale.ln().abs() <= config.max_scale_change.ln()
}

/// Whether the directions of the world seen on both sides fall on one another. Nothing to compare is no
/// objection.
///
/// A primitive that both sides show says by itself how far the attitude has drifted: each must be turned onto
/// itself, so that a room is not taken for itself turned about its vertical. Others are compared with the
/// nearest of the other side.
pub(super) fn directions_agree(
    map: &Map,
    current: &Keyframe,
    neighbors: &[&Keyframe],
    place: &Place,
    place_from_current: &Similarity,
    max_error_deg: f64,
) -> bool {
    let here: Vec<(PrimitiveId, Direction)> = std::iter::once(current)
        .chain(neighbors.iter().copied())
        .flat_map(directions)
        .map(|(id, direction)| (id, direction.rotated(&place_from_current.rotation)))
        .collect();
    let there: Vec<(PrimitiveId, Direction)> =
        place.keyframes.iter().filter_map(|id| map.keyframe(*id)).flat_map(directions).collect();
    if here.is_empty() || there.is_empty() {
        return true;
    }
    let mut of_shared: BTreeMap<PrimitiveId, Vec<f64>> = BTreeMap::new();
    for (id, direction) in &here {
        let same = there.iter().filter(|(other, _)| other == id);
        let errors = same.map(|(_, other)| direction.angle(other).to_degrees());
        of_shared.entry(*id).or_default().extend(errors);
    }
    if of_shared.into_values().filter_map(median).any(|error| error > max_error_deg) {
        return false;
    }
    let nearest_deg = |(_, direction): &(PrimitiveId, Direction)| {
        there.iter().map(|(_, other)| direction.angle(other).to_degrees()).fold(f64::INFINITY, f64::min)
    };
    let errors = here.iter().map(nearest_deg).filter(|error| *error < UNRELATED_DEG).collect();
    median(errors).is_some_and(|error| error <= max_error_deg)
}

/// The middle one: single vanishing points are noisy, or wrong.
fn median(mut errors: Vec<f64>) -> Option<f64> {
    let middle = errors.len() / 2;
    (!errors.is_empty()).then(|| *errors.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The primitives whose vanishing points a keyframe shows, and where these point in the world.
fn directions(keyframe: &Keyframe) -> impl Iterator<Item = (PrimitiveId, Direction)> + '_ {
    let world_from_camera = keyframe.camera_from_world.rotation.inverse();
    keyframe
        .vanishing
        .iter()
        .filter_map(move |seen| Some((seen.primitive?, Direction::new(world_from_camera * seen.direction)?)))
}
