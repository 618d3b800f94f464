//! Finding a path of gray levels again: the shift along the path, in pixels of the level.

use nalgebra::Vector2;

use super::paths::{HALF_PATH, MAX_PATH, MAX_SEARCH, Paths};

/// Gray levels of a path compared.
const PATH: usize = 2 * HALF_PATH + 1;
/// Largest shift from the guess, pixels of the level.
const MAX_SHIFT: usize = 3;
/// What is read of either image, so that a path can be shifted there and back.
const HALF_READ: usize = HALF_PATH + MAX_SHIFT + 1;
const READ: usize = 2 * HALF_READ + 1;
/// A path and what was read, lengthened to whole vectors; what is behind the end has no weight.
const PADDED: usize = PATH.next_multiple_of(4);
const PADDED_READ: usize = READ + PADDED - PATH;

/// Weights of a path: Gaussian, sigma 2.5 pixels, so the edge itself counts most and its neighbors least.
const WEIGHTS: [f32; PADDED] =
    [0.1353, 0.2780, 0.4868, 0.7261, 0.9231, 1.0, 0.9231, 0.7261, 0.4868, 0.2780, 0.1353, 0.0];
const WEIGHT_SUM: f32 = 6.0986;
/// Iterations end when the shift changes by less than this, pixels.
const MIN_STEP: f32 = 0.01;
const MAX_ITERATIONS: usize = 8;
/// Least standard deviation of a weighted path, gray levels: below, there is no contrast to follow.
const MIN_CONTRAST: f32 = 2.0;

/// Where a path was found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aligned {
    /// From the guess, pixels of the level.
    pub shift: f32,
    /// Of the path with what was found, -1 to 1.
    pub correlation: f32,
    /// How far from its beginning the found path leads when followed back, pixels of the level; 0 if not
    /// asked for.
    pub forward_backward: f32,
}

/// Finds paths again; holds what the search on the coarsest level sums up.
#[derive(Clone, Debug, Default)]
pub(super) struct Aligner {
    /// Sum of squared differences for each offset of the search, from the most negative one.
    costs: Vec<f32>,
}

impl Aligner {
    pub fn begin_search(&mut self, max_offset: usize) {
        self.costs.clear();
        self.costs.resize(2 * max_offset.min(MAX_SEARCH) + 1, 0.0);
    }

    /// Adds how well the path at `old` fits at `expected` under each offset, whatever the brightness.
    pub fn add_to_search(&mut self, paths: &Paths, old: Vector2<f32>, expected: Vector2<f32>) {
        let (mut template, mut buffer) = ([0.0; PATH], [0.0; MAX_PATH]);
        let found = &mut buffer[..PATH + self.costs.len() - 1];
        paths.read_last(old, &mut template);
        paths.read_next(expected, found);
        for (cost, window) in self.costs.iter_mut().zip(found.windows(PATH)) {
            let (mut sum, mut squares) = (0.0, 0.0);
            for i in 0..PATH {
                let difference = window[i] - template[i];
                sum += difference;
                squares += difference * difference;
            }
            *cost += squares - sum * sum / PATH as f32;
        }
    }

    /// The offset of least cost, pixels of the level; the smallest of equals.
    pub fn best_offset(&self) -> i32 {
        let middle = (self.costs.len() / 2) as i32;
        let offsets = (0..).map(|index: i32| index - middle);
        let by_cost = self
            .costs
            .iter()
            .zip(offsets)
            .min_by(|a, b| a.0.total_cmp(b.0).then_with(|| (a.1.abs(), a.1).cmp(&(b.1.abs(), b.1))));
        by_cost.map_or(0, |(_, offset)| offset)
    }

    /// Finds the path across `old` near `new`; with `and_back`, also follows it back. `None` if the path has
    /// no contrast or leaves the stretch that was read.
    pub fn align(
        &self,
        paths: &Paths,
        old: Vector2<f32>,
        new: Vector2<f32>,
        and_back: bool,
    ) -> Option<Aligned> {
        let (mut last, mut next) = ([0.0; PADDED_READ], [0.0; PADDED_READ]);
        paths.read_last(old, &mut last[..READ]);
        paths.read_next(new, &mut next[..READ]);
        let forward = align_profiles(&last, 0.0, &next, 0.0)?;
        let forward_backward = if and_back {
            // The found path, whose own place in `next` is its shift, starts from where it would lie had it
            // not moved.
            let backward = align_profiles(&next, forward.shift, &last, 0.0)?;
            backward.shift.abs()
        } else {
            0.0
        };
        Some(Aligned { forward_backward, ..forward })
    }
}

