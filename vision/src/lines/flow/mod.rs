//! Where a segment of the last image lies in the next one, by optical flow.
//!
//! Motion along an edge cannot be seen, so only motion across it is measured: grey levels are read on short paths across
//! the segment, at places spread along it, and each path is shifted until it fits the next image (Lucas & Kanade in one
//! dimension), from the coarsest of three levels to the finest. After each level a line is fitted to the shifts, so what
//! most places agree on guides the others. Endpoints move along the line only as the motion prior says.

mod align;
mod line_fit;

use nalgebra::Vector2;

use super::Segment;
use super::clip::Frame;
use super::sampling::{Sampler, halve, halved_position};
use crate::GrayImage;
use align::{Aligner, HALF_PATH};
use line_fit::{ShiftLine, fit_points};

/// Where a pixel of the last image is expected in the next one, for example by the homography of the infinite plane.
/// What it gives may be anything: places that are not finite are taken to stay where they were.
pub type MotionPrior<'a> = dyn Fn(Vector2<f32>) -> Vector2<f32> + 'a;

/// How segments are followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineFlowConfig {
    /// Distance of the places looked at along a segment, pixels. Default 10.
    pub sample_spacing_px: f32,
    /// Fewest places along a segment that must give a shift, at least 2. Default 4.
    pub min_samples: usize,
    /// Most places along a segment: longer ones are sampled further apart. Default 20.
    pub max_samples: usize,
    /// How far a segment may have moved across itself without a motion prior, pixels, at most 32. Default 24: 30 degrees
    /// per second at 500 px focal length and 10 frames per second, or fast motion at 30.
    pub search_px: f32,
    /// As `search_px` with a motion prior, pixels. Default 12.
    pub search_with_prior_px: f32,
    /// Least correlation of a path with the place found for it. Default 0.7.
    pub min_correlation: f32,
    /// Largest distance from where a path began of where it leads when followed back, pixels. Default 1.
    pub max_forward_backward_px: f32,
    /// Largest distance of an inlier from the line, pixels. Default 1.
    pub inlier_px: f32,
    /// Least share of inliers among places that lie in both images. Default 0.7.
    pub min_inlier_share: f32,
    /// Largest root mean square distance of inliers from the line, pixels. Default 0.7.
    pub max_fit_px: f32,
}

impl Default for LineFlowConfig {
    fn default() -> Self {
        Self {
            sample_spacing_px: 10.0,
            min_samples: 4,
            max_samples: 20,
            search_px: 24.0,
            search_with_prior_px: 12.0,
            min_correlation: 0.7,
            max_forward_backward_px: 1.0,
            inlier_px: 1.0,
            min_inlier_share: 0.7,
            max_fit_px: 0.7,
        }
    }
}

/// A segment found again by flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowedSegment {
    /// Where it is. Its endpoints are those of the old one, moved by the prior and dropped onto the line; they may lie
    /// outside the image. `sigma_px` is the old one's joined with the scatter of the shifts; `gradient` is measured.
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

/// The levels flow works on: the image, and the same in half and quarter the resolution.
#[derive(Clone, Debug, Default)]
pub struct FlowPyramid {
    levels: [GrayImage; N_LEVELS],
}

/// Levels: at the coarsest a pixel is four of the image's.
const N_LEVELS: usize = 3;

