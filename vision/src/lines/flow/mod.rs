//! Where a segment of the last image lies in the next one, by optical flow (a KLT tracker for lines).
//!
//! Motion along an edge cannot be seen (the aperture problem), so only motion across it is measured: gray
//! levels are read on short paths across the segment, at places spread along it, and each path is shifted
//! until it fits the next image (Lucas & Kanade in one dimension), from the coarsest of three levels to the
//! finest.
//!
//! ```text
//!       last image                       next image
//!
//!     1   2   3   4   5   places       1   2   3   4   5
//!     |   |   |   |   |                ╷   ╷   ╷   ╷   ╷
//!   --+---+---+---+---+-- segment    ··+···+···+···+···+·· expected, by the motion prior
//!     |   |   |   |   |                ╵   ╵   ╵   ╵   ╵
//!           paths                      x       x   x   x   found: expected + shift * normal
//!                                          x               place 2 is an outlier
//! ```
//!
//! After each level a [`ShiftLine`] `offset + slope * along` is fitted to the shifts, so what most places
//! agree on guides the others, and is the guess at the next finer level. At the coarsest level the guess is
//! the one offset under which all paths together fit best. Endpoints move along the line only as the motion
//! prior says.

mod align;
mod config;
mod line_fit;
mod paths;
mod pyramid;

use nalgebra::Vector2;

use super::Segment;
use super::clip::Frame;
use super::fit::FittedLine;
use super::sampling::Sampler;
use align::Aligner;
pub use config::LineFlowConfig;
use line_fit::{ShiftLine, fit_points};
use paths::{HALF_PATH, Paths};
pub use pyramid::FlowPyramid;
use pyramid::N_LEVELS;

/// Where a pixel of the last image is expected in the next one, for example by the homography of the infinite
/// plane. What it gives may be anything: places that are not finite are taken to stay where they were.
pub type MotionPrior<'a> = dyn Fn(Vector2<f32>) -> Vector2<f32> + 'a;

/// A segment found again by flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowedSegment {
    /// Where it is. Its endpoints are those of the old one, moved by the prior and dropped onto the line;
    /// they may lie outside the image. `sigma_px` is the old one's joined with the scatter of the shifts;
    /// `gradient` is measured.
    pub segment: Segment,
    /// Places that lie in both images.
    pub n_samples: usize,
    /// Places that agree on the line.
    pub n_inliers: usize,
}

/// Why flow did not find a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FlowFailure {
    /// The segment holds something that is not finite, or has no length.
    NotASegment,
    /// Too few of its places lie in both images.
    OutsideImage {
        /// Those that do.
        n_samples: usize,
    },
    /// Too few of its places have contrast, fit the next image or agree on a line.
    Inconsistent {
        /// Those that do.
        n_inliers: usize,
        /// Those that lie in both images.
        n_samples: usize,
    },
}

/// One place along a segment.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// In the last image, pixels.
    old: Vector2<f32>,
    /// Where the prior has it in the next image, pixels.
    expected: Vector2<f32>,
    /// Along the expected segment, from its midpoint, pixels.
    along: f32,
    /// How far from `expected` the edge was found, along the normal, pixels; `None` where it was not.
    shift: Option<f32>,
}

/// Follows segments from one image to the next; keeps its buffers.
#[derive(Clone, Debug)]
pub struct LineFlow {
    config: LineFlowConfig,
    places: Vec<Place>,
    aligner: Aligner,
}

impl LineFlow {
    /// Follows as `config` says.
    pub fn new(config: LineFlowConfig) -> Self {
        Self { config, places: Vec::new(), aligner: Aligner::default() }
    }

    /// Finds `segment` of `last` in `next`.
    pub fn follow(
        &mut self,
        last: &FlowPyramid,
        next: &FlowPyramid,
        segment: &Segment,
        prior: Option<&MotionPrior>,
    ) -> Result<FlowedSegment, FlowFailure> {
        if !(segment.is_finite() && segment.length() > 0.0 && segment.length().is_finite()) {
            return Err(FlowFailure::NotASegment);
        }
        // Paths across the places chosen lie in the last image.
        let visible = readable(last).clip(segment).ok_or(FlowFailure::OutsideImage { n_samples: 0 })?;
        let expect = |pixel: Vector2<f32>| expected_pixel(pixel, prior);
        let expected = Segment { start: expect(segment.start), end: expect(segment.end), ..*segment };
        // A prior that turns a segment into a point, or beyond what numbers hold, says nothing.
        if !(expected.is_finite() && expected.length() > 1.0 && expected.length().is_finite()) {
            return Err(FlowFailure::NotASegment);
        }
        self.choose_places(&visible, &expected, &expect);
        let search_px =
            if prior.is_some() { self.config.search_with_prior_px } else { self.config.search_px };
        let line = self.measure(last, next, [segment.normal(), expected.normal()], search_px);
        self.finish(&visible, &expected, &line, next)
    }

    /// From the coarsest level to the finest: every place's shift, and the line they agree on.
    fn measure(
        &mut self,
        last: &FlowPyramid,
        next: &FlowPyramid,
        [old_normal, new_normal]: [Vector2<f32>; 2],
        search_px: f32,
    ) -> ShiftLine {
        let mut line = ShiftLine::default();
        for level in (0..N_LEVELS).rev() {
            let paths = Paths {
                last: Sampler::new(&last.levels[level]),
                next: Sampler::new(&next.levels[level]),
                level,
                old_normal,
                new_normal,
            };
            if level == N_LEVELS - 1 {
                line.offset = self.search_offset(&paths, search_px);
            }
            self.measure_shifts(&paths, &line);
            // What the coarse levels cannot tell, finer ones may: the line stays as it was.
            let tolerance = self.config.inlier_px * (1u32 << level) as f32;
            if let Some(fitted) = ShiftLine::fit(&self.shifts(), tolerance) {
                line = fitted;
            }
        }
        line
    }

