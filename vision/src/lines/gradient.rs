//! The gradient of an image smoothed a little, in whole numbers: what the edge drawing detector walks along
//! and what every segment is refined on.

use crate::{GrayImage, vectorized};

/// What one gray level per pixel comes to in [`Gradients`]: 4 bits kept from the smoothing, 3 from the Sobel
/// weights.
pub(super) const UNITS_PER_LEVEL: f32 = 128.0;

/// The binomial kernel 1 4 6 4 1: a Gaussian of sigma 1 pixel, exact in whole numbers.
const RADIUS: usize = 2;

/// Gradient of an image smoothed with sigma 1 pixel. The outermost ring of pixels has none.
#[derive(Clone, Debug, Default)]
pub(super) struct Gradients {
    pub width: usize,
    pub height: usize,
    /// Along x, row by row, [`UNITS_PER_LEVEL`] to a gray level per pixel.
    pub x: Vec<i16>,
    /// Along y.
    pub y: Vec<i16>,
    /// `|x| + |y|`.
    pub magnitude: Vec<i16>,
    /// A row smoothed along y, with its first and last pixel repeated at both ends.
    padded: Vec<u16>,
    /// Three smoothed rows, 4 fractional bits; row `y` is in slot `y % 3`.
    smoothed: [Vec<u16>; 3],
    /// `above + 2 center + below` and `below - above` of three smoothed rows.
    sum: Vec<i16>,
    difference: Vec<i16>,
}

impl Gradients {
    /// Takes the gradient of `image`, in place of what was here.
    pub fn compute(&mut self, image: &GrayImage) {
        (self.width, self.height) = (image.width() as usize, image.height() as usize);
        let n = self.width * self.height;
        for field in [&mut self.x, &mut self.y, &mut self.magnitude] {
            field.resize(n, 0);
        }
        if self.width < 3 || self.height < 3 {
            for field in [&mut self.x, &mut self.y, &mut self.magnitude] {
                field.fill(0);
            }
            return;
        }
        vectorized(
            #[inline(always)]
            || self.compute_inner_rows(image),
        );
        let last = n - self.width;
        for field in [&mut self.x, &mut self.y, &mut self.magnitude] {
            field[..self.width].fill(0);
            field[last..].fill(0);
        }
    }

    #[inline(always)]
    fn compute_inner_rows(&mut self, image: &GrayImage) {
        self.smooth_row(image, 0);
        self.smooth_row(image, 1);
        for y in 1..self.height - 1 {
            self.smooth_row(image, y + 1);
            self.differentiate_row(y);
        }
    }

    /// Smooths row `y` of `image` into its slot. Pixels beyond the edges are those at the edges.
    #[inline(always)]
    fn smooth_row(&mut self, image: &GrayImage, y: usize) {
        let (width, height) = (self.width, self.height);
        self.padded.resize(width + 2 * RADIUS, 0);
        let [a, b, c, d, e]: [&[u8]; 2 * RADIUS + 1] = std::array::from_fn(|i| {
            &image.row((y + i).saturating_sub(RADIUS).min(height - 1) as u32)[..width]
        });
        let padded = &mut self.padded[RADIUS..RADIUS + width];
        for x in 0..width {
            // At most 16 * 255.
            padded[x] = u16::from(a[x])
                + 4 * (u16::from(b[x]) + u16::from(d[x]))
                + 6 * u16::from(c[x])
                + u16::from(e[x]);
        }
        let (first, last) = (self.padded[RADIUS], self.padded[RADIUS + width - 1]);
        self.padded[..RADIUS].fill(first);
        self.padded[RADIUS + width..].fill(last);
        let [a, b, c, d, e]: [&[u16]; 2 * RADIUS + 1] = std::array::from_fn(|i| &self.padded[i..i + width]);
        let out = &mut self.smoothed[y % 3];
        out.resize(width, 0);
        for (x, out) in out.iter_mut().enumerate() {
            // At most 256 * 255, so that with the 8 of rounding it still fits.
            *out = (a[x] + 4 * (b[x] + d[x]) + 6 * c[x] + e[x] + 8) >> 4;
        }
    }

