//! Line matching, which segment of one image is which of another: geometry first, then descriptors.

use nalgebra::Vector2;

use super::Segment;
use crate::Descriptor;
use crate::matching::DescriptorMatch;

/// How far two segments may lie apart to be compared at all. Descriptors alone are weak on repeated
/// structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineGates {
    /// Largest angle between their directions, bright sides included, radians.
    pub max_angle: f32,
    /// Largest distance across, of the second's midpoint from the first's line or the other way round,
    /// pixels.
    pub max_offset_px: f32,
    /// Largest distance of midpoints, pixels.
    pub max_midpoint_distance_px: f32,
    /// Least length that both cover, projected on the first, as a share of the shorter one's length. Negative
    /// allows a gap of that share.
    pub min_overlap: f32,
}

impl LineGates {
    /// For a segment whose place is known to a few pixels across, and little along: the same edge may be cut
    /// elsewhere.
    pub const PREDICTED: Self =
        Self { max_angle: 0.1, max_offset_px: 3.0, max_midpoint_distance_px: 200.0, min_overlap: 0.5 };

    /// For segments of neighboring images of which nothing else is known (values as UV-SLAM has them:
    /// endpoints move up to 30 px, midpoints up to 50 px, 10 degrees).
    pub const NEIGHBORING: Self =
        Self { max_angle: 0.17, max_offset_px: 30.0, max_midpoint_distance_px: 50.0, min_overlap: 0.3 };

    /// Whether the two may be the same.
    pub fn accept(&self, first: &Segment, second: &Segment) -> bool {
        let (first, second) = (Placed::new(first), Placed::new(second));
        self.accept_placed(&first, &second, self.max_angle.cos())
    }

    fn accept_placed(&self, first: &Placed, second: &Placed, min_cosine: f32) -> bool {
        let between = second.midpoint - first.midpoint;
        // Written so that what is not a number is refused.
        first.direction.dot(&second.direction) >= min_cosine
            && between.norm_squared() <= self.max_midpoint_distance_px.powi(2)
            && first.direction.perp(&between).abs() <= self.max_offset_px
            && second.direction.perp(&between).abs() <= self.max_offset_px
            && first.overlap(second) >= self.min_overlap * first.length.min(second.length)
    }
}

/// What makes two segments a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMatchConfig {
    /// How far apart they may lie.
    pub gates: LineGates,
    /// Largest Hamming distance, bits of 256. In drawn scenes the same edge lies at 4 to 18 bits after turns
    /// of 30 degrees or 10 % of scale, another edge at 83 on average.
    pub max_distance: u32,
    /// The best must be below this share of the second best, unless the two lie on one line: pieces of the
    /// same edge look alike.
    pub ratio: f32,
}

impl LineMatchConfig {
    /// For segments predicted into the image: geometry says most, so descriptors need only not disagree.
    pub const PREDICTED: Self = Self { gates: LineGates::PREDICTED, max_distance: 70, ratio: 0.95 };

    /// For neighboring images without a prediction.
    pub const NEIGHBORING: Self = Self { gates: LineGates::NEIGHBORING, max_distance: 45, ratio: 0.85 };
}

impl Default for LineMatchConfig {
    fn default() -> Self {
        Self::NEIGHBORING
    }
}

/// Two pieces are on one line if neither's midpoint is further than this from the other's line, pixels.
const SAME_LINE_OFFSET_PX: f32 = 3.0;
/// And their directions differ by no more than this (cosine of 3 degrees).
const SAME_LINE_COSINE: f32 = 0.998_63;

/// A segment's place, worked out once for many comparisons.
#[derive(Clone, Copy)]
struct Placed {
    midpoint: Vector2<f32>,
    direction: Vector2<f32>,
    length: f32,
}

impl Placed {
    fn new(segment: &Segment) -> Self {
        Self { midpoint: segment.midpoint(), direction: segment.direction(), length: segment.length() }
    }

    /// Length of this segment that `other`, projected on it, covers; negative if there is a gap.
    fn overlap(&self, other: &Self) -> f32 {
        let half = 0.5 * other.length * self.direction.dot(&other.direction).abs();
        let middle = self.direction.dot(&(other.midpoint - self.midpoint));
        let own_half = 0.5 * self.length;
        (middle + half).min(own_half) - (middle - half).max(-own_half)
    }

    fn on_one_line(&self, other: &Self) -> bool {
        let between = other.midpoint - self.midpoint;
        self.direction.dot(&other.direction) >= SAME_LINE_COSINE
            && self.direction.perp(&between).abs() <= SAME_LINE_OFFSET_PX
            && other.direction.perp(&between).abs() <= SAME_LINE_OFFSET_PX
    }
}

/// Segments and their descriptors, at equal indices.
#[derive(Clone, Copy, Debug)]
pub struct DescribedLines<'a> {
    /// Where, pixels.
    pub segments: &'a [Segment],
    /// What it looks like there. Segments without a descriptor are not matched.
    pub descriptors: &'a [Descriptor],
}

/// Matches that are the best for both sides, in the order of `first`; ties go to the lower index.
pub fn match_lines(
    first: DescribedLines,
    second: DescribedLines,
    config: &LineMatchConfig,
) -> Vec<DescriptorMatch> {
    let n = second.segments.len().min(second.descriptors.len());
    match_lines_lazily(first, &second.segments[..n], |index| second.descriptors[index], config)
}

