//! When a frame is worth keeping. [ALGORITHMS 7.4]

use super::frame::TrackedFrame;
use super::local_map::n_established_points;
use crate::config::KeyframeConfig;
use crate::map::Map;

/// A point counts as established when this many key frames see it, or fewer while the map is younger than that.
const ESTABLISHED_OBSERVATIONS: usize = 3;

/// Whether the frame sees enough to be placed well and enough that is new to be worth keeping.
pub(super) fn wants_keyframe(
    config: &KeyframeConfig,
    map: &Map,
    frame: &TrackedFrame,
    n_inliers: usize,
    last_keyframe_ns: Option<i64>,
    n_since_relocalisation: Option<u64>,
) -> bool {
    if n_inliers < config.min_inliers || n_since_relocalisation.is_some_and(|n| n < config.settle_frames) {
        return false;
    }
    let min_observations = ESTABLISHED_OBSERVATIONS.min(map.n_keyframes());
    let n_reference = n_established_points(map, frame.reference, min_observations);
    let share = n_inliers as f64 / n_reference.max(1) as f64;
    let waited = last_keyframe_ns.is_some_and(|last| frame.timestamp_ns - last >= config.max_interval_ns);
    // After a long while even a small change is worth a key frame, but a camera at rest is not.
    share < if waited { config.max_tracked_share_after_wait } else { config.max_tracked_share }
}