/// Finds the path about `from_shift` of `from` in `to`, starting at `guess`; both as offsets from the middle.
/// Gauss-Newton on the weighted squared differences, brightness free, with the gradient of `from` throughout.
fn align_profiles(
    from: &[f32; PADDED_READ],
    from_shift: f32,
    to: &[f32; PADDED_READ],
    guess: f32,
) -> Option<Aligned> {
    let template = window(from, from_shift)?;
    let (before, after) = (window(from, from_shift - 0.5)?, window(from, from_shift + 0.5)?);
    let gradient: [f32; PADDED] = std::array::from_fn(|i| after[i] - before[i]);
    let gradient = centered(&gradient);
    let template = centered(&template);
    let contrast = weighted_dot(&template, &template);
    let stiffness = weighted_dot(&gradient, &gradient);
    if !(contrast >= MIN_CONTRAST * MIN_CONTRAST * WEIGHT_SUM && stiffness > 0.0) {
        return None;
    }
    let mut shift = guess;
    let mut found = centered(&window(to, shift)?);
    for _ in 0..MAX_ITERATIONS {
        let residual: [f32; PADDED] = std::array::from_fn(|i| found[i] - template[i]);
        let step = weighted_dot(&gradient, &residual) / stiffness;
        shift -= step.clamp(-1.0, 1.0);
        found = centered(&window(to, shift)?);
        if step.abs() < MIN_STEP {
            break;
        }
    }
    let energy = (contrast * weighted_dot(&found, &found)).sqrt();
    let correlation = if energy > 0.0 { weighted_dot(&template, &found) / energy } else { 0.0 };
    Some(Aligned { shift, correlation, forward_backward: 0.0 })
}

/// The path about an offset from the middle of what was read, interpolated; `None` beyond it.
#[inline]
fn window(read: &[f32; PADDED_READ], offset: f32) -> Option<[f32; PADDED]> {
    let first = offset + (HALF_READ - HALF_PATH) as f32;
    if !(first >= 0.0 && first < (READ - PATH) as f32) {
        return None;
    }
    let whole = first as usize;
    let part = first - whole as f32;
    let values = &read[whole..whole + PADDED + 1];
    Some(std::array::from_fn(|i| values[i] + part * (values[i + 1] - values[i])))
}

/// Less its weighted mean: what a change of brightness leaves.
#[inline]
fn centered(path: &[f32; PADDED]) -> [f32; PADDED] {
    let mean = sum(std::array::from_fn(|i| path[i] * WEIGHTS[i])) / WEIGHT_SUM;
    path.map(|value| value - mean)
}

#[inline]
fn weighted_dot(a: &[f32; PADDED], b: &[f32; PADDED]) -> f32 {
    sum(std::array::from_fn(|i| WEIGHTS[i] * a[i] * b[i]))
}

/// The sum in an order that vectors of four can follow.
#[inline]
fn sum(values: [f32; PADDED]) -> f32 {
    let lanes: [f32; 4] = std::array::from_fn(|i| values[i] + values[i + 4] + values[i + 8]);
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A soft step at `position` from the middle.
    fn step(position: f32) -> [f32; PADDED_READ] {
        std::array::from_fn(|i| 100.0 + 60.0 * ((i as f32 - HALF_READ as f32 - position) / 1.2).tanh())
    }

    #[test]
    fn weights_sum_up() {
        assert!((WEIGHTS.iter().sum::<f32>() - WEIGHT_SUM).abs() < 1e-3);
    }

    #[test]
    fn a_shifted_step_is_found_whatever_the_brightness() {
        for shift in [-2.6, -1.0, -0.3, 0.0, 0.45, 1.7, 2.5] {
            let brighter = step(shift).map(|value| 1.1 * value + 20.0);
            let found = align_profiles(&step(0.0), 0.0, &brighter, 0.0).unwrap();
            assert!((found.shift - shift).abs() < 0.06, "{} for {shift}", found.shift);
            assert!(found.correlation > 0.99);
        }
        assert!(align_profiles(&[7.0; PADDED_READ], 0.0, &step(0.0), 0.0).is_none());
        let opposite = step(0.0).map(|value| 255.0 - value);
        assert!(align_profiles(&step(0.0), 0.0, &opposite, 0.0).is_none_or(|found| found.correlation < 0.0));
    }
}
