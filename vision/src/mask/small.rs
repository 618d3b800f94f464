//! Images at the resolution that masks are found at.

use crate::{GrayImage, vectorized};

/// Images are reduced by a whole number so that they are no wider than this, pixels: cheap, and less noisy.
const MAX_WIDTH: u32 = 320;

/// A reduced image with its gradient.
#[derive(Clone, Debug, Default)]
pub(super) struct SmallImage {
    pub width: usize,
    pub height: usize,
    /// Gray levels.
    pub values: Vec<u8>,
    /// Difference of the neighbors to the right and to the left, gray levels; 0 at the image's border.
    pub gradient_x: Vec<i16>,
    /// The same below and above.
    pub gradient_y: Vec<i16>,
    /// Columns of the rows that become one.
    sums: Vec<u16>,
}

/// By how much an image of this width is reduced.
pub(super) fn reduction(width: u32) -> u32 {
    width.div_ceil(MAX_WIDTH).max(1)
}

impl SmallImage {
    /// Reduces an image; columns and rows that do not fill a pixel are left off.
    pub fn take(&mut self, image: &GrayImage) {
        let by = reduction(image.width());
        let (width, height) = ((image.width() / by) as usize, (image.height() / by) as usize);
        (self.width, self.height) = (width, height);
        self.values.resize(width * height, 0);
        let Self { values, sums, .. } = self;
        vectorized(
            #[inline(always)]
            || match by {
                1 => reduce::<1>(image, values, width, sums),
                2 => reduce::<2>(image, values, width, sums),
                3 => reduce::<3>(image, values, width, sums),
                4 => reduce::<4>(image, values, width, sums),
                _ => reduce_by(image, by as usize, values, width),
            },
        );
        self.differentiate();
    }

    fn differentiate(&mut self) {
        let (width, height) = (self.width, self.height);
        for gradient in [&mut self.gradient_x, &mut self.gradient_y] {
            gradient.clear();
            gradient.resize(width * height, 0);
        }
        if width < 3 || height < 3 {
            return;
        }
        let difference = |after: u8, before: u8| i16::from(after) - i16::from(before);
        for y in 1..height - 1 {
            let (above, row, below) = (
                &self.values[(y - 1) * width..][..width],
                &self.values[y * width..][..width],
                &self.values[(y + 1) * width..][..width],
            );
            let out_x = &mut self.gradient_x[y * width + 1..][..width - 2];
            for (out, (before, after)) in out_x.iter_mut().zip(row.iter().zip(&row[2..])) {
                *out = difference(*after, *before);
            }
            let out_y = &mut self.gradient_y[y * width + 1..][..width - 2];
            for (out, (before, after)) in out_y.iter_mut().zip(above[1..].iter().zip(&below[1..])) {
                *out = difference(*after, *before);
            }
        }
    }
}

/// Means of squares of `BY` pixels.
#[inline(always)]
fn reduce<const BY: usize>(image: &GrayImage, values: &mut [u8], width: usize, sums: &mut Vec<u16>) {
    if width == 0 {
        return;
    }
    sums.clear();
    sums.resize(width * BY, 0);
    let half = (BY * BY / 2) as u16;
    for (y, out) in values.chunks_exact_mut(width).enumerate() {
        sums.fill(0);
        for row in 0..BY {
            let pixels = &image.row((y * BY + row) as u32)[..width * BY];
            sums.iter_mut().zip(pixels).for_each(|(sum, pixel)| *sum += u16::from(*pixel));
        }
        for (out, sums) in out.iter_mut().zip(sums.as_chunks::<BY>().0) {
            *out = ((sums.iter().sum::<u16>() + half) / (BY * BY) as u16) as u8;
        }
    }
}

/// Every `by`-th pixel of large images, which are seldom: cameras' images are reduced before.
#[inline(always)]
fn reduce_by(image: &GrayImage, by: usize, values: &mut [u8], width: usize) {
    for (y, out) in values.chunks_exact_mut(width.max(1)).enumerate() {
        let pixels = image.row((y * by) as u32).iter().step_by(by);
        out.iter_mut().zip(pixels).for_each(|(out, pixel)| *out = *pixel);
    }
}
