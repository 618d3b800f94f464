//! Descriptor matching: in a list, or all against all (brute force), by Hamming distance and the ratio test
//! [Lowe 2004].

use crate::{Descriptor, Features, vectorized};

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

/// Distance and index of the nearest of `candidates`, the first if there are several, and the distance of the
/// next; `u32::MAX` and `usize::MAX` for what is not there.
#[inline]
pub fn nearest_two<'a>(
    query: &Descriptor,
    candidates: impl Iterator<Item = (usize, &'a Descriptor)>,
) -> ((u32, usize), u32) {
    vectorized(
        #[inline(always)]
        || {
            let (mut best, mut second) = ((u32::MAX, usize::MAX), u32::MAX);
            for (idx, candidate) in candidates {
                let distance = query.distance(candidate);
                if distance < best.0 {
                    second = best.0;
                    best = (distance, idx);
                } else if distance < second {
                    second = distance;
                }
            }
            (best, second)
        },
    )
}

/// What makes two keypoints a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchConfig {
    /// Largest Hamming distance, bits. Default 50.
    pub max_distance: u32,
    /// The best must be below this share of the second best. Default 0.9.
    pub ratio: f32,
    /// Keep only matches whose change of orientation is among the common ones ([`RotationConsistency`]).
    /// Default true.
    pub check_rotation: bool,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self { max_distance: STRICT_DISTANCE, ratio: 0.9, check_rotation: true }
    }
}

/// Compares all with all and keeps mutual best matches that pass `config`, in the order of `first`.
pub fn match_brute_force(first: &Features, second: &Features, config: &MatchConfig) -> Vec<DescriptorMatch> {
    let nearest = |query: &Descriptor, of: &Features| nearest_two(query, of.descriptors.iter().enumerate());
    let mut chosen = Vec::new();
    for (first_idx, descriptor) in first.descriptors.iter().enumerate() {
        let ((distance, second_idx), runner_up) = nearest(descriptor, second);
        // A lone candidate passes the ratio test.
        let is_clear = runner_up == u32::MAX || (distance as f32) < config.ratio * runner_up as f32;
        let is_match = distance <= config.max_distance && is_clear;
        if is_match && nearest(&second.descriptors[second_idx], first).0.1 == first_idx {
            let (first_idx, second_idx) = (first_idx as u32, second_idx as u32);
            chosen.push(DescriptorMatch { first_idx, second_idx, distance });
        }
    }
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

/// The cell of a change, centered so that no rotation falls in the middle of cell 0.
fn rotation_bin(change: f32) -> Option<usize> {
    let turns = change / std::f32::consts::TAU;
    let bins = (turns - turns.floor()) * N_ROTATION_BINS as f32;
    bins.is_finite().then(|| bins.round() as usize % N_ROTATION_BINS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Keypoint;
    use crate::test_images::Random;

    fn random_features(random: &mut Random, n: usize) -> Features {
        let mut features = Features::default();
        for _ in 0..n {
            features.keypoints.push(Keypoint {
                x: random.unit() * 640.0,
                y: random.unit() * 480.0,
                octave: random.below(3) as u8,
                angle: random.unit() * std::f32::consts::TAU,
                response: 20.0,
            });
            let word = |random: &mut Random| u64::from(random.bits()) << 32 | u64::from(random.bits());
            features.descriptors.push(Descriptor(std::array::from_fn(|_| word(random))));
        }
        features
    }

    /// The same features in reverse order, moved and turned, with a few bits flipped.
    fn seen_again(random: &mut Random, features: &Features, dx: f32, turn: f32) -> Features {
        let mut again = features.clone();
        again.keypoints.reverse();
        again.descriptors.reverse();
        for k in &mut again.keypoints {
            k.x += dx;
            k.angle = (k.angle + turn).rem_euclid(std::f32::consts::TAU);
        }
        for d in &mut again.descriptors {
            (0..12).for_each(|_| d.0[random.below(4) as usize] ^= 1 << random.below(64));
        }
        again
    }

    #[test]
    fn the_nearest_two_are_those_of_a_sorted_list() {
        let mut random = Random::new(1);
        let features = random_features(&mut random, 100);
        for query in &features.descriptors[..20] {
            let kept: Vec<usize> = (20..100).filter(|_| random.below(4) == 0).collect();
            let mut sorted: Vec<(u32, usize)> =
                kept.iter().map(|&i| (query.distance(&features.descriptors[i]), i)).collect();
            sorted.sort_unstable();
            let candidates = kept.iter().map(|&i| (i, &features.descriptors[i]));
            assert_eq!(nearest_two(query, candidates), (sorted[0], sorted[1].0));
        }
        let query = &features.descriptors[0];
        assert_eq!(nearest_two(query, std::iter::empty()), ((u32::MAX, usize::MAX), u32::MAX));
        let lone = std::iter::once((7, query));
        assert_eq!(nearest_two(query, lone), ((0, 7), u32::MAX));
    }

    #[test]
    fn all_against_all_finds_each_feature_again() {
        let mut random = Random::new(2);
        let first = random_features(&mut random, 300);
        let second = seen_again(&mut random, &first, 500.0, 1.0);
        let found = match_brute_force(&first, &second, &MatchConfig::default());
        assert_eq!(found.len(), 300);
        assert!(found.iter().all(|m| m.first_idx + m.second_idx == 299 && m.distance <= 12));
        assert!(match_brute_force(&first, &Features::default(), &MatchConfig::default()).is_empty());
        assert!(match_brute_force(&Features::default(), &second, &MatchConfig::default()).is_empty());
    }

    #[test]
    fn a_repeated_feature_is_ambiguous_and_matches_are_mutual() {
        let mut random = Random::new(3);
        let first = random_features(&mut random, 2);
        let mut second = first.clone();
        second.keypoints.push(first.keypoints[0]);
        second.descriptors.push(first.descriptors[0]);
        // Distance 0 is not below 0.9 * 0.
        let found = match_brute_force(&first, &second, &MatchConfig::default());
        assert_eq!(found, [DescriptorMatch { first_idx: 1, second_idx: 1, distance: 0 }]);
        // Two features of the first set want the same one of the second: the nearer gets it.
        let mut first = first;
        first.keypoints.push(first.keypoints[1]);
        first.descriptors.push(Descriptor(first.descriptors[1].0.map(|word| word ^ 1)));
        let found = match_brute_force(&first, &second, &MatchConfig::default());
        assert_eq!(found, [DescriptorMatch { first_idx: 1, second_idx: 1, distance: 0 }]);
    }

    #[test]
    fn the_common_turns_are_kept() {
        let mut rotation = RotationConsistency::new();
        let degrees = |d: f32| d.to_radians();
        // Around zero from both sides, whatever the number of whole turns: one cell.
        for d in [-5.0, 3.0, 364.0, -358.0, 1.0, 0.0, 2.0, -1.0, 4.0, 5.0, 721.0, -2.0] {
            rotation.add(degrees(d));
        }
        (0..3).for_each(|_| rotation.add(degrees(120.0)));
        (0..2).for_each(|_| rotation.add(degrees(240.0)));
        rotation.add(degrees(180.0));
        rotation.add(f32::NAN);
        let kept = rotation.dominant();
        for d in [0.0, 359.0, -3.0, 120.0, 240.0] {
            assert!(kept.accepts(degrees(d)), "{d}");
        }
        for d in [60.0, 180.0] {
            assert!(!kept.accepts(degrees(d)), "{d}");
        }
        assert!(!kept.accepts(f32::NAN) && !kept.accepts(f32::INFINITY));
        assert!(!RotationConsistency::new().dominant().accepts(0.0));
    }
}