/// [`match_lines`], where a segment of `second` is described when geometry lets it be compared: most are
/// near nothing.
pub(super) fn match_lines_lazily(
    first: DescribedLines,
    second: &[Segment],
    mut describe: impl FnMut(usize) -> Descriptor,
    config: &LineMatchConfig,
) -> Vec<DescriptorMatch> {
    let n_first = first.segments.len().min(first.descriptors.len());
    let first_placed: Vec<Placed> = first.segments[..n_first].iter().map(Placed::new).collect();
    let second_placed: Vec<Placed> = second.iter().map(Placed::new).collect();
    let min_cosine = config.gates.max_angle.cos();
    // For each of the second, the nearest of the first so far.
    let mut nearest = vec![(u32::MAX, u32::MAX); second_placed.len()];
    let mut matches = Vec::new();
    let mut candidates = Vec::new();
    for (first_idx, a) in first_placed.iter().enumerate() {
        candidates.clear();
        for (second_idx, b) in second_placed.iter().enumerate() {
            if config.gates.accept_placed(a, b, min_cosine) {
                let distance = first.descriptors[first_idx].distance(&describe(second_idx));
                nearest[second_idx] = nearest[second_idx].min((distance, first_idx as u32));
                candidates.push((distance, second_idx as u32));
            }
        }
        let Some(&(distance, second_idx)) = candidates.iter().min() else { continue };
        let best = &second_placed[second_idx as usize];
        let rival =
            candidates.iter().filter(|(_, idx)| !best.on_one_line(&second_placed[*idx as usize])).min();
        let clear = rival.is_none_or(|(rival, _)| (distance as f32) < config.ratio * *rival as f32);
        if distance <= config.max_distance && clear {
            matches.push(DescriptorMatch { first_idx: first_idx as u32, second_idx, distance });
        }
    }
    matches.retain(|found| nearest[found.second_idx as usize].1 == found.first_idx);
    matches
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(start: (f32, f32), end: (f32, f32)) -> Segment {
        let vector = |(x, y)| Vector2::new(x, y);
        Segment { start: vector(start), end: vector(end), sigma_px: 0.3, gradient: 30.0 }
    }

    /// A descriptor with the first `n` bits set.
    fn with_bits(n: u32) -> Descriptor {
        Descriptor(std::array::from_fn(|word| {
            (0..n.saturating_sub(64 * word as u32).min(64)).map(|bit| 1 << bit).sum()
        }))
    }

    fn matches(
        first: &[(Segment, u32)],
        second: &[(Segment, u32)],
        config: &LineMatchConfig,
    ) -> Vec<(u32, u32, u32)> {
        let split = |lines: &[(Segment, u32)]| -> (Vec<Segment>, Vec<Descriptor>) {
            lines.iter().map(|(segment, bits)| (*segment, with_bits(*bits))).unzip()
        };
        let (first, second) = (split(first), split(second));
        let lines = |(segments, descriptors)| DescribedLines { segments, descriptors };
        let found = match_lines(lines((&first.0, &first.1)), lines((&second.0, &second.1)), config);
        found.iter().map(|found| (found.first_idx, found.second_idx, found.distance)).collect()
    }

    #[test]
    fn gates_know_direction_offset_distance_and_overlap() {
        let gates = LineGates::PREDICTED;
        let long = segment((0.0, 0.0), (100.0, 0.0));
        assert!(gates.accept(&long, &segment((5.0, 1.0), (90.0, 2.0))));
        assert!(gates.accept(&long, &segment((80.0, 1.0), (120.0, 1.0))), "half of the shorter one overlaps");
        for (name, other) in [
            ("turned round", segment((100.0, 0.0), (0.0, 0.0))),
            ("another direction", segment((0.0, 0.0), (90.0, 12.0))),
            ("beside", segment((0.0, 4.0), (100.0, 4.0))),
            ("behind", segment((95.0, 0.0), (180.0, 0.0))),
            ("not a number", segment((f32::NAN, 0.0), (100.0, 0.0))),
            ("no length", segment((50.0, 0.0), (50.0, 0.0))),
        ] {
            assert!(!gates.accept(&long, &other) && !gates.accept(&other, &long), "{name}");
        }
    }

    #[test]
    fn matches_are_mutual_and_clear() {
        let config = LineMatchConfig::NEIGHBORING;
        let at = |y: f32| segment((10.0, y), (90.0, y));
        // Both of the first want the same; the one that looks more like it gets it.
        assert_eq!(matches(&[(at(0.0), 8), (at(9.0), 2)], &[(at(4.0), 0)], &config), [(1, 0, 2)]);
        // Two look alike: neither. Unless they are pieces of one line.
        assert_eq!(matches(&[(at(0.0), 40)], &[(at(5.0), 0), (at(-5.0), 1)], &config), []);
        let pieces = [(segment((10.0, 5.0), (60.0, 5.0)), 1), (segment((50.0, 5.0), (95.0, 5.0)), 0)];
        assert_eq!(matches(&[(at(0.0), 40)], &pieces, &config), [(0, 0, 39)]);
        assert_eq!(matches(&[(at(0.0), 90)], &[(at(5.0), 0)], &config), [], "too different");
        assert_eq!(matches(&[], &[(at(5.0), 0)], &config), []);
        assert_eq!(matches(&[(at(5.0), 0)], &[], &config), []);
    }
}
