//! Shrinking an image under a Gaussian, which takes the staircase out of slanted edges.
//!
//! The Gaussian is separable: first old rows are blended into a new one, then old columns of that. The second
//! step would read with a stride that no vector instruction likes, so eight new rows are blended before it
//! and stored side by side, one strip of eight values for each column:
//!
//! ```text
//!   old rows          blended rows, with margins           strips                      new pixels
//!
//!   y-2 ....  w0 ┐    row 0   m m . . . . . . m m   column:  0 1 2 3 …          x = 0: w0 [0] + w1 [1] + …
//!   y-1 ....  w1 ├──► row 1   m m . . . . . . m m   ──►   lane 0   . . . .     ──►    of whole strips: eight
//!   y   ....  w2 │    …                                    lane 1   . . . .            rows at a time
//!   y+1 ....  w3 ┘    row 7   m m . . . . . . m m          …
//! ```
//!
//! The margins `m` hold the pixels inside, mirrored at the edge, so that the inner loop asks no questions.

use crate::GrayImage;

/// Standard deviation of the Gaussian, pixels of the shrunk image.
const SIGMA: f64 = 0.6;
/// Below this share of the largest one, weights are left out.
const SMALLEST_WEIGHT: f64 = 1e-3;
/// Rows shrunk together, so that the processor can take as many pixels at a time.
const LANES: usize = 8;

/// A shrunk image, gray levels not rounded, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Shrunk {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<f32>,
}

/// Shrinks images; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Rescaler {
    shrunk: Shrunk,
    /// Rows of the original in floating point, for as long as they are needed: row `y` is in slot `y % n`.
    rows_in_use: Vec<RowInUse>,
    /// A row of the original's width, blended from several, with margins.
    blended: Vec<f32>,
    /// Several such rows, column by column.
    strips: Vec<[f32; LANES]>,
    columns: Taps,
    rows: Taps,
}

/// A row of the original.
#[derive(Clone, Debug, Default)]
struct RowInUse {
    /// Of no image at first.
    y: Option<usize>,
    pixels: Vec<f32>,
}

/// Which old pixels make up each new one along an axis.
#[derive(Clone, Debug, Default)]
struct Taps {
    n_old: usize,
    n_new: usize,
    scale: f64,
    /// Weights of a new pixel.
    n_weights: usize,
    weights: Vec<f32>,
    /// The old pixel the first weight of each new one is for; the pixels beyond the image's edges count from
    /// `-margin`.
    starts: Vec<usize>,
    margin: usize,
}

impl Taps {
    /// Weights for `n_old` pixels along an axis, unless they are those at hand.
    fn prepare(&mut self, n_old: usize, scale: f64) {
        if (self.n_old, self.scale) == (n_old, scale) {
            return;
        }
        let sigma = if scale < 1.0 { SIGMA / scale } else { SIGMA };
        let radius = (sigma * (-2.0 * SMALLEST_WEIGHT.ln()).sqrt()).ceil() as usize;
        let n_used = 2 * radius + 1;
        *self = Self {
            n_old,
            n_new: (n_old as f64 * scale).ceil() as usize,
            scale,
            n_weights: n_used,
            margin: radius + 1,
            ..Self::default()
        };
        for i in 0..self.n_new {
            // New pixel `i` lies over old position `i / scale`; its weights are a Gaussian around that, sum
            // one.
            let center = i as f64 / scale;
            let nearest = (center + 0.5).floor();
            let weight = |j: usize| {
                let distance = nearest + j as f64 - radius as f64 - center;
                (-0.5 * (distance / sigma).powi(2)).exp()
            };
            let total: f64 = (0..n_used).map(weight).sum();
            self.starts.push(nearest as usize + self.margin - radius);
            self.weights.extend((0..n_used).map(|j| (weight(j) / total) as f32));
        }
    }

    /// Where the weights of new pixel `i` begin, counted from the margin, and the weights.
    fn of(&self, i: usize) -> (usize, &[f32]) {
        (self.starts[i], &self.weights[i * self.n_weights..][..self.n_weights])
    }

    /// The old pixel at `place`, counted from the margin, with what lies beyond the edges mirrored.
    fn mirrored(&self, place: usize) -> usize {
        let period = 2 * self.n_old;
        let place = (place + self.margin.next_multiple_of(period) - self.margin) % period;
        place.min(period - 1 - place)
    }
}

