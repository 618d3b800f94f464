//! Matching two views before anything is known of the motion between them.

use crate::features::FrameFeatures;
use vision::matching::{RotationConsistency, STRICT_DISTANCE};

/// Best match's distance as a share of the second best's. [ALGORITHMS 7.2]
const RATIO: f32 = 0.9;

/// Keypoints of the first view with their counterparts in the second: mutual best matches of the same level within a
/// window, whose change of orientation is like the others'.
pub(super) fn match_views(
    first: &FrameFeatures,
    second: &FrameFeatures,
    radius_px: f64,
) -> Vec<(usize, usize)> {
    let mut claims: Vec<Option<(u32, usize)>> = vec![None; second.len()];
    let mut chosen: Vec<Option<usize>> = vec![None; first.len()];
    for (first_idx, pixel) in first.undistorted.iter().enumerate() {
        let octave = first.keypoints[first_idx].octave;
        let (mut best, mut runner_up) = ((u32::MAX, usize::MAX), u32::MAX);
        let (x, y, radius) = (pixel.x as f32, pixel.y as f32, radius_px as f32);
        second.grid.for_each_in_window(x, y, radius, octave..=octave, |idx| {
            let idx = idx as usize;
            let distance = first.descriptors[first_idx].distance(&second.descriptors[idx]);
            if distance < best.0 {
                runner_up = best.0;
                best = (distance, idx);
            } else if distance < runner_up {
                runner_up = distance;
            }
        });
        if best.0 <= STRICT_DISTANCE && best.0 as f32 <= RATIO * runner_up as f32 {
            chosen[first_idx] = Some(best.1);
            if claims[best.1].is_none_or(|(distance, _)| best.0 < distance) {
                claims[best.1] = Some((best.0, first_idx));
            }
        }
    }
    let pairs: Vec<(usize, usize)> = claims
        .iter()
        .enumerate()
        .filter_map(|(second_idx, claim)| claim.map(|(_, first_idx)| (first_idx, second_idx)))
        .filter(|(first_idx, second_idx)| chosen[*first_idx] == Some(*second_idx))
        .collect();
    let change = |(a, b): &(usize, usize)| second.keypoints[*b].angle - first.keypoints[*a].angle;
    let mut rotation = RotationConsistency::new();
    pairs.iter().for_each(|pair| rotation.add(change(pair)));
    let dominant = rotation.dominant();
    pairs.into_iter().filter(|pair| dominant.accepts(change(pair))).collect()
}
