//! Gray levels between pixels, on straight paths and in half the resolution.

use nalgebra::Vector2;

use crate::{GrayImage, vectorized};

/// Positions are kept in parts of `2^-FRACTION_BITS` pixel on the way along a path.
const FRACTION_BITS: u32 = 16;
/// Interpolation weights are in parts of this many.
const ONE: u32 = 256;
/// Samples of a path taken at once.
#[cfg(target_arch = "x86_64")]
const LANES: usize = 8;
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
        let half = 1 << (FRACTION_BITS - 9);
        let first = Fixed { x: fixed(start.x).wrapping_add(half), y: fixed(start.y).wrapping_add(half) };
        let step = Fixed { x: fixed(step.x), y: fixed(step.y) };
        self.fill(first, step, out);
        true
    }

    fn fill(&self, first: Fixed, step: Fixed, out: &mut [f32]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && self.is_gatherable(first, step, out.len()) {
            // SAFETY: AVX2 has just been found, and every position's pixels lie in the image.
            return unsafe { self.fill_avx2(first, step, out) };
        }
        self.fill_one_by_one(first, step, out);
    }

    fn fill_one_by_one(&self, mut position: Fixed, step: Fixed, out: &mut [f32]) {
        for value in out {
            let (upper, lower) = self.pixels_around(position);
            *value = blend(upper, lower, position);
            position = position.after(step, 1);
        }
    }

    /// Whether the four bytes from the left upper pixel of each position on, and from the one below it, lie
    /// in the image. A path is straight: both its ends say so for what is between.
    #[cfg(target_arch = "x86_64")]
    fn is_gatherable(&self, first: Fixed, step: Fixed, n: usize) -> bool {
        let last = first.after(step, n.max(1) as u32 - 1);
        let whole = |a: u32, b: u32| (a.max(b) >> FRACTION_BITS) as usize;
        let (x, y) = (whole(first.x, last.x), whole(first.y, last.y));
        let end = (y + 1) * self.width + x + size_of::<u32>();
        x + 1 < self.width && end <= self.pixels.len() && i32::try_from(end).is_ok()
    }

    /// Eight samples at once.
    ///
    /// # Safety
    /// The positions must be [gatherable](Self::is_gatherable).
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn fill_avx2(&self, first: Fixed, step: Fixed, out: &mut [f32]) {
        use std::arch::x86_64::*;
        let index = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        let lanes = |first: u32, step: u32| {
            let offsets = _mm256_mullo_epi32(index, _mm256_set1_epi32(step.cast_signed()));
            _mm256_add_epi32(_mm256_set1_epi32(first.cast_signed()), offsets)
        };
        let (mut x, mut y) = (lanes(first.x, step.x), lanes(first.y, step.y));
        let step_x = _mm256_set1_epi32(step.x.wrapping_mul(LANES as u32).cast_signed());
        let step_y = _mm256_set1_epi32(step.y.wrapping_mul(LANES as u32).cast_signed());
        let width = _mm256_set1_epi32(self.width as i32);
        let (one, low) = (_mm256_set1_epi32(ONE as i32), _mm256_set1_epi32(0xff));
        let scale = _mm256_set1_ps(1.0 / (ONE * ONE) as f32);
        let base = self.pixels.as_ptr();
        let n_last = _mm256_set1_epi32(out.len() as i32);
        let mut done = _mm256_setzero_si256();
        for chunk in out.chunks_mut(LANES) {
            let whole_x = _mm256_srli_epi32::<{ FRACTION_BITS as i32 }>(x);
            let whole_y = _mm256_srli_epi32::<{ FRACTION_BITS as i32 }>(y);
            // Behind the end of the path nothing is read.
            let wanted = _mm256_cmpgt_epi32(n_last, _mm256_add_epi32(index, done));
            let at = _mm256_add_epi32(_mm256_mullo_epi32(whole_y, width), whole_x);
            let at = _mm256_and_si256(at, wanted);
            // SAFETY: the caller says that four bytes from each of these on are in the image.
            let (upper, lower) = unsafe {
                (
                    _mm256_i32gather_epi32::<1>(base.cast(), at),
                    _mm256_i32gather_epi32::<1>(base.add(self.width).cast(), at),
                )
            };
            let right = _mm256_and_si256(_mm256_srli_epi32::<{ FRACTION_BITS as i32 - 8 }>(x), low);
            let below = _mm256_and_si256(_mm256_srli_epi32::<{ FRACTION_BITS as i32 - 8 }>(y), low);
            let left = _mm256_sub_epi32(one, right);
            let along = |pair: __m256i| {
                let second = _mm256_and_si256(_mm256_srli_epi32::<8>(pair), low);
                let first = _mm256_and_si256(pair, low);
                _mm256_add_epi32(_mm256_mullo_epi32(first, left), _mm256_mullo_epi32(second, right))
            };
            let sum = _mm256_add_epi32(
                _mm256_mullo_epi32(along(upper), _mm256_sub_epi32(one, below)),
                _mm256_mullo_epi32(along(lower), below),
            );
            let values = _mm256_mul_ps(_mm256_cvtepi32_ps(sum), scale);
            // SAFETY: as many numbers are stored as the chunk has, and those behind the path's end are not.
            unsafe {
                match chunk.len() {
                    LANES => _mm256_storeu_ps(chunk.as_mut_ptr(), values),
                    _ => _mm256_maskstore_ps(chunk.as_mut_ptr(), wanted, values),
                }
            }
            x = _mm256_add_epi32(x, step_x);
            y = _mm256_add_epi32(y, step_y);
            done = _mm256_add_epi32(done, _mm256_set1_epi32(LANES as i32));
        }
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
            let (x, y) = (clamped(position.x, self.width), clamped(position.y, self.height));
            let position = Fixed { x: fixed(x), y: fixed(y) };
            let (upper, lower) = self.pixels_around(position);
            *value = blend(upper, lower, position);
        }
    }

    /// The gray level at one position, or `None` outside.
    #[inline]
    pub fn at(&self, position: Vector2<f32>) -> Option<f32> {
        if !self.contains(position) {
            return None;
        }
        let half = 1 << (FRACTION_BITS - 9);
        let position = Fixed { x: fixed(position.x) + half, y: fixed(position.y) + half };
        let (upper, lower) = self.pixels_around(position);
        Some(blend(upper, lower, position))
    }

    /// The four pixels around a position: two of the row above, two of the row below.
    #[inline(always)]
    fn pixels_around(&self, position: Fixed) -> ([u8; 2], [u8; 2]) {
        let first =
            (position.y >> FRACTION_BITS) as usize * self.width + (position.x >> FRACTION_BITS) as usize;
        let pair = |first: usize| [self.pixels[first], self.pixels[first + 1]];
        (pair(first), pair(first + self.width))
    }
}

