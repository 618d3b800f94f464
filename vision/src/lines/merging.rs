//! Line merging (line fusion in the image): joining pieces of one edge.

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
    /// Largest distance of the shorter one's endpoints from the longer one's line, pixels. Default 1.5:
    /// parallel double edges, as of a door's frame, lie further apart.
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

/// Merges until nothing merges any more. `image` decides whether gaps show an edge. Segments that are not
/// finite stay as they are.
pub fn merge_collinear(image: &GrayImage, segments: &[Segment], config: &LineMergeConfig) -> MergedLines {
    let probe = EdgeProbe::new(Sampler::new(image), &config.support);
    let (mut pieces, nonsense): (Vec<Piece>, Vec<Piece>) =
        segments.iter().enumerate().map(Piece::new).partition(|piece| piece.segment.is_finite());
    // Each of `pieces` that was merged away points to the one it went into.
    let mut parent: Vec<usize> = (0..segments.len()).collect();
    while merge_once(&mut pieces, &mut parent, &probe, config) {}
    pieces.extend(nonsense);
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

/// The segment that a uniform distribution over both has as its main axis: their second moments are added
/// exactly, no pixel is looked at. It reaches from the first to the last of the four endpoints, directed as
/// the longer one.
pub fn merge_pair(a: &Segment, b: &Segment) -> Segment {
    let (length_a, length_b) = (a.length(), b.length());
    let total = length_a + length_b;
    if !(total > 0.0 && total.is_finite()) {
        return *a;
    }
    let center = (a.midpoint() * length_a + b.midpoint() * length_b) / total;
    let mut scatter = Scatter::default();
    for (segment, length) in [(a, length_a), (b, length_b)] {
        scatter.add(segment.midpoint() - center, length);
        scatter.add(segment.direction(), length.powi(3) / 12.0);
    }
    let longer = if length_a >= length_b { a } else { b };
    let (direction, across) = scatter.main_axis(longer.direction());
    let along = [a.start, a.end, b.start, b.end].map(|pixel| direction.dot(&(pixel - center)));
    let (first, last) =
        along.iter().fold((f32::MAX, f32::MIN), |(first, last), &t| (first.min(t), last.max(t)));
    let mean = |value_a: f32, value_b: f32| (value_a * length_a + value_b * length_b) / total;
    let merged = Segment {
        start: center + direction * first,
        end: center + direction * last,
        sigma_px: (mean(a.sigma_px.powi(2), b.sigma_px.powi(2)) + across / total).sqrt(),
        gradient: mean(a.gradient, b.gradient),
    };
    if merged.is_finite() { merged } else { *longer }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(start: (f32, f32), end: (f32, f32)) -> Segment {
        let vector = |(x, y)| Vector2::new(x, y);
        Segment { start: vector(start), end: vector(end), sigma_px: 0.3, gradient: 30.0 }
    }

    /// Bright below row 50, from column `from` on.
    fn edge_image(from: u32) -> GrayImage {
        GrayImage::from_fn(200, 100, |x, y| if y > 50 && x >= from { 160 } else { 90 })
    }

    fn merged(image: &GrayImage, segments: &[Segment]) -> MergedLines {
        merge_collinear(image, segments, &LineMergeConfig::default())
    }

    #[test]
    fn moments_are_those_of_many_points() {
        let (a, b) = (segment((10.0, 20.0), (50.0, 22.0)), segment((55.0, 22.0), (75.0, 24.0)));
        let points: Vec<Vector2<f64>> = [(a, 4000), (b, 2000)]
            .into_iter()
            .flat_map(|(s, n)| (0..n).map(move |i| s.start + s.vector() * ((i as f32 + 0.5) / n as f32)))
            .map(|point| point.cast())
            .collect();
        let mean: Vector2<f64> = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
        let scatter: nalgebra::Matrix2<f64> =
            points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
        let eigen = nalgebra::SymmetricEigen::new(scatter);
        let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let merged = merge_pair(&a, &b);
        // The lengths are 40.05 and 20.1, not quite as 2 to 1.
        assert!(merged.direction().cast::<f64>().perp(&axis).abs() < 1e-4);
        assert!(merged.distance(&mean.cast()).abs() < 0.01);
        assert!((merged.start - a.start).norm() < 0.5 && (merged.end - b.end).norm() < 0.5);
        assert!(merged.sigma_px >= 0.3);
    }

    #[test]
    fn fragments_of_one_edge_merge() {
        let image = edge_image(0);
        let pieces = [
            segment((80.0, 50.4), (120.0, 50.6)),
            segment((20.0, 50.5), (74.0, 50.5)),
            segment((126.0, 50.7), (180.0, 50.5)),
        ];
        let merged = merged(&image, &pieces);
        assert_eq!(merged.merged_idx, [0, 0, 0]);
        let line = merged.segments[0];
        assert!((line.start - Vector2::new(20.0, 50.5)).norm() < 0.5, "{line:?}");
        assert!((line.end - Vector2::new(180.0, 50.5)).norm() < 0.5, "{line:?}");
    }

    #[test]
    fn different_edges_stay_apart() {
        let image = edge_image(0);
        let long = segment((20.0, 50.5), (120.0, 50.5));
        for (name, other) in [
            ("a parallel double edge", segment((20.0, 53.0), (120.0, 53.0))),
            ("the other bright side", segment((120.0, 51.0), (20.0, 51.0))),
            ("another direction", segment((122.0, 50.5), (180.0, 54.5))),
            ("too far on", segment((160.0, 50.5), (190.0, 50.5))),
        ] {
            let merged = merged(&image, &[long, other]);
            assert_eq!(
                (merged.segments.as_slice(), merged.merged_idx.as_slice()),
                (&[long, other][..], &[0, 1][..]),
                "{name}"
            );
        }
    }

    #[test]
    fn a_gap_needs_an_edge_in_it() {
        let pieces = [segment((20.0, 50.5), (90.0, 50.5)), segment((99.0, 50.5), (180.0, 50.5))];
        assert_eq!(merged(&edge_image(0), &pieces).segments.len(), 1);
        let interrupted =
            GrayImage::from_fn(200, 100, |x, y| if y > 50 && !(90..99).contains(&x) { 160 } else { 90 });
        assert_eq!(merged(&interrupted, &pieces).segments.len(), 2);
    }

    #[test]
    fn angles_wrap_around_and_nonsense_stays() {
        let image = GrayImage::from_fn(200, 100, |_, y| if y < 50 { 160 } else { 90 });
        let nonsense = segment((f32::NAN, 0.0), (f32::INFINITY, 4.0));
        let pieces = [
            segment((100.0, 49.4), (30.0, 49.6)),
            nonsense,
            segment((180.0, 49.6), (105.0, 49.5)),
            segment((5.0, 5.0), (5.0, 5.0)),
        ];
        let merged = merged(&image, &pieces);
        assert_eq!(merged.merged_idx, [0, 1, 0, 2]);
        assert!((merged.segments[0].length() - 150.0).abs() < 0.5);
        assert!(super::merge_collinear(&image, &[], &LineMergeConfig::default()).segments.is_empty());
    }
}
