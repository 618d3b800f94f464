//! Sub-pixel refinement, a segment to a fraction of a pixel: the line through the maxima of the gradient
//! across it.

use nalgebra::Vector2;

use crate::lines::Segment;
use crate::lines::fit::{FittedLine, Moments};
use crate::lines::gradient::{Gradients, UNITS_PER_LEVEL};
use crate::lines::select::Ends;

/// The gradient's maximum is looked for this far from the segment as detected, pixels.
const SEARCH_PX: i32 = 2;
/// A maximum weaker than this is noise, gray levels per pixel.
const MIN_GRADIENT: f32 = 1.5;
/// Maxima farther from the line through all of them than this multiple of the standard deviation are left
/// out: they belong to another edge, or to the corner the edge ends in.
const MAX_STRAY_SIGMAS: f64 = 2.5;
/// Within these bounds, pixels.
const MAX_STRAY_BOUNDS_PX: [f64; 2] = [0.2, 1.5];
/// Segments longer than this are sampled at every other pixel.
const DENSE_LENGTH_PX: f32 = 48.0;
/// Fewer samples do not make a line.
const MIN_SAMPLES: usize = 8;
/// So many of the places looked at must have a maximum near the line.
const MIN_SHARE: f32 = 0.6;

/// An edge that goes on beyond a segment's end is followed this far, pixels: detectors stop short of corners
/// and crossings.
const MAX_EXTENSION_PX: usize = 10;
/// As long as its maxima are this near to the line, pixels.
const MAX_EXTENSION_STRAY_PX: f64 = 0.7;

/// Refines segments; keeps its buffer.
#[derive(Clone, Debug, Default)]
pub(super) struct Refiner {
    samples: Vec<Vector2<f32>>,
}

impl Refiner {
    /// Smallest standard deviation a segment is given, pixels. What remains below is not noise that averages
    /// out: the sampling of the image, the lens model, the blur of moving edges.
    pub const MIN_SIGMA_PX: f32 = 0.3;

    /// The segment that fits the edge near `ends`, or `None` if there is no straight one.
    pub fn refine(&mut self, gradients: &Gradients, ends: &Ends) -> Option<Segment> {
        let vector = ends.end - ends.start;
        let profiles = Profiles::new(gradients, vector);
        let n_looked = self.sample(&profiles, ends);
        let n_needed = MIN_SAMPLES.max((MIN_SHARE * n_looked as f32) as usize);
        if self.samples.len() < n_needed {
            return None;
        }
        let all = moments_of(&self.samples).fit();
        let [low, high] = MAX_STRAY_BOUNDS_PX;
        let max_stray = (MAX_STRAY_SIGMAS * all.variance.sqrt()).clamp(low, high);
        self.samples.retain(|&sample| all.distance(sample).abs() <= max_stray);
        if self.samples.len() < n_needed {
            return None;
        }
        let line = moments_of(&self.samples).fit().directed_like(vector);
        let (start, end) = self.extent(&profiles, &line);
        let segment = Segment {
            start,
            end,
            sigma_px: (line.variance.sqrt() as f32).max(Self::MIN_SIGMA_PX),
            gradient: self.mean_gradient(gradients, &line),
        };
        segment.is_finite().then_some(segment)
    }

    /// Collects the maxima of the gradient across the segment, one for each profile or every other one.
    /// Returns at how many profiles it looked.
    fn sample(&mut self, profiles: &Profiles, ends: &Ends) -> usize {
        self.samples.clear();
        let (start, end) = (profiles.to_uv(ends.start), profiles.to_uv(ends.end));
        if start.x == end.x {
            return 0;
        }
        let slope = (end.y - start.y) / (end.x - start.x);
        let from = start.x.min(end.x).ceil().max(0.0) as usize;
        let to = start.x.max(end.x).floor().min(profiles.u_size as f32 - 1.0) as usize;
        let step = if ends.length() > DENSE_LENGTH_PX { 2 } else { 1 };
        let mut n_looked = 0;
        for u in (from..=to).step_by(step) {
            n_looked += 1;
            self.samples.extend(profiles.peak(u, start.y + slope * (u as f32 - start.x)));
        }
        n_looked
    }

    /// Where the edge begins and ends on the line: at the outermost samples, or beyond if it goes on there.
    fn extent(&self, profiles: &Profiles, line: &FittedLine) -> (Vector2<f32>, Vector2<f32>) {
        let order = |a: &&Vector2<f32>, b: &&Vector2<f32>| line.along(**a).total_cmp(&line.along(**b));
        let first = self.samples.iter().min_by(order).copied().unwrap_or_default();
        let last = self.samples.iter().max_by(order).copied().unwrap_or_default();
        let u_grows = profiles.to_uv(line.direction.cast()).x > 0.0;
        let [first, last] = [(first, !u_grows), (last, u_grows)]
            .map(|(from, u_grows)| line.along(extended(profiles, line, from, u_grows)));
        // An edge reaches half a pixel beyond the center of its last one.
        (line.at(first - 0.5), line.at(last + 0.5))
    }