    /// Sobel's kernels on the three smoothed rows around `y`.
    #[inline(always)]
    fn differentiate_row(&mut self, y: usize) {
        let width = self.width;
        self.sum.resize(width, 0);
        self.difference.resize(width, 0);
        let [above, center, below] = [y + 2, y, y + 1].map(|row| &self.smoothed[row % 3][..width]);
        let (sum, difference) = (&mut self.sum[..width], &mut self.difference[..width]);
        for x in 0..width {
            // A smoothed pixel is at most 4080: nothing here leaves 16 bits.
            sum[x] = (above[x] + 2 * center[x] + below[x]).cast_signed();
            difference[x] = below[x].cast_signed() - above[x].cast_signed();
        }
        let row = y * width;
        let inner = width - 2;
        let out_x = &mut self.x[row..row + width];
        let out_y = &mut self.y[row..row + width];
        let out_magnitude = &mut self.magnitude[row..row + width];
        for field in [&mut *out_x, &mut *out_y, &mut *out_magnitude] {
            field[0] = 0;
            field[width - 1] = 0;
        }
        let (out_x, out_y) = (&mut out_x[1..][..inner], &mut out_y[1..][..inner]);
        let out_magnitude = &mut out_magnitude[1..][..inner];
        let (sum_left, sum_right) = (&sum[..inner], &sum[2..][..inner]);
        let (left, middle, right) =
            (&difference[..inner], &difference[1..][..inner], &difference[2..][..inner]);
        for x in 0..inner {
            let along_x = sum_right[x] - sum_left[x];
            let along_y = left[x] + 2 * middle[x] + right[x];
            out_x[x] = along_x;
            out_y[x] = along_y;
            out_magnitude[x] = along_x.abs() + along_y.abs();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    #[test]
    fn a_slope_has_its_gradient() {
        let image = GrayImage::from_fn(40, 30, |x, y| (20 + 3 * x + 2 * y) as u8);
        let mut gradients = Gradients::default();
        gradients.compute(&image);
        for y in 3..27 {
            for x in 3..37 {
                let at = y * 40 + x;
                assert_eq!((gradients.x[at], gradients.y[at]), (3 * 128, 2 * 128));
                assert_eq!(gradients.magnitude[at], 5 * 128);
            }
        }
    }

    #[test]
    fn the_largest_contrast_does_not_overflow() {
        for image in [
            GrayImage::from_fn(20, 20, |x, _| if x < 10 { 0 } else { 255 }),
            GrayImage::from_fn(20, 20, |x, y| if x + y < 20 { 255 } else { 0 }),
            GrayImage::from_fn(20, 20, |_, _| 255),
            test_images::noise(33, 17, 255, 1),
        ] {
            let mut gradients = Gradients::default();
            gradients.compute(&image);
            for ((&x, &y), &magnitude) in gradients.x.iter().zip(&gradients.y).zip(&gradients.magnitude) {
                assert_eq!(i32::from(magnitude), i32::from(x).abs() + i32::from(y).abs());
                assert!(f32::from(magnitude) <= 1.5 * 128.0 * UNITS_PER_LEVEL);
            }
        }
    }

    #[test]
    fn buffers_of_another_size_leave_nothing_behind() {
        let mut gradients = Gradients::default();
        gradients.compute(&test_images::noise(50, 40, 255, 1));
        for (width, height) in [(0, 0), (1, 1), (2, 9), (9, 2), (3, 3), (30, 20)] {
            let image = test_images::noise(width, height, 255, 2);
            gradients.compute(&image);
            let mut fresh = Gradients::default();
            fresh.compute(&image);
            assert_eq!((&gradients.x, &gradients.y), (&fresh.x, &fresh.y), "{width}x{height}");
            assert_eq!(gradients.magnitude.len(), (width * height) as usize);
        }
    }
}
