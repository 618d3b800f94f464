//! How many rectangles as good as a given one would be found in noise, and trimming rectangles to be better.

use std::f64::consts::{LN_10, PI};

use super::PRECISION;
use super::field::Field;
use super::rectangle::Rectangle;

/// Precisions tried: each half the one before.
const N_PRECISIONS: usize = 6;
/// Widths tried, and by how much each is narrower than the one before, pixels.
const N_WIDTHS: usize = 5;
const WIDTH_STEP: f64 = 0.5;
/// A rectangle gets no narrower than this, pixels.
const MIN_WIDTH: f64 = 0.5;
/// The tail of a binomial sum may be left out once it is below this share of it.
const TAIL_TOLERANCE: f64 = 0.1;
/// Larger rectangles are judged as if they had so many pixels: a bound on the table below.
const MAX_PIXELS: usize = 1 << 20;

/// Judges rectangles; keeps its tables and buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Judge {
    /// log10 of the number of rectangles in an image: `(width height)^(5/2)`, times 11 precisions and widths.
    log_n_tests: f64,
    min_pixels: usize,
    /// `ln n!`, as far as it has been needed.
    ln_factorial: Vec<f64>,
    /// Of each pixel in the rectangle: its place across, and the cosine of its direction with the
    /// rectangle's.
    across: Vec<f32>,
    cosine: Vec<f32>,
}

/// A rectangle as judged: how precisely directions must agree, and how rare it is.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    across: [f64; 2],
    /// The chance of agreement is `PRECISION / 2^halvings`.
    halvings: usize,
    /// `-log10 NFA`.
    rarity: f64,
}

impl Judge {
    /// Prepares for an image of the given size, pixels.
    pub fn start_image(&mut self, width: usize, height: usize) {
        self.log_n_tests = 2.5 * ((width as f64).log10() + (height as f64).log10()) + 11f64.log10();
        self.min_pixels = (-self.log_n_tests / PRECISION.log10()).max(0.0) as usize;
    }

    /// Fewer pixels can never be meaningful, even if all agree.
    pub fn min_pixels(&self) -> usize {
        self.min_pixels
    }

    /// The rectangle, made narrower or more precise if need be, if it is not expected even once in noise.
    pub fn improve(&mut self, field: &Field, mut rectangle: Rectangle) -> Option<Rectangle> {
        self.gather(field, &rectangle);
        let mut best = Candidate { across: rectangle.across, halvings: 0, rarity: f64::NEG_INFINITY };
        let stages: [fn(&mut Self, &mut Candidate); 6] = [
            |judge, best| judge.consider(*best, best),
            Self::try_precisions,
            |judge, best| judge.try_widths(best, 0.5, 0.5),
            |judge, best| judge.try_widths(best, 1.0, 0.0),
            |judge, best| judge.try_widths(best, 0.0, 1.0),
            Self::try_precisions,
        ];
        for stage in stages {
            stage(self, &mut best);
            if best.rarity > 0.0 {
                rectangle.across = best.across;
                return Some(rectangle);
            }
        }
        None
    }

    /// Collects the pixels in a rectangle. All rectangles tried for it lie inside.
    fn gather(&mut self, field: &Field, rectangle: &Rectangle) {
        self.across.clear();
        self.cosine.clear();
        let (direction, normal) = (rectangle.direction.cast::<f32>(), rectangle.normal());
        rectangle.visit_rows(field.width, field.height, |row, from, to| {
            let dy = row as f64 - rectangle.center.y;
            let first = normal.x * (from as f64 - rectangle.center.x) + normal.y * dy;
            let at = (row + 1) * field.stride + 1;
            self.across.extend((0..=to - from).map(|i| (first + normal.x * i as f64) as f32));
            self.cosine.extend(field.direction[at + from..=at + to].iter().map(|d| d.dot(&direction)));
        });
    }

    fn try_precisions(&mut self, best: &mut Candidate) {
        let from = *best;
        for i in 1..N_PRECISIONS {
            self.consider(Candidate { halvings: from.halvings + i, ..from }, best);
        }
    }

    /// Narrows by steps, of which the given shares are cut off either side.
    fn try_widths(&mut self, best: &mut Candidate, left: f64, right: f64) {
        let mut tried = *best;
        for _ in 0..N_WIDTHS {
            if tried.across[1] - tried.across[0] - WIDTH_STEP < MIN_WIDTH {
                break;
            }
            tried.across[0] += left * WIDTH_STEP;
            tried.across[1] -= right * WIDTH_STEP;
            self.consider(tried, best);
        }
    }

