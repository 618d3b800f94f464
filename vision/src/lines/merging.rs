//! Joining pieces of one edge.

use nalgebra::Vector2;

use super::Segment;
use super::moments::Scatter;
use super::sampling::Sampler;
use super::support::{EdgeProbe, EdgeSupportConfig};
use crate::GrayImage;

/// When two segments are pieces of one edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMergeConfig {
    /// Largest angle between their directions, bright sides included, radians. Default 2 degrees.
    pub max_angle: f32,
    /// Largest distance of the shorter one's endpoints from the longer one's line, pixels. Default 1.5: parallel double
    /// edges, as of a door's frame, lie further apart.
    pub max_offset_px: f32,
    /// Largest gap between them, pixels. Default 10.
    pub max_gap_px: f32,
    /// A gap of up to this share of both together is allowed too. Default 0.15.
    pub max_gap_share: f32,
    /// What the gap must show of an edge.
    pub support: EdgeSupportConfig,
}

impl Default for LineMergeConfig {
    fn default() -> Self {
        Self {
            max_angle: 2f32.to_radians(),
            max_offset_px: 1.5,
            max_gap_px: 10.0,
            max_gap_share: 0.15,
            support: EdgeSupportConfig::default(),
        }
    }
}

/// Gaps shorter than this are not looked at, pixels: endpoints are no more exact.
const MIN_CHECKED_GAP_PX: f32 = 3.0;

/// What became of a set of segments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergedLines {
    /// The segments after merging, in the order of their first pieces.
    pub segments: Vec<Segment>,
    /// For each segment given, which of `segments` it is or became part of.
    pub merged_idx: Vec<u32>,
}

/// Merges until nothing merges any more. `image` decides whether gaps show an edge. Segments that are not finite stay
/// as they are.
pub fn merge_collinear(image: &GrayImage, segments: &[Segment], config: &LineMergeConfig) -> MergedLines {
    let probe = EdgeProbe::new(Sampler::new(image), &config.support);
    let mut pieces: Vec<Piece> = segments.iter().enumerate().map(Piece::new).collect();
    // Each of `pieces` that was merged away points to the one it went into.
    let mut parent: Vec<usize> = (0..segments.len()).collect();
    while merge_once(&mut pieces, &mut parent, &probe, config) {}
    pieces.sort_unstable_by_key(|piece| piece.index);
    let mut merged_idx = vec![0; segments.len()];
    for (merged, piece) in pieces.iter().enumerate() {
        merged_idx[piece.index] = merged as u32;
    }
    // Parents have lower indices than what went into them.
    for index in 0..segments.len() {
        merged_idx[index] = merged_idx[parent[index]];
    }
    MergedLines { segments: pieces.into_iter().map(|piece| piece.segment).collect(), merged_idx }
}

/// A segment with what the comparison of many needs.
#[derive(Clone, Copy)]
struct Piece {
    /// The lowest index among the segments it consists of.
    index: usize,
    segment: Segment,
    /// Of its direction, radians.
    angle: f32,
}

impl Piece {
    fn new((index, segment): (usize, &Segment)) -> Self {
        let vector = segment.vector();
        Self { index, segment: *segment, angle: vector.y.atan2(vector.x) }
    }
}

