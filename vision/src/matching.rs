//! Matching descriptors: in a list, in a window, or all against all.

use crate::{Descriptor, Features, KeypointGrid};

/// Descriptors further apart than this are not the same point (strict), bits of 256.
pub const STRICT_DISTANCE: u32 = 50;
/// As [`STRICT_DISTANCE`], where geometry already says much (loose), bits of 256.
pub const LOOSE_DISTANCE: u32 = 100;

/// Two keypoints that look alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DescriptorMatch {
    /// Index into the first set.
    pub first_idx: u32,
    /// Index into the second set.
    pub second_idx: u32,
    /// Hamming distance, bits of 256.
    pub distance: u32,
}

/// The nearest descriptor of a list, and how near the next one is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BestTwo {
    /// Index of the nearest.
    pub best_idx: u32,
    /// Its distance, bits.
    pub best: u32,
    /// Index of the second nearest, if the list has two.
    pub second_idx: Option<u32>,
    /// Its distance, bits; `u32::MAX` if the list has one only.
    pub second: u32,
}

impl BestTwo {
    /// Whether the best is clearly better than the second: `best < ratio * second`. A lone candidate passes.
    pub fn passes_ratio(&self, ratio: f32) -> bool {
        self.second == u32::MAX || (self.best as f32) < ratio * self.second as f32
    }
}

/// The two of `candidates` (indices into `descriptors`) nearest to `query`; the first listed wins a tie.
/// `None` if the list is empty. Panics if a candidate is out of range.
pub fn best_two(query: &Descriptor, descriptors: &[Descriptor], candidates: &[u32]) -> Option<BestTwo> {
    let mut best = BestTwo { best_idx: u32::MAX, best: u32::MAX, second_idx: None, second: u32::MAX };
    for &idx in candidates {
        let distance = query.distance(&descriptors[idx as usize]);
        if distance < best.best {
            if best.best_idx != u32::MAX {
                (best.second_idx, best.second) = (Some(best.best_idx), best.best);
            }
            (best.best_idx, best.best) = (idx, distance);
        } else if distance < best.second {
            (best.second_idx, best.second) = (Some(idx), distance);
        }
    }
    (best.best_idx != u32::MAX).then_some(best)
}

/// What makes two keypoints a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchConfig {
    /// Largest Hamming distance, bits. Default 50.
    pub max_distance: u32,
    /// The best must be below this share of the second best. Default 0.9.
    pub ratio: f32,
    /// Keep only matches whose change of orientation is among the common ones ([`RotationConsistency`]). Default true.
    pub check_rotation: bool,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self { max_distance: STRICT_DISTANCE, ratio: 0.9, check_rotation: true }
    }
}

/// Matches within a window around where each point was, at the finest level only, for initialisation.
///
/// `expected` holds, for each keypoint of `first`, where it is looked for in `second` (usually where it was, or where
/// its match of the frame before was); `second_grid` is built over `second`. Matches are mutual and in the order of
/// `first`. Points of `first` above octave 0 and points with an `expected` that is not finite find no match.
pub fn match_in_window(
    first: &Features,
    expected: &[(f32, f32)],
    second: &Features,
    second_grid: &KeypointGrid,
    radius_px: f32,
    config: &MatchConfig,
) -> Vec<DescriptorMatch> {
    // For each keypoint of `second`: the nearest of `first` that looked at it. Ties go to the earlier one.
    let mut claimed = vec![(u32::MAX, u32::MAX); second.len()];
    let mut chosen = Vec::new();
    let mut candidates = Vec::new();
    for (first_idx, (keypoint, &(x, y))) in first.keypoints.iter().zip(expected).enumerate() {
        if keypoint.octave > 0 {
            continue;
        }
        second_grid.query_window(x, y, radius_px, 0..=0, &mut candidates);
        let descriptor = &first.descriptors[first_idx];
        for &idx in &candidates {
            let distance = descriptor.distance(&second.descriptors[idx as usize]);
            let claim = &mut claimed[idx as usize];
            if distance < claim.0 {
                *claim = (distance, first_idx as u32);
            }
        }
        let Some(best) = best_two(descriptor, &second.descriptors, &candidates) else { continue };
        if best.best <= config.max_distance && best.passes_ratio(config.ratio) {
            chosen.push(DescriptorMatch {
                first_idx: first_idx as u32,
                second_idx: best.best_idx,
                distance: best.best,
            });
        }
    }
    chosen.retain(|m| claimed[m.second_idx as usize].1 == m.first_idx);
    keep_consistent(&mut chosen, first, second, config);
    chosen
}

