//! Whether the image shows an edge where a segment is said to be.

use nalgebra::Vector2;

use super::Segment;
use super::sampling::Sampler;

/// Distance of the places looked at, pixels.
const SPACING_PX: f32 = 2.0;
/// Most places looked at, on any one stretch; longer ones are looked at further apart.
const MAX_PLACES: usize = 512;
/// Places whose gray levels are read at once.
const CHUNK: usize = 64;

/// When a place counts as lying on an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeSupportConfig {
    /// Least gradient towards the bright side, gray levels per pixel. Default 3: detectors start at 5, and a
    /// track may fade a little; the noise of a gradient is 1 to 1.5.
    pub min_gradient: f32,
    /// Largest angle between the gradient and the normal, radians. Default 22.5 degrees, the tolerance
    /// detectors use.
    pub max_angle: f32,
    /// Least share of supported places. Default 0.6.
    pub min_share: f32,
    /// The longest stretch without support in an edge, pixels: what lies beyond is no part of it. Default 10.
    pub max_hole_px: f32,
}

impl Default for EdgeSupportConfig {
    fn default() -> Self {
        Self { min_gradient: 3.0, max_angle: 22.5f32.to_radians(), min_share: 0.6, max_hole_px: 10.0 }
    }
}

/// The gradient found along a stretch, place by place.
pub(super) struct EdgeProbe<'a> {
    sampler: Sampler<'a>,
    min_gradient: f32,
    /// Largest gradient along the edge for one gray level per pixel across it.
    max_slope: f32,
}

/// What was found of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EdgeSupport {
    /// Supported places over all places.
    pub share: f32,
    /// Mean gradient over supported places, gray levels per pixel.
    pub gradient: f32,
}

impl<'a> EdgeProbe<'a> {
    pub fn new(sampler: Sampler<'a>, config: &EdgeSupportConfig) -> Self {
        Self { sampler, min_gradient: config.min_gradient, max_slope: config.max_angle.tan() }
    }

    /// The gradient towards `normal` at a place, if an edge is there.
    #[inline]
    pub fn gradient(&self, place: Vector2<f32>, normal: Vector2<f32>) -> Option<f32> {
        let mut levels = [0.0; 4];
        for (level, offset) in levels.iter_mut().zip(offsets(normal)) {
            *level = self.sampler.at(place + offset)?;
        }
        self.judge(levels)
    }

    /// The gradient across, if an edge is where these gray levels lie at [`offsets`] from.
    #[inline(always)]
    fn judge(&self, [bright, dark, ahead, behind]: [f32; 4]) -> Option<f32> {
        let (across, along) = (0.5 * (bright - dark), 0.5 * (ahead - behind));
        (across >= self.min_gradient && along.abs() <= self.max_slope * across).then_some(across)
    }

    /// Calls `visit` with the gradient at each of `n` places between `start` and `end` where an edge is. The
    /// gray levels beside the edge lie on straight paths, which are read many places at once; where those
    /// leave the image, place by place.
    fn for_each_gradient(
        &self,
        [start, end]: [Vector2<f32>; 2],
        n: usize,
        normal: Vector2<f32>,
        mut visit: impl FnMut(usize, f32),
    ) {
        let step = (end - start) / n as f32;
        for first in (0..n).step_by(CHUNK) {
            let n_here = CHUNK.min(n - first);
            let from = place(start, end, first, n);
            let mut levels = [[0.0; CHUNK]; 4];
            let mut paths = levels.iter_mut().zip(offsets(normal));
            let are_inside =
                paths.all(|(path, offset)| self.sampler.path(from + offset, step, &mut path[..n_here]));
            let [bright, dark, ahead, behind] = &levels;
            let on_paths = bright.iter().zip(dark).zip(ahead).zip(behind);
            for (i, (((bright, dark), ahead), behind)) in (first..first + n_here).zip(on_paths) {
                let gradient = if are_inside {
                    self.judge([*bright, *dark, *ahead, *behind])
                } else {
                    self.gradient(place(start, end, i, n), normal)
                };
                if let Some(gradient) = gradient {
                    visit(i, gradient);
                }
            }
        }
    }

