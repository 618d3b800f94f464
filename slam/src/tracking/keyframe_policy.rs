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
}

impl LastKeyframe {
    pub fn of(frame: &TrackedFrame) -> Self {
        let seen = frame.points.iter().enumerate();
        let pixels = seen.filter_map(|(idx, id)| Some(((*id)?, frame.features.undistorted[idx]))).collect();
        let segments = frame.features.lines.iter();
        let midpoints = segments.map(|segment| (segment.track, segment.midpoint())).collect();
        Self { timestamp_ns: frame.timestamp_ns, pixels, midpoints }
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
    displacement > config.ample_displacement
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