/// Compares all with all and keeps mutual best matches that pass `config`, in the order of `first`.
pub fn match_brute_force(first: &Features, second: &Features, config: &MatchConfig) -> Vec<DescriptorMatch> {
    let mut nearest_of_second = vec![(u32::MAX, u32::MAX); second.len()];
    let mut chosen = Vec::new();
    for (first_idx, descriptor) in first.descriptors.iter().enumerate() {
        let mut best = BestTwo { best_idx: u32::MAX, best: u32::MAX, second_idx: None, second: u32::MAX };
        for (idx, (other, nearest)) in second.descriptors.iter().zip(&mut nearest_of_second).enumerate() {
            let distance = descriptor.distance(other);
            if distance < nearest.0 {
                *nearest = (distance, first_idx as u32);
            }
            if distance < best.best {
                best.second = best.best;
                (best.best_idx, best.best) = (idx as u32, distance);
            } else if distance < best.second {
                best.second = distance;
            }
        }
        if best.best_idx != u32::MAX && best.best <= config.max_distance && best.passes_ratio(config.ratio) {
            let (second_idx, distance) = (best.best_idx, best.best);
            chosen.push(DescriptorMatch { first_idx: first_idx as u32, second_idx, distance });
        }
    }
    chosen.retain(|m| nearest_of_second[m.second_idx as usize].1 == m.first_idx);
    keep_consistent(&mut chosen, first, second, config);
    chosen
}

fn keep_consistent(
    matches: &mut Vec<DescriptorMatch>,
    first: &Features,
    second: &Features,
    config: &MatchConfig,
) {
    if !config.check_rotation {
        return;
    }
    let change = |m: &DescriptorMatch| {
        second.keypoints[m.second_idx as usize].angle - first.keypoints[m.first_idx as usize].angle
    };
    let mut rotation = RotationConsistency::new();
    for m in matches.iter() {
        rotation.add(change(m));
    }
    let kept = rotation.dominant();
    matches.retain(|m| kept.accepts(change(m)));
}

/// Cells of the histogram of orientation changes: 12 degrees each.
const N_ROTATION_BINS: usize = 30;
/// How many of the tallest cells are kept.
const N_KEPT_BINS: usize = 3;
/// A second or third cell below this share of the tallest is not kept: it holds chance matches only.
const MIN_SHARE_OF_TALLEST: f32 = 0.1;

/// Finds the common changes of orientation among matches: a camera that rolls turns all keypoints alike.
#[derive(Clone, Debug, Default)]
pub struct RotationConsistency {
    counts: [u32; N_ROTATION_BINS],
}

/// The changes of orientation found to be common by a [`RotationConsistency`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DominantRotations {
    kept: [bool; N_ROTATION_BINS],
}

impl RotationConsistency {
    /// An empty histogram.
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts a change of orientation, radians, of any size. One that is not finite is not counted.
    pub fn add(&mut self, change: f32) {
        if let Some(bin) = rotation_bin(change) {
            self.counts[bin] += 1;
        }
    }

    /// The three tallest cells (those above a tenth of the tallest).
    pub fn dominant(&self) -> DominantRotations {
        let mut order: [usize; N_ROTATION_BINS] = std::array::from_fn(|bin| bin);
        order.sort_by_key(|&bin| (std::cmp::Reverse(self.counts[bin]), bin));
        let tallest = self.counts[order[0]] as f32;
        let mut kept = [false; N_ROTATION_BINS];
        for &bin in &order[..N_KEPT_BINS] {
            let count = self.counts[bin];
            kept[bin] = count > 0 && count as f32 >= MIN_SHARE_OF_TALLEST * tallest;
        }
        DominantRotations { kept }
    }
}

impl DominantRotations {
    /// Whether a change of orientation, radians, is one of the common ones.
    pub fn accepts(&self, change: f32) -> bool {
        rotation_bin(change).is_some_and(|bin| self.kept[bin])
    }
}

/// The cell of a change, centred so that no rotation falls in the middle of cell 0.
fn rotation_bin(change: f32) -> Option<usize> {
    let turns = change / std::f32::consts::TAU;
    let bins = (turns - turns.floor()) * N_ROTATION_BINS as f32;
    bins.is_finite().then(|| bins.round() as usize % N_ROTATION_BINS)
}