    /// What supports the stretch from `start` to `end` of an edge with this normal; no support for a stretch
    /// of no length.
    pub fn support(&self, start: Vector2<f32>, end: Vector2<f32>, normal: Vector2<f32>) -> EdgeSupport {
        let (mut n_supported, mut total) = (0u32, 0.0);
        let n = n_places((end - start).norm());
        self.for_each_gradient([start, end], n, normal, |_, gradient| {
            n_supported += 1;
            total += gradient;
        });
        EdgeSupport {
            share: n_supported as f32 / n.max(1) as f32,
            gradient: total / n_supported.max(1) as f32,
        }
    }

    /// The part of a segment the image supports: the longest run of supported places with no hole longer than
    /// `max_hole_px`. Its gradient is the one found. `None` if no place, or too small a share, has support.
    pub fn supported_part(&self, segment: &Segment, config: &EdgeSupportConfig) -> Option<Segment> {
        let (length, normal) = (segment.length(), segment.normal());
        let n = n_places(length);
        let spacing = length / n as f32;
        let max_hole = (config.max_hole_px / spacing) as usize;
        let mut best: Option<Run> = None;
        let mut run: Option<Run> = None;
        self.for_each_gradient([segment.start, segment.end], n, normal, |i, gradient| {
            let grown = match run {
                Some(run) if i - run.last <= max_hole + 1 => run.grown(i, gradient),
                _ => Run { first: i, last: i, n: 1, total: gradient },
            };
            run = Some(grown);
            if best.is_none_or(|best| grown.extent() > best.extent()) {
                best = run;
            }
        });
        let best = best.filter(|run| run.n as f32 >= config.min_share * run.extent() as f32)?;
        let at = |places: usize| segment.start + segment.vector() * (places as f32 / n as f32);
        Some(Segment {
            start: at(best.first),
            end: at(best.last + 1),
            gradient: best.total / best.n as f32,
            ..*segment
        })
    }
}

/// Neighboring places with support.
#[derive(Clone, Copy)]
struct Run {
    first: usize,
    last: usize,
    n: usize,
    total: f32,
}

impl Run {
    fn grown(self, last: usize, gradient: f32) -> Self {
        Self { last, n: self.n + 1, total: self.total + gradient, ..self }
    }

    fn extent(&self) -> usize {
        self.last + 1 - self.first
    }
}

/// Where gray levels are compared, from a place on the edge: across it on the bright and on the dark side,
/// and along it.
#[inline(always)]
fn offsets(normal: Vector2<f32>) -> [Vector2<f32>; 4] {
    let along = Vector2::new(normal.y, -normal.x);
    [normal, -normal, along, -along]
}

fn n_places(length: f32) -> usize {
    ((length / SPACING_PX).ceil().min(MAX_PLACES as f32) as usize).max(1)
}

/// The middle of the `i`-th of `n` equal parts.
fn place(start: Vector2<f32>, end: Vector2<f32>, i: usize, n: usize) -> Vector2<f32> {
    start + (end - start) * ((i as f32 + 0.5) / n as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GrayImage;

    #[test]
    fn the_supported_part_ends_where_the_edge_does() {
        let image =
            GrayImage::from_fn(200, 60, |x, y| if y > 30 && (40..150).contains(&x) { 150 } else { 100 });
        let config = EdgeSupportConfig::default();
        let probe = EdgeProbe::new(Sampler::new(&image), &config);
        let segment = Segment {
            start: Vector2::new(10.0, 30.5),
            end: Vector2::new(190.0, 30.5),
            sigma_px: 0.3,
            gradient: 1.0,
        };
        let part = probe.supported_part(&segment, &config).unwrap();
        assert!((part.start.x - 40.0).abs() < 3.0 && (part.end.x - 150.0).abs() < 3.0, "{part:?}");
        assert!((part.gradient - 25.0).abs() < 2.0);
        let support = probe.support(segment.start, segment.end, segment.normal());
        assert!((support.share - 110.0 / 180.0).abs() < 0.03, "{support:?}");
        let turned = Segment { start: segment.end, end: segment.start, ..segment };
        assert_eq!(probe.supported_part(&turned, &config), None);
        assert_eq!(probe.support(turned.start, turned.end, turned.normal()).share, 0.0);
    }
}
