//! Matching two views before anything is known of the motion between them.

use crate::features::FrameFeatures;
use vision::matching::{RotationConsistency, STRICT_DISTANCE, nearest_two};

/// Best match's distance as a share of the second best's. [method: Two-view initialization]
const RATIO: f32 = 0.9;

/// Keypoints of the first view with their counterparts in the second: mutual best matches of the same level
/// within a window, whose change of orientation is like the others'.
pub(super) fn match_views(
    first: &FrameFeatures,
    second: &FrameFeatures,
    radius_px: f64,
) -> Vec<(usize, usize)> {
    let mut claims: Vec<Option<(u32, usize)>> = vec![None; second.len()];
    let mut chosen: Vec<Option<usize>> = vec![None; first.len()];
    let levels = Levels::of(second);
    for (first_idx, pixel) in first.undistorted.iter().enumerate() {
        let (x, y, radius) = (pixel.x as f32, pixel.y as f32, radius_px as f32);
        let is_near = |entry: &&LevelEntry| (entry.x - x).abs() <= radius && (entry.y - y).abs() <= radius;
        let described = |entry: &LevelEntry| (entry.idx as usize, &second.descriptors[entry.idx as usize]);
        let entries = levels.entries(first.keypoints[first_idx].octave);
        let (best, runner_up) =
            nearest_two(&first.descriptors[first_idx], entries.iter().filter(is_near).map(described));
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

/// Keypoints sorted by level: a window of this size holds so many that scanning a level is quicker than a
/// grid.
struct Levels {
    by_octave: Vec<Vec<LevelEntry>>,
}

#[derive(Clone, Copy)]
struct LevelEntry {
    x: f32,
    y: f32,
    idx: u32,
}

impl Levels {
    fn of(features: &FrameFeatures) -> Self {
        let mut by_octave = vec![Vec::new(); usize::from(features.pyramid.n_levels)];
        for (idx, (keypoint, pixel)) in features.keypoints.iter().zip(&features.undistorted).enumerate() {
            if let Some(level) = by_octave.get_mut(usize::from(keypoint.octave)) {
                level.push(LevelEntry { x: pixel.x as f32, y: pixel.y as f32, idx: idx as u32 });
            }
        }
        Self { by_octave }
    }

    fn entries(&self, octave: u8) -> &[LevelEntry] {
        self.by_octave.get(usize::from(octave)).map_or(&[], Vec::as_slice)
    }
}
