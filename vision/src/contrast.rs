//! Local contrast normalization: brings out folds, weave and plaster of a few gray levels, where corners at
//! ordinary thresholds are too few.

use crate::GrayImage;

/// Weights of the smoothing that takes out pixel noise before it would be amplified: a Gaussian of one pixel.
const SMOOTHING_TAPS: [f32; 5] = [0.06, 0.24, 0.40, 0.24, 0.06];
/// Half the side of the square whose mean is the local brightness, pixels.
const SURROUNDINGS_RADIUS_PX: usize = 12;
/// Noise that is left after amplification, gray levels at most: below the weakest corners' threshold.
const MAX_AMPLIFIED_NOISE: f32 = 2.0;
/// What smoothing leaves of independent noise: the root of the sum of the squared weights of both passes.
const NOISE_AFTER_SMOOTHING: f32 = 0.285;
/// Amplification at most. Beyond it quantization to whole gray levels shows as texture.
const MAX_GAIN: f32 = 8.0;
/// Gray level of what is as bright as its surroundings.
const MIDDLE: f32 = 128.0;
/// From the median of absolute values of Gaussian noise to its standard deviation.
const SIGMA_PER_MEDIAN: f32 = 1.4826;

/// Amplifies what differs from its surroundings; keeps its buffers from image to image.
#[derive(Clone, Debug, Default)]
pub struct ContrastAmplifier {
    smoothed: Vec<f32>,
    row_sums: Vec<f32>,
    column_sums: Vec<f32>,
}

impl ContrastAmplifier {
    /// The image with every difference from its surroundings amplified as far as its own noise allows, at
    /// most eightfold, about a middle gray. Returns the gain, too.
    pub fn amplify(&mut self, image: &GrayImage) -> (GrayImage, f32) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        if width == 0 || height == 0 {
            return (image.clone(), 1.0);
        }
        let gain = (MAX_AMPLIFIED_NOISE / (NOISE_AFTER_SMOOTHING * noise_sigma(image))).clamp(1.0, MAX_GAIN);
        self.smooth(image);
        self.sum_rows(width, height);
        let mut out = GrayImage::new(image.width(), image.height());
        let radius = SURROUNDINGS_RADIUS_PX;
        self.column_sums.clear();
        self.column_sums.resize(width, 0.0);
        for y in 0..radius.min(height) {
            add(&mut self.column_sums, &self.row_sums[y * width..][..width], 1.0);
        }
        for y in 0..height {
            if y + radius < height {
                add(&mut self.column_sums, &self.row_sums[(y + radius) * width..][..width], 1.0);
            }
            if y > radius {
                add(&mut self.column_sums, &self.row_sums[(y - radius - 1) * width..][..width], -1.0);
            }
            let n_rows = (y + radius).min(height - 1) - y.saturating_sub(radius) + 1;
            let smoothed = &self.smoothed[y * width..][..width];
            let row = out.row_mut(y as u32);
            for (x, ((pixel, value), sum)) in row.iter_mut().zip(smoothed).zip(&self.column_sums).enumerate()
            {
                let n_columns = (x + radius).min(width - 1) - x.saturating_sub(radius) + 1;
                let mean = sum / (n_rows * n_columns) as f32;
                *pixel = (MIDDLE + gain * (value - mean)).round().clamp(0.0, 255.0) as u8;
            }
        }
        (out, gain)
    }

    /// Smooths along rows, then along columns; what lies outside is as the outermost pixel.
    fn smooth(&mut self, image: &GrayImage) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let half = SMOOTHING_TAPS.len() / 2;
        let mut along_rows = vec![0.0; width * height];
        for y in 0..height {
            let row = image.row(y as u32);
            for (x, out) in along_rows[y * width..][..width].iter_mut().enumerate() {
                let tap = |k: usize| f32::from(row[(x + k).saturating_sub(half).min(width - 1)]);
                *out = SMOOTHING_TAPS.iter().enumerate().map(|(k, weight)| weight * tap(k)).sum();
            }
        }
        self.smoothed.clear();
        self.smoothed.resize(width * height, 0.0);
        for y in 0..height {
            for (k, weight) in SMOOTHING_TAPS.iter().enumerate() {
                let from = (y + k).saturating_sub(half).min(height - 1);
                add(&mut self.smoothed[y * width..][..width], &along_rows[from * width..][..width], *weight);
            }
        }
    }

    /// For each pixel the sum of the smoothed row within the radius.
    fn sum_rows(&mut self, width: usize, height: usize) {
        let radius = SURROUNDINGS_RADIUS_PX;
        self.row_sums.clear();
        self.row_sums.resize(width * height, 0.0);
        for y in 0..height {
            let row = &self.smoothed[y * width..][..width];
            let mut sum: f32 = row.iter().take(radius).sum();
            for (x, out) in self.row_sums[y * width..][..width].iter_mut().enumerate() {
                sum += row.get(x + radius).copied().unwrap_or(0.0);
                if x > radius {
                    sum -= row[x - radius - 1];
                }
                *out = sum;
            }
        }
    }
}

