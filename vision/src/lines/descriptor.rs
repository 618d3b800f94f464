//! Line descriptors, what the surroundings of a segment look like: line band descriptors (LBD) [Zhang & Koch,
//! "An efficient and robust line segment matching approach based on LBD descriptor and pairwise geometric
//! consistency", JVCIR 2013], in 256 bits.

use super::Segment;
use super::sampling::{Sampler, halve, halved_position};
use crate::{Descriptor, GrayImage};

/// Bands parallel to the segment, the middle one on it.
const N_BANDS: usize = 9;
/// Width of a band, pixels: nine cover 31.5 px on either side.
const BAND_WIDTH_PX: f32 = 7.0;
/// Rows of gradients in a band. The image is sampled in half its resolution, so more would say little new.
const ROWS_PER_BAND: usize = 3;
const N_ROWS: usize = N_BANDS * ROWS_PER_BAND;
const ROW_STEP_PX: f32 = BAND_WIDTH_PX / ROWS_PER_BAND as f32;
/// Distance of gradients along the segment, pixels, unless it is too long for that.
const COLUMN_STEP_PX: f32 = 2.0;
/// Most gradients along a segment: longer ones are sampled further apart.
const MAX_COLUMNS: usize = 64;
/// Columns are dealt with this many at a time.
const LANES: usize = 8;
/// Numbers of a row: means of the positive and of the negative parts of the gradient across and along the
/// segment.
const N_SUMS: usize = 4;
/// Numbers of a band: means and standard deviations over its rows.
const N_NUMBERS: usize = 2 * N_SUMS;

/// Pairs of bands whose numbers are compared: all 36 but the four that join the two outermost bands of one
/// side with those of the other, which a change of view moves most against each other.
const COMPARED_BANDS: [(usize, usize); 32] = compared_bands();

const fn compared_bands() -> [(usize, usize); 32] {
    let mut pairs = [(0, 0); 32];
    let (mut n, mut a) = (0, 0);
    while a < N_BANDS {
        let mut b = a + 1;
        while b < N_BANDS {
            if !(a < 2 && b >= N_BANDS - 2) {
                pairs[n] = (a, b);
                n += 1;
            }
            b += 1;
        }
        a += 1;
    }
    pairs
}

/// Describes segments; keeps its buffers.
///
/// Nine bands lie along the segment, each 7 px wide. Per band, the gradients across and along it are summed
/// by sign and weighted by their distance from the segment and from the band; means and standard deviations
/// over rows make eight numbers. Bits tell which of two bands has the larger number, so brightness and
/// contrast do not matter; the fixed bright side of [`Segment`] makes it independent of rotation.
#[derive(Clone, Debug)]
pub struct LineDescriber {
    /// The image in half its resolution.
    halved: GrayImage,
    /// Weight of each row in each band; 0 for rows further than one band away.
    weights: [[f32; N_ROWS]; N_BANDS],
    /// Gray levels on two neighboring rows of corners between gradients.
    upper: Vec<f32>,
    lower: Vec<f32>,
}

impl Default for LineDescriber {
    fn default() -> Self {
        Self::new()
    }
}

impl LineDescriber {
    /// A describer.
    pub fn new() -> Self {
        let n_corners = MAX_COLUMNS + 1;
        Self {
            halved: GrayImage::default(),
            weights: std::array::from_fn(|band| std::array::from_fn(|row| row_weight(band, row))),
            upper: vec![0.0; n_corners],
            lower: vec![0.0; n_corners],
        }
    }

    /// A descriptor for each of `segments`, in their order. Beyond its edges the image is taken to go on as
    /// at them. A segment without length, or not finite, gets the descriptor of all zeros.
    pub fn describe(&mut self, image: &GrayImage, segments: &[Segment]) -> Vec<Descriptor> {
        let mut halved = std::mem::take(&mut self.halved);
        halve(image, &mut halved);
        let descriptors = segments.iter().map(|segment| self.describe_halved(&halved, segment)).collect();
        self.halved = halved;
        descriptors
    }

    /// Describes one segment, given in pixels of the full image, by the image in half its resolution.
    pub(super) fn describe_halved(&mut self, halved: &GrayImage, segment: &Segment) -> Descriptor {
        let length = segment.length();
        if !(segment.is_finite() && length > 0.0 && length.is_finite()) {
            return Descriptor::default();
        }
        let rows = self.row_sums(&Sampler::new(halved), segment, length);
        binarize(&self.band_numbers(&rows))
    }

