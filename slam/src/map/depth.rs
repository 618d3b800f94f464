//! How far away a keyframe's landmarks are.

use super::{Keyframe, Map};

/// Median depth of the points a keyframe sees, map units.
pub(crate) fn median_depth(map: &Map, keyframe: &Keyframe) -> Option<f64> {
    let mut depths: Vec<f64> = keyframe
        .observed_points()
        .filter_map(|(_, id)| Some(keyframe.camera_from_world.transform(&map.point(id)?.position).z))
        .collect();
    if depths.is_empty() {
        return None;
    }
    let middle = depths.len() / 2;
    Some(*depths.select_nth_unstable_by(middle, f64::total_cmp).1)
}
