//! Search by projection: landmarks in a frame, by predicted position and descriptor.

use crate::features::FrameFeatures;
use crate::map::{Keyframe, Map, PointId, PointLandmark};
use geometry::Pose;
use geometry::nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;
use vision::matching::{LOOSE_DISTANCE, RotationConsistency, STRICT_DISTANCE, nearest_two};
use vision::{Descriptor, vectorized};

/// Views this close to the mean one, as a cosine, move little between their prediction and the truth.
const FRONTAL_COSINE: f64 = 0.998;
/// Search radius of a frontal view as a share of the full one: 2.5 px of 4.
const FRONTAL_RADIUS_SHARE: f64 = 0.625;
/// Points seen from a little nearer or farther than the pyramid covers are still looked for.
const RANGE_TOLERANCE: f64 = 0.2;

/// Where a point should appear in a view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedView {
    pub pixel: Vector2<f64>,
    pub octave: u8,
    /// Cosine of the angle between the mean direction the point was seen from and the present one.
    pub view_cosine: f64,
}

impl PredictedView {
    /// `None` if the point is behind the camera, outside the image, too near, too far, or seen too much from
    /// the side.
    pub fn of(
        point: &PointLandmark,
        camera_from_world: &Pose,
        center: &geometry::nalgebra::Vector3<f64>,
        features: &FrameFeatures,
        min_view_cosine: f64,
    ) -> Option<Self> {
        let in_camera = camera_from_world.transform(&point.position);
        if in_camera.z <= 0.0 {
            return None;
        }
        let pixel = features.pinhole.project(&in_camera);
        if !features.contains(&pixel) {
            return None;
        }
        let from_center = point.position - center;
        let distance = from_center.norm();
        let (nearest, farthest) = point.distance_range;
        if distance < nearest * (1.0 - RANGE_TOLERANCE) || distance > farthest * (1.0 + RANGE_TOLERANCE) {
            return None;
        }
        let view_cosine = from_center.dot(&point.mean_view_direction) / distance;
        if view_cosine < min_view_cosine {
            return None;
        }
        let octave = features.pyramid.predict_octave(farthest, distance);
        Some(Self { pixel, octave, view_cosine })
    }

    /// Where to look, pixels, if a radius of `radius_px` pixels of the level is right for views from the
    /// side.
    pub fn radius_px(&self, radius_px: f64, features: &FrameFeatures) -> f64 {
        let share = if self.view_cosine > FRONTAL_COSINE { FRONTAL_RADIUS_SHARE } else { 1.0 };
        radius_px * share * features.pyramid.scale(self.octave)
    }

    /// The levels in which it may be found: the predicted one and the next finer.
    pub fn octaves(&self) -> RangeInclusive<u8> {
        self.octave.saturating_sub(1)..=self.octave
    }
}

/// Where to look for a keypoint, and how alike it must look.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    /// Center of a square, undistorted pixels.
    pub pixel: Vector2<f64>,
    /// Half its side, pixels.
    pub radius_px: f64,
    pub octaves: RangeInclusive<u8>,
    /// Best match's distance as a share of the second best's of the same level, if that matters.
    pub ratio: Option<f32>,
    /// Largest distance of the descriptors, bits.
    pub max_distance: u32,
}

/// The keypoint in a window that looks most like a descriptor. Keypoints for which `taken` holds are passed
/// over.
pub(crate) fn find_in_window(
    features: &FrameFeatures,
    descriptor: &Descriptor,
    window: &Window,
    taken: impl Fn(usize) -> bool,
) -> Option<usize> {
    // Bits are counted by an instruction that not every processor has.
    vectorized(
        #[inline(always)]
        || nearest_in_window(features, descriptor, window, taken),
    )
}

#[inline(always)]
fn nearest_in_window(
    features: &FrameFeatures,
    descriptor: &Descriptor,
    window: &Window,
    taken: impl Fn(usize) -> bool,
) -> Option<usize> {
    let (mut best, mut second) = ((u32::MAX, usize::MAX), (u32::MAX, usize::MAX));
    let (x, y, radius) = (window.pixel.x as f32, window.pixel.y as f32, window.radius_px as f32);
    features.grid.for_each_in_window(
        x,
        y,
        radius,
        window.octaves.clone(),
        #[inline(always)]
        |idx| {
            let idx = idx as usize;
            if taken(idx) {
                return;
            }
            let distance = descriptor.distance(&features.descriptors[idx]);
            if distance < best.0 {
                second = best;
                best = (distance, idx);
            } else if distance < second.0 {
                second = (distance, idx);
            }
        },
    );
    if best.0 > window.max_distance {
        return None;
    }
    if let Some(ratio) = window.ratio.filter(|_| second.1 != usize::MAX) {
        let same_level = features.keypoints[best.1].octave == features.keypoints[second.1].octave;
        if same_level && best.0 as f32 > ratio * second.0 as f32 {
            return None;
        }
    }
    Some(best.1)
}