    /// The mean gradient of each row, by axis and sign: across positive, across negative, along positive,
    /// along negative.
    fn row_sums(&mut self, sampler: &Sampler, segment: &Segment, length: f32) -> [[f32; N_SUMS]; N_ROWS] {
        // A whole number of lanes; comparing long with longer keeps the conversion within range.
        let wanted = (length / COLUMN_STEP_PX).min(MAX_COLUMNS as f32) as usize;
        let n_columns = wanted.next_multiple_of(LANES).clamp(LANES, MAX_COLUMNS);
        let column_step_px = length / n_columns as f32;
        let (direction, normal) = (segment.direction(), segment.normal());
        let step = direction * (column_step_px * 0.5);
        let path = |corner_row: usize, out: &mut [f32]| {
            let offset = (corner_row as f32 - 0.5 * N_ROWS as f32) * ROW_STEP_PX;
            sampler.clamped_path(halved_position(segment.start + normal * offset, 1), step, out);
        };
        path(0, &mut self.upper[..=n_columns]);
        std::array::from_fn(|row| {
            path(row + 1, &mut self.lower[..=n_columns]);
            let sums = gradient_sums(&self.upper[..=n_columns], &self.lower[..=n_columns]);
            std::mem::swap(&mut self.upper, &mut self.lower);
            let (across, along) =
                (0.5 / (ROW_STEP_PX * n_columns as f32), 0.5 / (column_step_px * n_columns as f32));
            [sums[0] * across, sums[1] * across, sums[2] * along, sums[3] * along]
        })
    }

    /// Means, then standard deviations, of the weighted rows of each band and its neighbors.
    fn band_numbers(&self, rows: &[[f32; N_SUMS]; N_ROWS]) -> [[f32; N_NUMBERS]; N_BANDS] {
        std::array::from_fn(|band| {
            let near = band.saturating_sub(1) * ROWS_PER_BAND..((band + 2) * ROWS_PER_BAND).min(N_ROWS);
            let n = near.len() as f32;
            let mut numbers = [0.0; N_NUMBERS];
            for sum in 0..N_SUMS {
                let (mut total, mut squares) = (0.0, 0.0);
                for row in near.clone() {
                    let value = self.weights[band][row] * rows[row][sum];
                    total += value;
                    squares += value * value;
                }
                let mean = total / n;
                numbers[sum] = mean;
                numbers[N_SUMS + sum] = (squares / n - mean * mean).max(0.0).sqrt();
            }
            numbers
        })
    }
}

/// Sums over cells between two rows of corners: positive and negative parts of the differences across and
/// along, each twice the gradient times the step.
fn gradient_sums(upper: &[f32], lower: &[f32]) -> [f32; N_SUMS] {
    let mut sums = [[0.0f32; LANES]; N_SUMS];
    let n = upper.len() - 1;
    for first in (0..n).step_by(LANES) {
        let (a, c) = (&upper[first..=first + LANES], &lower[first..=first + LANES]);
        for i in 0..LANES {
            let (falling, rising) = (c[i + 1] - a[i], c[i] - a[i + 1]);
            let (across, along) = (falling + rising, falling - rising);
            sums[0][i] += across.max(0.0);
            sums[1][i] += (-across).max(0.0);
            sums[2][i] += along.max(0.0);
            sums[3][i] += (-along).max(0.0);
        }
    }
    sums.map(|lanes| lanes.iter().sum())
}

/// Gaussian in the distance from the segment (sigma 31 px) times Gaussian in the distance from the band
/// (sigma 7 px).
fn row_weight(band: usize, row: usize) -> f32 {
    if (row / ROWS_PER_BAND).abs_diff(band) > 1 {
        return 0.0;
    }
    let position = (row as f32 + 0.5) * ROW_STEP_PX;
    let middle = 0.5 * N_BANDS as f32 * BAND_WIDTH_PX;
    let gaussian = |distance: f32, sigma: f32| (-0.5 * (distance / sigma).powi(2)).exp();
    gaussian(position - middle, 0.5 * (N_BANDS as f32 * BAND_WIDTH_PX - 1.0))
        * gaussian(position - (band as f32 + 0.5) * BAND_WIDTH_PX, BAND_WIDTH_PX)
}

