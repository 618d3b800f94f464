//! Gray levels between pixels, on straight paths and in half the resolution.

use nalgebra::Vector2;

use crate::{GrayImage, vectorized};

/// Positions are kept in parts of `2^-FRACTION_BITS` pixel on the way along a path.
const FRACTION_BITS: u32 = 16;
/// Interpolation weights are in parts of this many.
const ONE: u32 = 256;
/// A position must be this far inside the outermost pixel centers, pixels: room for the rounding of a path's
/// positions.
const MARGIN_PX: f32 = 0.01;

/// Bilinear interpolation in an image.
#[derive(Clone, Copy)]
pub(super) struct Sampler<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
}

impl<'a> Sampler<'a> {
    pub fn new(image: &'a GrayImage) -> Self {
        Self { pixels: image.as_raw(), width: image.width() as usize, height: image.height() as usize }
    }

    /// Whether a gray level can be interpolated there; false for what is not finite.
    #[inline]
    pub fn contains(&self, position: Vector2<f32>) -> bool {
        let inside = |value: f32, n: usize| value >= MARGIN_PX && value <= n as f32 - 1.0 - MARGIN_PX;
        inside(position.x, self.width) && inside(position.y, self.height)
    }

    /// Fills `out` with the gray levels at `start + i * step`. False, and nothing done, if the path leaves
    /// the image.
    #[inline]
    pub fn path(&self, start: Vector2<f32>, step: Vector2<f32>, out: &mut [f32]) -> bool {
        let last = start + step * (out.len().max(1) - 1) as f32;
        if !(self.contains(start) && self.contains(last)) {
            return false;
        }
        let fixed = |value: f32| (value * (1u32 << FRACTION_BITS) as f32) as i64;
        let half = 1i64 << (FRACTION_BITS - 9);
        let (mut x, mut y) = (fixed(start.x) + half, fixed(start.y) + half);
        let (step_x, step_y) = (fixed(step.x), fixed(step.y));
        for value in out {
            *value = self.at_fixed(x, y);
            x += step_x;
            y += step_y;
        }
        true
    }

    /// As [`Sampler::path`]; beyond the edges the image goes on as at the edges. An empty image is black.
    pub fn clamped_path(&self, start: Vector2<f32>, step: Vector2<f32>, out: &mut [f32]) {
        if self.path(start, step, out) {
            return;
        }
        if self.width < 2 || self.height < 2 {
            out.fill(0.0);
            return;
        }
        let clamped = |value: f32, n: usize| value.max(MARGIN_PX).min(n as f32 - 1.0 - MARGIN_PX);
        for (i, value) in out.iter_mut().enumerate() {
            let position = start + step * i as f32;
            let fixed = |value: f32| (value * (1u32 << FRACTION_BITS) as f32) as i64;
            *value = self
                .at_fixed(fixed(clamped(position.x, self.width)), fixed(clamped(position.y, self.height)));
        }
    }

    /// The gray level at one position, or `None` outside.
    #[inline]
    pub fn at(&self, position: Vector2<f32>) -> Option<f32> {
        let mut value = [0.0];
        self.path(position, Vector2::zeros(), &mut value).then_some(value[0])
    }

    #[inline(always)]
    fn at_fixed(&self, x: i64, y: i64) -> f32 {
        let first = (y >> FRACTION_BITS) as usize * self.width + (x >> FRACTION_BITS) as usize;
        let weight = |position: i64| (position >> (FRACTION_BITS - 8)) as u32 & (ONE - 1);
        let (right, below) = (weight(x), weight(y));
        let blend = |pair: &[u8]| u32::from(pair[0]) * (ONE - right) + u32::from(pair[1]) * right;
        let upper = blend(&self.pixels[first..first + 2]);
        let lower = blend(&self.pixels[first + self.width..first + self.width + 2]);
        (upper * (ONE - below) + lower * below) as f32 * (1.0 / (ONE * ONE) as f32)
    }
}

/// Writes the means of 2 x 2 pixels of `image` into `out`, reusing its buffer; an odd last row or column is
/// left out.
pub(super) fn halve(image: &GrayImage, out: &mut GrayImage) {
    let (width, height) = (image.width() / 2, image.height() / 2);
    out.reshape(width, height);
    for y in 0..height {
        let (upper, lower) = (image.row(2 * y), image.row(2 * y + 1));
        vectorized(
            #[inline(always)]
            || halve_rows(upper, lower, out.row_mut(y)),
        );
    }
}

#[inline(always)]
fn halve_rows(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
    for (out, (a, b)) in out.iter_mut().zip(pairs) {
        let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
        *out = ((sum + 2) >> 2) as u8;
    }
}

/// Where a pixel of the full image lies after halving it `level` times: block centers are pixel centers.
#[inline]
pub(super) fn halved_position(position: Vector2<f32>, level: usize) -> Vector2<f32> {
    let scale = 1.0 / (1u32 << level) as f32;
    position * scale + Vector2::repeat(0.5 * (scale - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> GrayImage {
        GrayImage::from_fn(20, 16, |x, y| (4 * x + 8 * y) as u8)
    }

    #[test]
    fn a_ramp_is_interpolated_exactly() {
        let image = ramp();
        let sampler = Sampler::new(&image);
        let mut values = [0.0; 9];
        let (start, step) = (Vector2::new(2.25, 3.5), Vector2::new(0.5, 0.75));
        assert!(sampler.path(start, step, &mut values));
        for (i, value) in values.iter().enumerate() {
            let p = start + step * i as f32;
            assert!((value - (4.0 * p.x + 8.0 * p.y)).abs() < 0.05, "{value} at {p}");
        }
        let before = values;
        for outside in [Vector2::new(15.5, 3.0), Vector2::new(2.0, 10.0), Vector2::new(f32::NAN, 2.0)] {
            assert!(!sampler.path(outside, step, &mut values));
        }
        assert_eq!(values, before);
        sampler.clamped_path(Vector2::new(-7.0, 4.0), Vector2::new(1.0, 0.0), &mut values);
        assert!(values[..8].iter().all(|value| (value - 32.0).abs() < 0.1), "{values:?}");
    }

    #[test]
    fn images_too_small_to_interpolate_in_are_left_alone() {
        for (width, height) in [(0, 0), (1, 1), (1, 9), (2, 2)] {
            let image = GrayImage::from_fn(width, height, |_, _| 50);
            let sampler = Sampler::new(&image);
            let mut values = [9.0; 3];
            sampler.clamped_path(Vector2::new(0.5, f32::NAN), Vector2::new(1.0, f32::INFINITY), &mut values);
            assert!(values.iter().all(|value| value.is_finite() && *value <= 50.0));
            let mut halved = GrayImage::default();
            halve(&image, &mut halved);
            assert_eq!((halved.width(), halved.height()), (width / 2, height / 2));
        }
    }

    #[test]
    fn halving_keeps_positions() {
        let image = ramp();
        let mut halved = GrayImage::default();
        halve(&image, &mut halved);
        let position = Vector2::new(7.3, 5.9);
        let full = Sampler::new(&image).at(position).unwrap();
        let half = Sampler::new(&halved).at(halved_position(position, 1)).unwrap();
        assert!((full - half).abs() < 0.6, "{full} {half}");
        assert_eq!(halved_position(position, 0), position);
    }
}