/// A point with its place in the view it was matched in before.
pub(crate) struct Expected<'a> {
    pub point: &'a PointLandmark,
    pub octave: u8,
    pub angle: f32,
    pub descriptor: &'a Descriptor,
}

/// Looks for points of one view in another by projecting them; matches whose change of orientation is unlike
/// the others' are dropped. Returns how many were found; `points` takes them.
pub(crate) fn search_by_motion<'a>(
    features: &FrameFeatures,
    camera_from_world: &Pose,
    expected: impl Iterator<Item = Expected<'a>>,
    radius_px: f64,
    points: &mut [Option<PointId>],
) -> usize {
    let mut rotation = RotationConsistency::new();
    let mut found: Vec<(usize, f32)> = Vec::new();
    for Expected { point, octave, angle, descriptor } in expected {
        let in_camera = camera_from_world.transform(&point.position);
        if in_camera.z <= 0.0 {
            continue;
        }
        let pixel = features.pinhole.project(&in_camera);
        if !features.contains(&pixel) {
            continue;
        }
        let window = Window {
            pixel,
            radius_px: radius_px * features.pyramid.scale(octave),
            octaves: octave.saturating_sub(1)..=octave + 1,
            ratio: None,
            max_distance: LOOSE_DISTANCE,
        };
        if let Some(feature_idx) = find_in_window(features, descriptor, &window, |idx| points[idx].is_some())
        {
            points[feature_idx] = Some(point.id);
            let change = features.keypoints[feature_idx].angle - angle;
            rotation.add(change);
            found.push((feature_idx, change));
        }
    }
    let dominant = rotation.dominant();
    let mut n_found = found.len();
    for (feature_idx, change) in found {
        if !dominant.accepts(change) {
            points[feature_idx] = None;
            n_found -= 1;
        }
    }
    n_found
}

/// Best match's distance as a share of the second best's, where nothing is known of the place.
/// [method: Descriptor matching]
const UNGUIDED_RATIO: f32 = 0.75;

/// Matches a keyframe's points with a frame by descriptors alone. Returns `(keypoint of the frame, point)`
/// pairs.
pub(crate) fn match_keyframe(keyframe: &Keyframe, features: &FrameFeatures) -> Vec<(usize, PointId)> {
    let mut rotation = RotationConsistency::new();
    // Each keypoint of the frame is given to the most similar point that chose it.
    let mut claims: Vec<Option<(u32, PointId, f32)>> = vec![None; features.len()];
    for (keypoint_idx, point_id) in keyframe.observed_points() {
        let descriptor = &keyframe.features.descriptors[keypoint_idx];
        let (best, second) = nearest_two(descriptor, features.descriptors.iter().enumerate());
        if best.0 > STRICT_DISTANCE || best.0 as f32 > UNGUIDED_RATIO * second as f32 {
            continue;
        }
        if claims[best.1].is_none_or(|(distance, ..)| best.0 < distance) {
            let change = features.keypoints[best.1].angle - keyframe.features.keypoints[keypoint_idx].angle;
            claims[best.1] = Some((best.0, point_id, change));
        }
    }
    claims.iter().flatten().for_each(|(_, _, change)| rotation.add(*change));
    let dominant = rotation.dominant();
    let accepted = |(idx, claim): (usize, Option<(u32, PointId, f32)>)| {
        claim.filter(|(_, _, change)| dominant.accepts(*change)).map(|(_, point_id, _)| (idx, point_id))
    };
    claims.into_iter().enumerate().filter_map(accepted).collect()
}

/// As [`match_keyframe`], with what neighbors of the keyframe see as well; the keyframe itself has the first
/// word, then the neighbors that share the most with it.
pub(crate) fn match_place(
    keyframe: &Keyframe,
    features: &FrameFeatures,
    map: &Map,
    n_neighbors: usize,
) -> Vec<(usize, PointId)> {
    let neighbors = keyframe.covisible().iter().take(n_neighbors).filter_map(|(id, _)| map.keyframe(*id));
    let (mut matched, mut seen) = (BTreeMap::new(), BTreeSet::new());
    for other in std::iter::once(keyframe).chain(neighbors) {
        for (feature_idx, point) in match_keyframe(other, features) {
            if !matched.contains_key(&feature_idx) && seen.insert(point) {
                matched.insert(feature_idx, point);
            }
        }
    }
    matched.into_iter().collect()
}
