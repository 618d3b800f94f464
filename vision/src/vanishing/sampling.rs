//! Hypotheses for vanishing points, directions worth trying: where the planes of two segments meet.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::plane::SegmentPlane;

/// The sine of one degree: planes nearer to parallel than this do not say where they meet. Takes out pairs on
/// one image line.
const MIN_SIN_BETWEEN_PLANES: f64 = 0.017_45;
/// Half: planes at over 60 degrees rarely belong to parallel lines, unless the vanishing point is in the
/// image.
const SIMILAR_COS: f64 = 0.5;
/// How often a pair of dissimilar planes is tried all the same.
const DISSIMILAR_SHARE: f64 = 0.5;
/// Draws per hypothesis wanted, after which fewer hypotheses have to do.
const MAX_DRAWS_PER_HYPOTHESIS: usize = 4;

/// Adds directions from random pairs of segments to `out` until it has `n_wanted`, or the pairs are no good.
///
/// Long segments are drawn more often, in proportion to their length. `cumulative` is a buffer.
pub(super) fn sample_pairs(
    planes: &[SegmentPlane],
    n_wanted: usize,
    rng: &mut ChaCha8Rng,
    cumulative: &mut Vec<f64>,
    out: &mut Vec<Vector3<f64>>,
) {
    if planes.len() < 2 {
        return;
    }
    cumulative.clear();
    cumulative.extend(planes.iter().scan(0.0, |sum, plane| {
        *sum += plane.length_rad();
        Some(*sum)
    }));
    let total = cumulative[planes.len() - 1];
    let draw = |rng: &mut ChaCha8Rng| {
        let at = rng.random::<f64>() * total;
        &planes[cumulative.partition_point(|&sum| sum <= at).min(planes.len() - 1)]
    };
    for _ in 0..n_wanted.saturating_sub(out.len()) * MAX_DRAWS_PER_HYPOTHESIS {
        if out.len() >= n_wanted {
            break;
        }
        let (a, b) = (draw(rng), draw(rng));
        let is_similar = a.normal().dot(b.normal()).abs() >= SIMILAR_COS;
        if !is_similar && !rng.random_bool(DISSIMILAR_SHARE) {
            continue;
        }
        let meeting = a.normal().cross(b.normal());
        let sin = meeting.norm();
        if sin >= MIN_SIN_BETWEEN_PLANES {
            out.push(meeting / sin);
        }
    }
}
