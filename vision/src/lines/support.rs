//! Whether the image shows an edge where a segment is said to be.

use nalgebra::Vector2;

use super::Segment;
use super::sampling::Sampler;

/// Distance of the places looked at, pixels.
const SPACING_PX: f32 = 2.0;
/// Most places looked at, on any one stretch; longer ones are looked at further apart.
const MAX_PLACES: usize = 512;

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
        let along = Vector2::new(normal.y, -normal.x);
        let across_gradient = 0.5 * (self.sampler.at(place + normal)? - self.sampler.at(place - normal)?);
        if across_gradient < self.min_gradient {
            return None;
        }
        let along_gradient = 0.5 * (self.sampler.at(place + along)? - self.sampler.at(place - along)?);
        (along_gradient.abs() <= self.max_slope * across_gradient).then_some(across_gradient)
    }

    /// What supports the stretch from `start` to `end` of an edge with this normal; no support for a stretch
    /// of no length.
    pub fn support(&self, start: Vector2<f32>, end: Vector2<f32>, normal: Vector2<f32>) -> EdgeSupport {
        let (mut n_supported, mut total) = (0u32, 0.0);
        let n = n_places((end - start).norm());
        for i in 0..n {
            if let Some(gradient) = self.gradient(place(start, end, i, n), normal) {
                n_supported += 1;
                total += gradient;
            }
        }
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
        for i in 0..n {
            let Some(gradient) = self.gradient(place(segment.start, segment.end, i, n), normal) else {
                continue;
            };
            run = match run {
                Some(run) if i - run.last <= max_hole + 1 => Some(run.grown(i, gradient)),
                _ => Some(Run { first: i, last: i, n: 1, total: gradient }),
            };
            best =
                [best, run].into_iter().flatten().reduce(|a, b| if b.extent() > a.extent() { b } else { a });
        }
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