impl FlowPyramid {
    /// Fills all levels, reusing their buffers.
    pub fn build(&mut self, image: &GrayImage) {
        self.levels[0].reshape(image.width(), image.height());
        self.levels[0].as_raw_mut().copy_from_slice(image.as_raw());
        for level in 1..N_LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(level);
            halve(&finer[level - 1], &mut coarser[0]);
        }
    }

    /// The image itself.
    pub fn image(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// The image in half its resolution.
    pub(super) fn halved(&self) -> &GrayImage {
        &self.levels[1]
    }
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
        let frame =
            |pyramid: &FlowPyramid| Frame::of_image(pyramid.image().width(), pyramid.image().height());
        if !(segment.is_finite() && segment.length() > 0.0 && segment.length().is_finite()) {
            return Err(FlowFailure::NotASegment);
        }
        // Paths across the places chosen lie in the last image.
        let visible = frame(last).grown(-PATH_REACH_PX).clip(segment);
        let visible = visible.ok_or(FlowFailure::OutsideImage { n_samples: 0 })?;
        let expect = |pixel: Vector2<f32>| expected_pixel(pixel, prior);
        let expected = Segment { start: expect(segment.start), end: expect(segment.end), ..*segment };
        // A prior that turns a segment into a point, or beyond what numbers hold, says nothing.
        if !(expected.is_finite() && expected.length() > 1.0 && expected.length().is_finite()) {
            return Err(FlowFailure::NotASegment);
        }
        self.choose_places(&visible, &expected, &expect);
        let mut line = ShiftLine::default();
        for level in (0..N_LEVELS).rev() {
            let search_px =
                if prior.is_some() { self.config.search_with_prior_px } else { self.config.search_px };
            let paths = Paths {
                last: Sampler::new(&last.levels[level]),
                next: Sampler::new(&next.levels[level]),
                level,
                old_normal: segment.normal(),
                new_normal: expected.normal(),
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
        self.finish(&visible, &expected, &line, next)
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

    /// The offset, the same for all places, at which the paths of the coarsest level fit best; the smallest of equals.
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
        let (normal, sampler) = (expected.normal(), Sampler::new(next.image()));
        let frame = Frame::of_image(next.image().width(), next.image().height()).grown(-PATH_REACH_PX);
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
        let fitted =
            enough.then(|| fit_points(&inliers, expected.direction())).flatten().ok_or(inconsistent)?;
        let onto_line = |pixel: Vector2<f32>| fitted.at(fitted.along(pixel));
        let new_normal = Vector2::new(-fitted.direction.y, fitted.direction.x).cast::<f32>();
        let gradients = inliers.iter().filter_map(|inlier| {
            let pixel = onto_line(*inlier);
            Some(0.5 * (sampler.at(pixel + new_normal)? - sampler.at(pixel - new_normal)?))
        });
        let segment = Segment {
            start: onto_line(expected.start),
            end: onto_line(expected.end),
            sigma_px: visible.sigma_px.hypot(fitted.sigma_px()),
            gradient: gradients.sum::<f32>() / n_inliers as f32,
        };
        if fitted.sigma_px() > config.max_fit_px || !segment.is_finite() {
            return Err(inconsistent);
        }
        Ok(FlowedSegment { segment, n_samples, n_inliers })
    }
}

/// What the paths across a segment are read from, at one level.
struct Paths<'a> {
    last: Sampler<'a>,
    next: Sampler<'a>,
    level: usize,
    old_normal: Vector2<f32>,
    new_normal: Vector2<f32>,
}

impl Paths<'_> {
    /// Grey levels across the old segment, `out.len()` of them about `pixel` (of the full image).
    fn read_last(&self, pixel: Vector2<f32>, out: &mut [f32]) {
        Self::read(&self.last, halved_position(pixel, self.level), self.old_normal, self.level, out);
    }

    /// Grey levels across the expected segment.
    fn read_next(&self, pixel: Vector2<f32>, out: &mut [f32]) {
        Self::read(&self.next, halved_position(pixel, self.level), self.new_normal, self.level, out);
    }

    /// At the finest level, means of three paths side by side, which are worth their time only there: the coarser ones
    /// are means already.
    fn read(sampler: &Sampler, middle: Vector2<f32>, normal: Vector2<f32>, level: usize, out: &mut [f32]) {
        let start = middle - normal * (0.5 * (out.len() - 1) as f32);
        sampler.clamped_path(start, normal, out);
        if level > 0 {
            return;
        }
        let along = Vector2::new(normal.y, -normal.x) * SIDE_PATH_DISTANCE_PX;
        let mut buffer = [0.0; align::MAX_PATH];
        let side = &mut buffer[..out.len()];
        for offset in [along, -along] {
            sampler.clamped_path(start + offset, normal, side);
            out.iter_mut().zip(side.iter()).for_each(|(sum, value)| *sum += value);
        }
        out.iter_mut().for_each(|sum| *sum *= 1.0 / 3.0);
    }
}

/// Places are nearer than this to the image's edge only if they are not looked at, pixels: paths must lie inside.
const PATH_REACH_PX: f32 = HALF_PATH as f32 + 1.0;
/// Distance of the paths that are averaged at the finest level, pixels.
const SIDE_PATH_DISTANCE_PX: f32 = 1.5;

fn expected_pixel(pixel: Vector2<f32>, prior: Option<&MotionPrior>) -> Vector2<f32> {
    let expected = prior.map_or(pixel, |prior| prior(pixel));
    if expected.iter().all(|value| value.is_finite()) { expected } else { pixel }
}

#[cfg(test)]
mod tests;