impl Rescaler {
    /// Shrinks `image` to `scale` times its size, rounded up.
    pub fn shrink(&mut self, image: &GrayImage, scale: f64) -> &Shrunk {
        self.prepare(image, scale);
        if image.is_empty() {
            return &self.shrunk;
        }
        let n_new = self.columns.n_new;
        let mut pixels = std::mem::take(&mut self.shrunk.pixels);
        for (i, out) in pixels.chunks_mut(LANES * n_new).enumerate() {
            for lane in 0..out.len() / n_new {
                self.blend_rows(image, i * LANES + lane);
                for (strip, &value) in self.strips.iter_mut().zip(&self.blended) {
                    strip[lane] = value;
                }
            }
            // Lanes beyond the last row hold what was there before, and are not written out.
            for x in 0..n_new {
                let (start, weights) = self.columns.of(x);
                let sums = weighted_sum(weights, &self.strips[start..][..weights.len()]);
                for (out, sum) in out[x..].iter_mut().step_by(n_new).zip(sums) {
                    *out = sum;
                }
            }
        }
        self.shrunk.pixels = pixels;
        &self.shrunk
    }

    /// Weights and buffers for an image of this size.
    fn prepare(&mut self, image: &GrayImage, scale: f64) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        self.columns.prepare(width, scale);
        self.rows.prepare(height, scale);
        self.shrunk.width = self.columns.n_new;
        self.shrunk.height = self.rows.n_new;
        self.shrunk.pixels.resize(self.columns.n_new * self.rows.n_new, 0.0);
        self.blended.resize(width + 2 * self.columns.margin, 0.0);
        self.strips.resize(self.blended.len(), [0.0; LANES]);
        self.rows_in_use.resize_with(self.rows.n_weights, RowInUse::default);
        self.rows_in_use.iter_mut().for_each(|row| row.y = None);
    }

    /// The old rows that make up new row `i`, blended into one, its margins filled with what lies inside,
    /// mirrored.
    fn blend_rows(&mut self, image: &GrayImage, i: usize) {
        let (width, margin) = (image.width() as usize, self.columns.margin);
        let (start, weights) = self.rows.of(i);
        let blended = &mut self.blended[margin..margin + width];
        blended.fill(0.0);
        for (j, &weight) in weights.iter().enumerate() {
            let y = self.rows.mirrored(start + j);
            let row = self.rows_in_use[y % self.rows.n_weights].hold(image, y);
            for (sum, &pixel) in blended.iter_mut().zip(row) {
                *sum += weight * pixel;
            }
        }
        for i in 0..margin {
            self.blended[i] = self.blended[margin + self.columns.mirrored(i)];
            self.blended[margin + width + i] =
                self.blended[margin + self.columns.mirrored(margin + width + i)];
        }
    }
}

impl RowInUse {
    /// Row `y` of `image`, taken over if it is not what is here.
    fn hold(&mut self, image: &GrayImage, y: usize) -> &[f32] {
        if self.y != Some(y) {
            self.y = Some(y);
            self.pixels.clear();
            self.pixels.extend(image.row(y as u32).iter().map(|&pixel| f32::from(pixel)));
        }
        &self.pixels
    }
}

/// The sum of `strips` by `weights`, which are as many.
#[inline]
fn weighted_sum(weights: &[f32], strips: &[[f32; LANES]]) -> [f32; LANES] {
    let mut sums = [0.0f32; LANES];
    for (&weight, strip) in weights.iter().zip(strips) {
        for i in 0..LANES {
            sums[i] += weight * strip[i];
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    #[test]
    fn shrinking_is_a_gaussian_average_mirrored_at_the_edges() {
        for (width, height, scale) in [(37, 23, 0.8), (20, 30, 0.5), (9, 5, 1.0), (2, 1, 0.8)] {
            let image = test_images::noise(width, height, 255, 4);
            let mut rescaler = Rescaler::default();
            let shrunk = rescaler.shrink(&image, scale);
            let sigma = SIGMA / scale;
            let mirror = |place: i64, n: u32| {
                let n = i64::from(n);
                let place = place.rem_euclid(2 * n);
                place.min(2 * n - 1 - place) as u32
            };
            for (i, &found) in shrunk.pixels.iter().enumerate() {
                let (x, y) = ((i % shrunk.width) as f64 / scale, (i / shrunk.width) as f64 / scale);
                let (mut sum, mut total) = (0.0, 0.0);
                for v in y as i64 - 12..=y as i64 + 12 {
                    for u in x as i64 - 12..=x as i64 + 12 {
                        let squared = (u as f64 - x).powi(2) + (v as f64 - y).powi(2);
                        let weight = (-0.5 * squared / (sigma * sigma)).exp();
                        total += weight;
                        sum += weight * f64::from(image.row(mirror(v, height))[mirror(u, width) as usize]);
                    }
                }
                let expected = sum / total;
                assert!(
                    (f64::from(found) - expected).abs() < 0.5,
                    "{i} of {width}x{height}: {found}, {expected}"
                );
            }
        }
    }
}
