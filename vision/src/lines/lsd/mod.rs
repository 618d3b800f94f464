//! Segments by growing regions of like gradient direction and keeping those that do not happen by chance
//! [Grompone von Gioi et al., "LSD: a Line Segment Detector", 2012].
//!
//! The image is shrunk and smoothed; from pixels of the largest gradient on, neighbors whose level line runs
//! the same way are gathered; a rectangle around them is a segment if so many aligned pixels are not expected
//! anywhere in noise. No angle is ever computed on the way: directions are unit vectors, compared by their
//! scalar product.

mod density;
mod field;
mod meaning;
mod rectangle;
mod region;
mod rescale;
#[cfg(test)]
mod tests;

use nalgebra::Vector2;

use crate::GrayImage;
use crate::lines::gradient::Gradients;
use crate::lines::raw_detector::RawDetector;
use crate::lines::select::Ends;
use rectangle::Rectangle;

/// Tolerance of directions in a region, radians: 22.5 degrees, which is `PRECISION` of half a turn.
const TOLERANCE: f32 = std::f32::consts::PI * PRECISION as f32;
/// The chance that a direction agrees with another within the tolerance.
const PRECISION: f64 = 0.125;
/// Bound on the error of a gradient by the rounding of gray levels, gray levels.
const QUANTIZATION: f32 = 2.0;
/// Smallest share of a rectangle its region must fill.
const MIN_DENSITY: f64 = 0.7;

/// Finds segments by region growing; keeps its buffers.
#[derive(Clone, Debug)]
pub(super) struct Lsd {
    scale: f64,
    rescaler: rescale::Rescaler,
    field: field::Field,
    region: region::Region,
    judge: meaning::Judge,
}

impl Lsd {
    /// A detector that works on the image shrunk to `scale`, above 0 and at most 1.
    pub fn new(scale: f32) -> Self {
        Self {
            scale: f64::from(scale),
            rescaler: rescale::Rescaler::default(),
            field: field::Field::default(),
            region: region::Region::default(),
            judge: meaning::Judge::default(),
        }
    }

    /// The segment around `seed`, if there is one, in pixels of the shrunk image.
    fn segment_from(&mut self, seed: field::Pixel) -> Option<Rectangle> {
        self.region.grow(&mut self.field, seed, TOLERANCE);
        if self.region.pixels.len() < self.judge.min_pixels() {
            return None;
        }
        let rectangle = Rectangle::around(&self.field, &self.region);
        let rectangle = density::densify(&mut self.field, &mut self.region, rectangle)?;
        self.judge.improve(&self.field, rectangle)
    }
}

impl RawDetector for Lsd {
    fn detect(&mut self, image: &GrayImage, _: &Gradients, segments: &mut Vec<Ends>) {
        let shrunk = self.rescaler.shrink(image, self.scale);
        let min_magnitude = QUANTIZATION / TOLERANCE.sin();
        self.field.compute(shrunk, min_magnitude);
        self.judge.start_image(shrunk.width, shrunk.height);
        for i in 0..self.field.n_seeds() {
            let Some(seed) = self.field.seed(i) else { continue };
            if let Some(rectangle) = self.segment_from(seed) {
                // A gradient belongs to the middle of four pixels.
                let to_image = |p: Vector2<f64>| (p.add_scalar(0.5) / self.scale).cast::<f32>();
                let [start, end] = rectangle.ends().map(to_image);
                segments.push(Ends { start, end });
            }
        }
    }
}