fn add(sums: &mut [f32], values: &[f32], weight: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
}

/// Standard deviation of the noise of single pixels, gray levels: from how pixels differ from what their
/// neighbors to the left and right promise, which in most places is noise alone.
///
/// At least that of rounding to whole gray levels.
pub fn noise_sigma(image: &GrayImage) -> f32 {
    /// Standard deviation of rounding: one over the root of twelve.
    const ROUNDING_SIGMA: f32 = 0.289;
    /// Second differences of independent noise spread by the root of 1 + 1 + 4.
    const SPREAD: f32 = 2.449_49;
    let mut counts = [0u32; 1024];
    let mut n = 0u32;
    for y in 0..image.height() {
        for window in image.row(y).windows(3) {
            let second = i32::from(window[0]) + i32::from(window[2]) - 2 * i32::from(window[1]);
            counts[second.unsigned_abs().min(1023) as usize] += 1;
            n += 1;
        }
    }
    let Some(median) = median_of_counts(&counts, n) else { return ROUNDING_SIGMA };
    (SIGMA_PER_MEDIAN * median / SPREAD).max(ROUNDING_SIGMA)
}

/// The median of a histogram of whole numbers, between them in proportion.
fn median_of_counts(counts: &[u32], n: u32) -> Option<f32> {
    let half = n as f32 / 2.0;
    let mut below = 0.0;
    for (value, count) in counts.iter().enumerate() {
        let count = *count as f32;
        if below + count >= half && count > 0.0 {
            // Value v stands for v - 0.5 to v + 0.5, and 0 for 0 to 0.5.
            let (start, width) = if value == 0 { (0.0, 0.5) } else { (value as f32 - 0.5, 1.0) };
            return Some(start + width * (half - below) / count);
        }
        below += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Random;

    fn noisy(sigma: f32) -> GrayImage {
        let mut random = Random::new(3);
        GrayImage::from_fn(200, 150, |x, y| {
            let gaussian = (0..12).map(|_| random.unit()).sum::<f32>() - 6.0;
            (90.0 + 0.2 * x as f32 + 0.1 * y as f32 + sigma * gaussian).round() as u8
        })
    }

    #[test]
    fn noise_is_measured_on_slopes() {
        for sigma in [1.0, 2.0, 5.0] {
            let measured = noise_sigma(&noisy(sigma));
            assert!((measured / sigma - 1.0).abs() < 0.2, "{measured} for {sigma}");
        }
        assert!(noise_sigma(&GrayImage::from_fn(50, 50, |_, _| 7)) > 0.0);
        assert!(noise_sigma(&GrayImage::new(1, 1)) > 0.0);
    }

    #[test]
    fn faint_steps_become_plain_and_noise_does_not() {
        let image = GrayImage::from_fn(120, 80, |x, y| if x / 10 % 2 == y / 10 % 2 { 100 } else { 103 });
        let (out, gain) = ContrastAmplifier::default().amplify(&image);
        assert!(gain > 5.0);
        let (low, high) = (out.get(45, 45).unwrap(), out.get(55, 45).unwrap());
        assert!(low.abs_diff(high) >= 14, "{low} {high}");
        let (out, gain) = ContrastAmplifier::default().amplify(&noisy(5.0));
        assert!(gain < 2.0, "{gain}");
        assert!(
            out.as_raw().iter().filter(|pixel| pixel.abs_diff(128) > 7).count() < out.as_raw().len() / 50
        );
    }

    #[test]
    fn any_size_is_taken() {
        for (width, height) in [(0, 0), (1, 1), (3, 40), (40, 3)] {
            let image = GrayImage::from_fn(width, height, |x, y| (x * 7 + y * 3) as u8);
            let (out, _) = ContrastAmplifier::default().amplify(&image);
            assert_eq!((out.width(), out.height()), (width, height));
        }
    }
}