/// Compares bands number by number. A common factor of all numbers changes nothing, so they need no
/// normalization.
fn binarize(bands: &[[f32; N_NUMBERS]; N_BANDS]) -> Descriptor {
    let mut words = [0u64; 4];
    for (pair, &(a, b)) in COMPARED_BANDS.iter().enumerate() {
        for (number, (of_a, of_b)) in bands[a].iter().zip(&bands[b]).enumerate() {
            let bit = N_NUMBERS * pair + number;
            words[bit / 64] |= u64::from(of_a > of_b) << (bit % 64);
        }
    }
    Descriptor(words)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector2};

    use super::*;
    use crate::lines::test_scenes::{Scene, similarity};
    use crate::test_images::noise;

    const SIZE: (u32, u32) = (480, 360);
    const CENTER: Vector2<f32> = Vector2::new(240.0, 180.0);

    /// Of the edges seen in both views: the share whose nearest descriptor is their own, and the mean
    /// distances of descriptors of the same edge and of different edges.
    fn recognized(view: &Matrix3<f32>, gain: f32, offset: f32) -> (f32, f32, f32) {
        let scene = Scene::new(SIZE.0, SIZE.1, 5);
        let mut describer = LineDescriber::new();
        let mut describe = |view: &Matrix3<f32>, gain, offset| {
            let (numbers, segments): (Vec<_>, Vec<_>) = scene.segments(SIZE, view).into_iter().unzip();
            let descriptors = describer.describe(&scene.render(SIZE, view, gain, offset), &segments);
            assert_eq!(descriptors.len(), segments.len());
            (numbers, descriptors)
        };
        let (numbers, descriptors) = describe(&Matrix3::identity(), 1.0, 0.0);
        let (numbers_again, descriptors_again) = describe(view, gain, offset);
        let (mut n, mut n_right, mut same, mut different) = (0, 0, 0, 0);
        for (number, descriptor) in numbers.iter().zip(&descriptors) {
            let Some(own) = numbers_again.iter().position(|again| again == number) else { continue };
            let distances: Vec<u32> =
                descriptors_again.iter().map(|again| descriptor.distance(again)).collect();
            n += 1;
            n_right += u32::from(distances.iter().min() == Some(&distances[own]));
            same += distances[own];
            different += (distances.iter().sum::<u32>() - distances[own]) / (distances.len() as u32 - 1);
        }
        assert!(n > 40, "only {n} edges are in both views");
        let share = |count: u32| count as f32 / n as f32;
        (share(n_right), share(same), share(different))
    }

    #[test]
    fn edges_are_recognized_after_turning_scaling_and_relighting() {
        let still = Vector2::zeros();
        for (name, view, gain, offset, least) in [
            ("the same", Matrix3::identity(), 1.0, 0.0, 0.99),
            ("relit", Matrix3::identity(), 0.7, 35.0, 0.95),
            ("moved", similarity(CENTER, 1.0, 0.0, Vector2::new(7.3, -4.6)), 1.0, 0.0, 0.9),
            ("turned", similarity(CENTER, 1.0, 30.0, still), 1.0, 0.0, 0.8),
            ("scaled", similarity(CENTER, 1.1, 0.0, still), 1.0, 0.0, 0.7),
            ("all of it", similarity(CENTER, 0.9, -12.0, Vector2::new(5.0, 5.0)), 1.2, -20.0, 0.8),
        ] {
            let (share, same, different) = recognized(&view, gain, offset);
            println!(
                "{name}: {share:.2} recognised, {same:.1} bits from themselves, {different:.1} from others"
            );
            assert!(share >= least, "{name}: {share} recognised");
            assert!(same < 30.0 && different > 60.0, "{name}: {same} bits, others {different}");
        }
    }

    #[test]
    fn the_bright_side_matters() {
        let image = GrayImage::from_fn(120, 90, |x, y| if y < 45 { 60 } else { 150 + (x / 10) as u8 });
        let segment = |start: (f32, f32), end: (f32, f32)| Segment {
            start: Vector2::new(start.0, start.1),
            end: Vector2::new(end.0, end.1),
            sigma_px: 0.3,
            gradient: 40.0,
        };
        let there = segment((20.0, 44.5), (100.0, 44.5));
        let back = segment((100.0, 44.5), (20.0, 44.5));
        let descriptors = LineDescriber::new().describe(&image, &[there, back]);
        assert!(descriptors[0].distance(&descriptors[1]) > 60);
    }

    #[test]
    fn anything_can_be_described() {
        let mut describer = LineDescriber::new();
        let segment = |x: f32, y: f32| Segment {
            start: Vector2::new(1.0, 2.0),
            end: Vector2::new(x, y),
            sigma_px: 0.3,
            gradient: 9.0,
        };
        let segments =
            [segment(1.0, 2.0), segment(f32::NAN, 3.0), segment(1e30, 1e30), segment(-900.0, 7000.0)];
        for (width, height) in [(0, 0), (1, 1), (3, 2), (64, 48)] {
            let descriptors = describer.describe(&noise(width, height, 255, 1), &segments);
            assert_eq!(descriptors[..2], [Descriptor::default(); 2]);
            assert_eq!(descriptors.len(), 4);
        }
        assert!(describer.describe(&noise(64, 48, 255, 1), &[]).is_empty());
    }
}
