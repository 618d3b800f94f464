//! The blur under the descriptors' tests: Gaussian, 7x7, sigma 2 pixels.

use crate::{GrayImage, vectorized};

const RADIUS: usize = 3;
/// exp(-d^2 / 8) for distances 0 to 3, scaled so that all seven weights sum to 256: sums of bytes fit into 16
/// bits.
const WEIGHTS: [u16; RADIUS + 1] = [56, 49, 33, 18];

/// Blurs images; keeps its buffer.
#[derive(Clone, Debug, Default)]
pub(super) struct Blur {
    /// A row blurred along y, with its first and last pixel repeated at both ends.
    padded: Vec<u8>,
}

impl Blur {
    /// Writes `image`, blurred, into `out`. Pixels beyond the edges are those at the edges.
    pub fn apply(&mut self, image: &GrayImage, out: &mut GrayImage) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        out.reshape(image.width(), image.height());
        if image.is_empty() {
            return;
        }
        self.padded.resize(width + 2 * RADIUS, 0);
        for y in 0..height {
            let rows =
                std::array::from_fn(|i| image.row((y + i).saturating_sub(RADIUS).min(height - 1) as u32));
            let down = &mut self.padded[RADIUS..RADIUS + width];
            vectorized(
                #[inline(always)]
                || blend(rows, down),
            );
            let (first, last) = (self.padded[RADIUS], self.padded[RADIUS + width - 1]);
            self.padded[..RADIUS].fill(first);
            self.padded[RADIUS + width..].fill(last);
            let shifted = std::array::from_fn(|i| &self.padded[i..i + width]);
            vectorized(
                #[inline(always)]
                || blend(shifted, out.row_mut(y as u32)),
            );
        }
    }
}

/// The weighted sum of seven rows, all as long as `out`.
#[inline(always)]
fn blend(rows: [&[u8]; 2 * RADIUS + 1], out: &mut [u8]) {
    let n = out.len();
    let [a, b, c, d, e, f, g] = rows.map(|row| &row[..n]);
    let pair = |p: u8, q: u8| u16::from(p) + u16::from(q);
    for i in 0..n {
        let sum = WEIGHTS[0] * u16::from(d[i])
            + WEIGHTS[1] * pair(c[i], e[i])
            + WEIGHTS[2] * pair(b[i], f[i])
            + WEIGHTS[3] * pair(a[i], g[i]);
        out[i] = ((sum + 128) >> 8) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    #[test]
    fn blur_is_gaussian_up_to_rounding() {
        for (width, height) in [(40, 30), (3, 2), (1, 9), (65, 7)] {
            let image = test_images::noise(width, height, 255, 3);
            let mut out = GrayImage::default();
            Blur::default().apply(&image, &mut out);
            let weight = |d: i32| (-f64::from(d * d) / 8.0).exp();
            let total: f64 = (-3..=3).map(weight).sum();
            for y in 0..height {
                for x in 0..width {
                    let mut expected = 0.0;
                    for dy in -3..=3 {
                        let row = image.row((y as i32 + dy).clamp(0, height as i32 - 1) as u32);
                        for dx in -3..=3 {
                            let pixel = row[(x as i32 + dx).clamp(0, width as i32 - 1) as usize];
                            expected += weight(dx) * weight(dy) / (total * total) * f64::from(pixel);
                        }
                    }
                    let error = f64::from(out.row(y)[x as usize]) - expected;
                    assert!(error.abs() < 2.5, "{error} at ({x}, {y}) of {width}x{height}");
                }
            }
        }
    }

    #[test]
    fn blur_keeps_a_plain_image() {
        for level in [0, 1, 127, 255] {
            let image = GrayImage::from_fn(20, 20, |_, _| level);
            let mut out = GrayImage::default();
            Blur::default().apply(&image, &mut out);
            assert_eq!(out, image);
        }
    }
}
