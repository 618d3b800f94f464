//! Keyframe decision: when a frame becomes a keyframe. [method: Keyframe decision]

use super::frame::{Inliers, TrackedFrame};
use super::local_map::n_established_points;
use crate::config::KeyframeConfig;
use crate::map::{KeyframeId, Map, PointId};
use geometry::nalgebra::Vector2;
use std::collections::BTreeMap;

/// A point counts as established when this many keyframes see it, or fewer while the map is younger than
/// that.
const ESTABLISHED_OBSERVATIONS: usize = 3;
/// Common points below which two views have so little in common that the one is news to the other.
const MIN_COMMON_POINTS: usize = 15;

/// The last frame that was kept, as the next one is compared with it.
#[derive(Clone, Debug)]
pub(super) struct LastKeyframe {
    timestamp_ns: i64,
    /// Where its landmarks were, undistorted pixels.
    pixels: BTreeMap<PointId, Vector2<f64>>,
    /// Where the middles of its segments were, by track, undistorted pixels.
    midpoints: BTreeMap<u64, Vector2<f64>>,
    /// The most landmarks that a frame has found since.
    most_found: usize,
}

impl LastKeyframe {
    pub fn of(frame: &TrackedFrame) -> Self {
        let seen = frame.points.iter().enumerate();
        let pixels = seen.filter_map(|(idx, id)| Some(((*id)?, frame.features.undistorted[idx]))).collect();
        let segments = frame.features.lines.iter();
        let midpoints = segments.map(|segment| (segment.track, segment.midpoint())).collect();
        Self { timestamp_ns: frame.timestamp_ns, pixels, midpoints, most_found: 0 }
    }

    /// Notes how many landmarks a frame has found.
    pub fn note_found(&mut self, n_found: usize) {
        self.most_found = self.most_found.max(n_found);
    }

    /// Median distance that common points and segments moved in the image, as a share of its width; infinite
    /// with few in common.
    fn displacement(&self, frame: &TrackedFrame) -> f64 {
        let mut moved: Vec<f64> = frame
            .points
            .iter()
            .enumerate()
            .filter_map(|(idx, id)| {
                Some((self.pixels.get(id.as_ref()?)? - frame.features.undistorted[idx]).norm())
            })
            .collect();
        let segments = frame.features.lines.iter();
        moved.extend(
            segments.filter_map(|segment| {
                Some((self.midpoints.get(&segment.track)? - segment.midpoint()).norm())
            }),
        );
        if moved.len() < MIN_COMMON_POINTS {
            return f64::INFINITY;
        }
        let middle = moved.len() / 2;
        *moved.select_nth_unstable_by(middle, f64::total_cmp).1 / frame.features.width_px()
    }
}

/// Whether the frame sees enough to be placed well and enough that is new to be worth keeping.
pub(super) fn wants_keyframe(
    config: &KeyframeConfig,
    map: &Map,
    frame: &TrackedFrame,
    inliers: Inliers,
    last: Option<&LastKeyframe>,
    n_since_relocalization: Option<u64>,
) -> bool {
    if inliers.total() < config.min_inliers
        || n_since_relocalization.is_some_and(|n| n < config.settle_frames)
    {
        return false;
    }
    let share = tracked_share(map, frame.reference, inliers.n_points);
    let Some(last) = last else { return share < config.max_tracked_share };
    if frame.timestamp_ns - last.timestamp_ns >= config.max_interval_ns
        && share < config.max_tracked_share_after_wait
    {
        return true;
    }
    let displacement = last.displacement(frame);
    if displacement > config.min_displacement && lines_are_needed(config, frame, inliers, last) {
        return true;
    }
    let is_scarce = inliers.total() < config.scarce_landmarks;
    if is_scarce && (inliers.total() as f64) < config.fallen_share * last.most_found as f64 {
        return true;
    }
    displacement > if is_scarce { config.scarce_displacement } else { config.ample_displacement }
        || share < config.max_tracked_share && displacement > config.min_displacement
        || share < config.urgent_tracked_share && displacement > config.urgent_displacement
}

/// Whether points are few and lines could take over: enough segments have been followed since the last
/// keyframe that no line of the map explains, or many more segments are followed than then.
/// [method: Keyframe decision]
fn lines_are_needed(
    config: &KeyframeConfig,
    frame: &TrackedFrame,
    inliers: Inliers,
    last: &LastKeyframe,
) -> bool {
    if inliers.n_points >= config.plentiful_points {
        return false;
    }
    let segments = frame.features.lines.iter().zip(&frame.lines);
    let followed = segments.filter(|(segment, _)| last.midpoints.contains_key(&segment.track));
    let n_unexplained = followed.filter(|(_, line)| line.is_none()).count();
    let n_risen = config.risen_segments_share * last.midpoints.len() as f64;
    n_unexplained >= config.min_followed_segments || frame.features.lines.len() as f64 > n_risen
}

/// Inliers as a share of the established points that the reference keyframe sees.
fn tracked_share(map: &Map, reference: KeyframeId, n_inliers: usize) -> f64 {
    let min_observations = ESTABLISHED_OBSERVATIONS.min(map.n_keyframes());
    n_inliers as f64 / n_established_points(map, reference, min_observations).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{FrameFeatures, View};
    use crate::map::SubmapId;
    use crate::test_fixtures::{camera, pyramid};
    use geometry::Pose;
    use std::sync::Arc;
    use vision::{Descriptor, Keypoint};

    const N_COMMON: usize = 40;

    /// A frame that sees forty landmarks, so far to the right of where they were.
    fn frame(shift_px: f32) -> TrackedFrame {
        let keypoint =
            |x: f32| Keypoint { x: 100.0 + x + shift_px, y: 100.0, octave: 0, angle: 0.0, response: 30.0 };
        let keypoints = (0..N_COMMON).map(|idx| keypoint(10.0 * idx as f32)).collect();
        let descriptors = vec![Descriptor([0; 4]); N_COMMON];
        let features =
            Arc::new(FrameFeatures::from_parts(keypoints, descriptors, &camera(), pyramid()).unwrap());
        let view = View { sequence: 0, timestamp_ns: 0, features };
        let mut frame =
            TrackedFrame::blank(&view, Pose::identity(), KeyframeId::from_index(0), SubmapId::default());
        frame.points = (0..N_COMMON).map(|idx| Some(PointId::from_index(idx))).collect();
        frame
    }

    /// Whether a frame is kept that finds so many points after so many were found.
    fn is_kept(n_points: usize, most_found: usize, shift_px: f32) -> bool {
        let mut last = LastKeyframe::of(&frame(0.0));
        last.note_found(most_found);
        let inliers = Inliers { n_points, n_lines: 0 };
        let config = KeyframeConfig::default();
        wants_keyframe(&config, &Map::default(), &frame(shift_px), inliers, Some(&last), None)
    }

    #[test]
    fn where_landmarks_are_scarce_a_smaller_way_is_enough() {
        let width_px = 640.0;
        assert!(!is_kept(300, 300, 0.07 * width_px), "plenty of landmarks: more work and no gain");
        assert!(is_kept(150, 150, 0.07 * width_px));
        assert!(!is_kept(150, 150, 0.03 * width_px));
        assert!(is_kept(300, 300, 0.11 * width_px));
    }

    #[test]
    fn a_frame_is_kept_before_the_last_landmarks_are_gone() {
        assert!(is_kept(43, 93, 0.0));
        assert!(!is_kept(65, 93, 0.0));
        assert!(!is_kept(250, 600, 0.0), "these are enough");
    }
}