/// One pass in the order of angles. True if anything was merged.
fn merge_once(
    pieces: &mut Vec<Piece>,
    parent: &mut [usize],
    probe: &EdgeProbe,
    config: &LineMergeConfig,
) -> bool {
    pieces.sort_unstable_by(|a, b| a.angle.total_cmp(&b.angle).then(a.index.cmp(&b.index)));
    let n = pieces.len();
    let mut gone = vec![false; n];
    for i in 0..n {
        // Angles wrap around: from the last on, comparing goes on with the first.
        for step in 1..n {
            let j = (i + step) % n;
            let turn =
                pieces[j].angle - pieces[i].angle + if i + step >= n { std::f32::consts::TAU } else { 0.0 };
            if turn.is_nan() || turn > config.max_angle {
                break;
            }
            if gone[i] || gone[j] || !belong_together(&pieces[i].segment, &pieces[j].segment, probe, config) {
                continue;
            }
            let merged = merge_pair(&pieces[i].segment, &pieces[j].segment);
            let (kept, absorbed) =
                (pieces[i].index.min(pieces[j].index), pieces[i].index.max(pieces[j].index));
            parent.iter_mut().filter(|p| **p == absorbed).for_each(|p| *p = kept);
            pieces[i] = Piece { angle: pieces[i].angle, ..Piece::new((kept, &merged)) };
            gone[j] = true;
        }
    }
    let mut position = 0;
    pieces.retain(|_| {
        position += 1;
        !gone[position - 1]
    });
    let merged_any = pieces.len() < n;
    pieces.iter_mut().for_each(|piece| *piece = Piece::new((piece.index, &piece.segment)));
    merged_any
}

/// Whether two segments are pieces of one edge.
pub(super) fn belong_together(a: &Segment, b: &Segment, probe: &EdgeProbe, config: &LineMergeConfig) -> bool {
    let (long, short) = if a.length() >= b.length() { (a, b) } else { (b, a) };
    let direction = long.direction();
    let cosine = direction.dot(&short.direction());
    if cosine.is_nan() || cosine < config.max_angle.cos() {
        return false;
    }
    let is_near = |pixel: &Vector2<f32>| long.distance(pixel).abs() <= config.max_offset_px;
    if !(is_near(&short.start) && is_near(&short.end)) {
        return false;
    }
    let along = |pixel: &Vector2<f32>| direction.dot(&(pixel - long.start));
    let (first, last) = (along(&short.start), along(&short.end));
    // Negative if they overlap.
    let gap = (first - long.length()).max(-last);
    let total = last.max(long.length()) - first.min(0.0);
    if gap.is_nan() || gap > config.max_gap_px.max(config.max_gap_share * total) {
        return false;
    }
    if gap < MIN_CHECKED_GAP_PX {
        return true;
    }
    let (from, to) = if last < 0.0 { (short.end, long.start) } else { (long.end, short.start) };
    probe.support(from, to, long.normal()).share >= config.support.min_share
}

/// The segment that a uniform distribution over both has as its main axis: their second moments are added exactly, no
/// pixel is looked at. It reaches from the first to the last of the four endpoints, directed as the longer one.
pub fn merge_pair(a: &Segment, b: &Segment) -> Segment {
    let (length_a, length_b) = (a.length(), b.length());
    let total = length_a + length_b;
    if !(total > 0.0 && total.is_finite()) {
        return *a;
    }
    let centre = (a.midpoint() * length_a + b.midpoint() * length_b) / total;
    let mut scatter = Scatter::default();
    for (segment, length) in [(a, length_a), (b, length_b)] {
        scatter.add(segment.midpoint() - centre, length);
        scatter.add(segment.direction(), length.powi(3) / 12.0);
    }
    let longer = if length_a >= length_b { a } else { b };
    let (direction, across) = scatter.main_axis(longer.direction());
    let along = [a.start, a.end, b.start, b.end].map(|pixel| direction.dot(&(pixel - centre)));
    let (first, last) =
        along.iter().fold((f32::MAX, f32::MIN), |(first, last), &t| (first.min(t), last.max(t)));
    let mean = |value_a: f32, value_b: f32| (value_a * length_a + value_b * length_b) / total;
    let merged = Segment {
        start: centre + direction * first,
        end: centre + direction * last,
        sigma_px: (mean(a.sigma_px.powi(2), b.sigma_px.powi(2)) + across / total).sqrt(),
        gradient: mean(a.gradient, b.gradient),
    };
    if merged.is_finite() { merged } else { *longer }
}