    /// Replaces `best` by `candidate` if that is rarer.
    fn consider(&mut self, mut candidate: Candidate, best: &mut Candidate) {
        let p = PRECISION / f64::from(1u32 << candidate.halvings);
        let (n, k) = self.count(candidate.across, (PI * p).cos());
        candidate.rarity = self.rarity(n, k, p, best.rarity);
        if candidate.rarity > best.rarity {
            *best = candidate;
        }
    }

    /// Pixels between two lines along the rectangle, and those of them that agree with its direction.
    fn count(&self, [low, high]: [f64; 2], min_cosine: f64) -> (usize, usize) {
        let (low, high, min_cosine) = (low as f32 - 1e-4, high as f32 + 1e-4, min_cosine as f32);
        let (mut n, mut k) = (0u32, 0u32);
        for (&across, &cosine) in self.across.iter().zip(&self.cosine) {
            let inside = u32::from(across >= low) & u32::from(across <= high);
            n += inside;
            k += inside & u32::from(cosine >= min_cosine);
        }
        (n as usize, k as usize)
    }

    /// `-log10` of the expected number of rectangles in noise with at least `k` of `n` pixels that agree by
    /// chance `p`; or anything up to `enough` if it does not exceed that.
    fn rarity(&mut self, n: usize, k: usize, p: f64, enough: f64) -> f64 {
        if n == 0 || k == 0 {
            return -self.log_n_tests;
        }
        let (n, k) = (n.min(MAX_PIXELS), k.min(n.min(MAX_PIXELS)));
        self.extend_factorials(n);
        let ln = &self.ln_factorial;
        let ln_first = ln[n] - ln[k] - ln[n - k] + k as f64 * p.ln() + (n - k) as f64 * (1.0 - p).ln();
        // The sum is at least its first term.
        let bound = -ln_first / LN_10 - self.log_n_tests;
        if bound <= enough {
            return bound;
        }
        if k as f64 <= n as f64 * p {
            // No rarer than the average: the sum is about a half or more, and its terms grow at first.
            return -self.log_n_tests;
        }
        // term(j + 1) / term(j) = (n - j) / (j + 1) p / (1 - p), which falls with j.
        let odds = p / (1.0 - p);
        let (mut term, mut sum) = (1.0f64, 1.0f64);
        for j in k..n {
            let ratio = (n - j) as f64 / (j + 1) as f64 * odds;
            term *= ratio;
            sum += term;
            if term * ratio <= TAIL_TOLERANCE * sum * (1.0 - ratio) {
                break;
            }
        }
        bound - sum.log10()
    }

    fn extend_factorials(&mut self, n: usize) {
        if self.ln_factorial.is_empty() {
            self.ln_factorial.push(0.0);
        }
        for i in self.ln_factorial.len()..=n {
            self.ln_factorial.push(self.ln_factorial[i - 1] + (i as f64).ln());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The binomial tail by its definition.
    fn tail(n: usize, k: usize, p: f64) -> f64 {
        let choose = |j: usize| (0..j).map(|i| (n - i) as f64 / (j - i) as f64).product::<f64>();
        (k..=n).map(|j| choose(j) * p.powi(j as i32) * (1.0 - p).powi((n - j) as i32)).sum()
    }

    #[test]
    fn rarity_is_that_of_the_binomial_tail() {
        let mut judge = Judge::default();
        judge.start_image(512, 384);
        assert!((judge.log_n_tests - (2.5 * (512.0f64 * 384.0).log10() + 11f64.log10())).abs() < 1e-9);
        for (n, k, p) in
            [(16, 16, 0.125), (30, 20, 0.125), (100, 40, 0.125), (60, 15, 0.0625), (200, 30, 0.125)]
        {
            let expected = -judge.log_n_tests - tail(n, k, p).log10();
            let rarity = judge.rarity(n, k, p, f64::NEG_INFINITY);
            // The tail left out is worth a tenth of the sum at most.
            assert!((-1e-6..0.05).contains(&(rarity - expected)), "{n}, {k}, {p}: {rarity}, {expected}");
        }
        assert_eq!(judge.rarity(0, 0, 0.125, f64::NEG_INFINITY), -judge.log_n_tests);
        assert_eq!(judge.rarity(80, 5, 0.125, f64::NEG_INFINITY), -judge.log_n_tests);
    }

    #[test]
    fn too_few_pixels_are_never_rare() {
        let mut judge = Judge::default();
        judge.start_image(602, 384);
        let min = judge.min_pixels();
        assert!(judge.rarity(min - 1, min - 1, PRECISION, f64::NEG_INFINITY) < 0.0);
        assert!(judge.rarity(min + 1, min + 1, PRECISION, f64::NEG_INFINITY) > 0.0);
    }
}