/// A position in parts of `2^-FRACTION_BITS` pixel: a side of an image is at most 65,535 pixels. Steps back
/// wrap around.
#[derive(Clone, Copy)]
struct Fixed {
    x: u32,
    y: u32,
}

impl Fixed {
    #[inline(always)]
    fn after(self, step: Fixed, n_steps: u32) -> Self {
        Self {
            x: self.x.wrapping_add(step.x.wrapping_mul(n_steps)),
            y: self.y.wrapping_add(step.y.wrapping_mul(n_steps)),
        }
    }
}

#[inline(always)]
fn fixed(pixels: f32) -> u32 {
    (pixels * (1u32 << FRACTION_BITS) as f32) as i64 as u32
}

/// Interpolates between two pixels of a row and the two below them.
#[inline(always)]
fn blend(upper: [u8; 2], lower: [u8; 2], position: Fixed) -> f32 {
    let weight = |position: u32| (position >> (FRACTION_BITS - 8)) & (ONE - 1);
    let (right, below) = (weight(position.x), weight(position.y));
    let along = |pair: [u8; 2]| u32::from(pair[0]) * (ONE - right) + u32::from(pair[1]) * right;
    (along(upper) * (ONE - below) + along(lower) * below) as f32 * (1.0 / (ONE * ONE) as f32)
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
    fn samples_taken_together_are_those_taken_one_by_one() {
        let image = crate::test_images::noise(37, 29, 255, 3);
        let sampler = Sampler::new(&image);
        for (start, step) in [
            (Vector2::new(1.3, 2.7), Vector2::new(0.9, 0.7)),
            (Vector2::new(35.9, 27.9), Vector2::new(-1.0, -0.8)),
            (Vector2::new(35.98, 27.98), Vector2::new(0.0, 0.0)),
            (Vector2::new(0.02, 27.9), Vector2::new(1.1, 0.0)),
        ] {
            for n in 1..=25 {
                let (mut together, mut one_by_one) = ([-1.0; 26], [-1.0; 26]);
                assert!(sampler.path(start, step, &mut together[..n]));
                let half = 1 << (FRACTION_BITS - 9);
                let first = Fixed { x: fixed(start.x) + half, y: fixed(start.y) + half };
                let step = Fixed { x: fixed(step.x), y: fixed(step.y) };
                sampler.fill_one_by_one(first, step, &mut one_by_one[..n]);
                assert_eq!(together, one_by_one, "{start} {step_x}", step_x = step.x);
            }
        }
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