    /// Places at even distances on the visible part of the segment.
    fn choose_places(
        &mut self,
        visible: &Segment,
        expected: &Segment,
        expect: &dyn Fn(Vector2<f32>) -> Vector2<f32>,
    ) {
        let config = &self.config;
        let wanted = (visible.length() / config.sample_spacing_px).min(config.max_samples as f32) as usize;
        let n = wanted.clamp(config.min_samples.min(config.max_samples), config.max_samples.max(1));
        let (direction, midpoint) = (expected.direction(), expected.midpoint());
        self.places.clear();
        self.places.extend((0..n).map(|i| {
            let old = visible.start + visible.vector() * ((i as f32 + 0.5) / n as f32);
            let new = expect(old);
            Place { old, expected: new, along: direction.dot(&(new - midpoint)), shift: None }
        }));
    }

    /// The offset, the same for all places, at which the paths of the coarsest level fit best; the smallest
    /// of equals.
    fn search_offset(&mut self, paths: &Paths, search_px: f32) -> f32 {
        let step = (1u32 << paths.level) as f32;
        self.aligner.begin_search((search_px / step).round() as usize);
        for place in &self.places {
            self.aligner.add_to_search(paths, place.old, place.expected);
        }
        self.aligner.best_offset() as f32 * step
    }

    /// Shifts of all places, near what `line` says.
    fn measure_shifts(&mut self, paths: &Paths, line: &ShiftLine) {
        let scale = (1u32 << paths.level) as f32;
        let finest = paths.level == 0;
        for place in &mut self.places {
            let guess = line.at(place.along);
            let new = place.expected + paths.new_normal * guess;
            let aligned = self.aligner.align(paths, place.old, new, finest);
            place.shift = aligned
                .filter(|found| {
                    !finest
                        || (found.correlation >= self.config.min_correlation
                            && found.forward_backward <= self.config.max_forward_backward_px)
                })
                .map(|found| guess + found.shift * scale);
        }
    }

    fn shifts(&self) -> Vec<(f32, f32)> {
        self.places.iter().filter_map(|place| Some((place.along, place.shift?))).collect()
    }

    /// The line through the places that agree, and the checks on it.
    fn finish(
        &self,
        visible: &Segment,
        expected: &Segment,
        line: &ShiftLine,
        next: &FlowPyramid,
    ) -> Result<FlowedSegment, FlowFailure> {
        let config = &self.config;
        let normal = expected.normal();
        let frame = readable(next);
        let is_inside = |place: &&Place| frame.contains(&(place.expected + normal * line.at(place.along)));
        let n_samples = self.places.iter().filter(is_inside).count();
        if n_samples < config.min_samples.max(2) {
            return Err(FlowFailure::OutsideImage { n_samples });
        }
        let inliers: Vec<Vector2<f32>> = self
            .places
            .iter()
            .filter(is_inside)
            .filter_map(|place| {
                let shift =
                    place.shift.filter(|shift| (shift - line.at(place.along)).abs() <= config.inlier_px)?;
                Some(place.expected + normal * shift)
            })
            .collect();
        let n_inliers = inliers.len();
        let inconsistent = FlowFailure::Inconsistent { n_inliers, n_samples };
        let enough = n_inliers >= config.min_samples.max(2)
            && n_inliers as f32 >= config.min_inlier_share * n_samples as f32;
        // The shifts were a line over the expected segment; the points found are fitted anew, by total least
        // squares.
        let fitted =
            enough.then(|| fit_points(&inliers, expected.direction())).flatten().ok_or(inconsistent)?;
        let onto_line = |pixel: Vector2<f32>| fitted.at(fitted.along(pixel));
        let segment = Segment {
            start: onto_line(expected.start),
            end: onto_line(expected.end),
            sigma_px: visible.sigma_px.hypot(fitted.sigma_px()),
            gradient: gradient_across(&fitted, &inliers, next),
        };
        if fitted.sigma_px() > config.max_fit_px || !segment.is_finite() {
            return Err(inconsistent);
        }
        Ok(FlowedSegment { segment, n_samples, n_inliers })
    }
}

/// The mean change of gray level across `line` at the points of it nearest to `points`, gray levels per
/// pixel.
fn gradient_across(line: &FittedLine, points: &[Vector2<f32>], image: &FlowPyramid) -> f32 {
    let sampler = Sampler::new(image.image());
    let normal = Vector2::new(-line.direction.y, line.direction.x).cast::<f32>();
    let gradients = points.iter().filter_map(|point| {
        let pixel = line.at(line.along(*point));
        Some(0.5 * (sampler.at(pixel + normal)? - sampler.at(pixel - normal)?))
    });
    gradients.sum::<f32>() / points.len() as f32
}

/// Where a path's middle may be so that all of it lies in the image.
fn readable(pyramid: &FlowPyramid) -> Frame {
    Frame::of_image(pyramid.image().width(), pyramid.image().height()).grown(-PATH_REACH_PX)
}

/// Places are nearer than this to the image's edge only if they are not looked at, pixels: paths must lie
/// inside.
const PATH_REACH_PX: f32 = HALF_PATH as f32 + 1.0;

/// What the prior says, or the pixel itself where that is nothing.
fn expected_pixel(pixel: Vector2<f32>, prior: Option<&MotionPrior>) -> Vector2<f32> {
    let expected = prior.map_or(pixel, |prior| prior(pixel));
    if expected.iter().all(|value| value.is_finite()) { expected } else { pixel }
}

#[cfg(test)]
mod tests;