    /// Mean gradient across the line at the samples, gray levels per pixel.
    fn mean_gradient(&self, gradients: &Gradients, line: &FittedLine) -> f32 {
        let (nx, ny) = (-line.direction.y as f32, line.direction.x as f32);
        let across = |sample: &Vector2<f32>| {
            let at = sample.y.round() as usize * gradients.width + sample.x.round() as usize;
            nx * f32::from(gradients.x[at]) + ny * f32::from(gradients.y[at])
        };
        self.samples.iter().map(across).sum::<f32>() / (UNITS_PER_LEVEL * self.samples.len() as f32)
    }
}

/// The last maximum reached from `from` by following the edge along the line.
fn extended(profiles: &Profiles, line: &FittedLine, from: Vector2<f32>, u_grows: bool) -> Vector2<f32> {
    let mut last = from;
    let direction = profiles.to_uv(line.direction.cast());
    let center = profiles.to_uv(line.center.cast());
    let begin = profiles.to_uv(from).x as usize;
    for step in 1..=MAX_EXTENSION_PX {
        let Some(u) = (if u_grows { Some(begin + step) } else { begin.checked_sub(step) }) else { break };
        let v = center.y + (u as f32 - center.x) * direction.y / direction.x;
        match profiles.peak(u, v) {
            Some(peak) if line.distance(peak).abs() <= MAX_EXTENSION_STRAY_PX => last = peak,
            _ => break,
        }
    }
    last
}

/// The gradient across a segment on columns of pixels if the segment runs along x rather than y, else on
/// rows: that needs no interpolation. `u` is the number of the column (or row), `v` the place on it.
struct Profiles<'a> {
    field: &'a [i16],
    /// Makes the gradient positive if the brighter side is to the right.
    sign: f32,
    flat: bool,
    u_stride: usize,
    v_stride: usize,
    u_size: usize,
    v_size: usize,
}

impl<'a> Profiles<'a> {
    fn new(gradients: &'a Gradients, vector: Vector2<f32>) -> Self {
        let (width, height) = (gradients.width, gradients.height);
        let flat = vector.x.abs() >= vector.y.abs();
        if flat {
            let (field, sign) = (&gradients.y, vector.x.signum());
            Self { field, sign, flat, u_stride: 1, v_stride: width, u_size: width, v_size: height }
        } else {
            let (field, sign) = (&gradients.x, -vector.y.signum());
            Self { field, sign, flat, u_stride: width, v_stride: 1, u_size: height, v_size: width }
        }
    }

    /// From (x, y) to (u, v), or back.
    fn to_uv(&self, v: Vector2<f32>) -> Vector2<f32> {
        if self.flat { v } else { v.yx() }
    }

    /// The maximum nearest to `v` on profile `u`, if there is one near, and inside the image.
    #[inline]
    fn peak(&self, u: usize, v: f32) -> Option<Vector2<f32>> {
        let v = v.round();
        // The neighbors of the last place searched must be inside.
        let reach = (SEARCH_PX + 1) as f32;
        if u >= self.u_size || !(v >= reach && v + reach <= self.v_size as f32 - 1.0) {
            return None;
        }
        let center = u * self.u_stride + v as usize * self.v_stride;
        let value = |offset: i32| {
            self.sign
                * f32::from(self.field[center.wrapping_add_signed(offset as isize * self.v_stride as isize)])
        };
        peak_near(value).map(|offset| self.to_uv(Vector2::new(u as f32, v + offset)))
    }
}

fn moments_of(points: &[Vector2<f32>]) -> Moments {
    let mut moments = Moments::default();
    for &point in points {
        moments.push(point);
    }
    moments
}

/// Where `value` has the maximum reached by climbing from 0, to a fraction.
#[inline]
fn peak_near(value: impl Fn(i32) -> f32) -> Option<f32> {
    let mut at = 0;
    let mut center = value(at);
    let (mut before, mut after) = (value(at - 1), value(at + 1));
    while after > center && at < SEARCH_PX {
        at += 1;
        (before, center, after) = (center, after, value(at + 1));
    }
    while before > center && at > -SEARCH_PX {
        at -= 1;
        (before, center, after) = (value(at - 1), before, center);
    }
    let is_peak = center >= before && center >= after;
    if !is_peak || center < MIN_GRADIENT * UNITS_PER_LEVEL {
        return None;
    }
    // The profile of a smoothed step is close to a Gaussian: its logarithm is a parabola.
    let [before, center, after] = [before, center, after].map(|value| value.max(1.0).ln());
    let curvature = before - 2.0 * center + after;
    Some(if curvature < -1e-6 { at as f32 + 0.5 * (before - after) / curvature } else { at as f32 })
}
