//! Following an edge from pixel to pixel.

use nalgebra::Vector2;

use crate::lines::gradient::Gradients;

/// Follows edges of one image after another; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Walker {
    min_magnitude: i16,
    /// Per pixel: [`FREE`], [`BESIDE`] or [`ON`] an edge followed before.
    state: Vec<u8>,
    chain: Vec<u32>,
}

const FREE: u8 = 0;
/// Next to a pixel of an edge, across it: no anchor, but other edges may pass.
const BESIDE: u8 = 1;
/// On an edge: taken.
const ON: u8 = 2;

impl Walker {
    /// Prepares for another image, in which edges are at least `min_magnitude` strong.
    pub fn start_image(&mut self, gradients: &Gradients, min_magnitude: i16) {
        // Where there is no gradient at all, such as on the image's outermost pixels, no edge is followed.
        self.min_magnitude = min_magnitude.max(1);
        self.state.clear();
        self.state.resize(gradients.magnitude.len(), FREE);
    }

    /// The pixels of the edge through `anchor`, in the edge's direction; none if the edge has been followed
    /// before.
    pub fn follow(&mut self, gradients: &Gradients, anchor: usize) -> &[u32] {
        self.chain.clear();
        if self.state[anchor] != FREE {
            return &self.chain;
        }
        self.walk::<false>(gradients, anchor);
        self.chain.reverse();
        if let Some(next) = self.successor::<true>(gradients, anchor) {
            self.walk::<true>(gradients, next);
        }
        &self.chain
    }

    /// Appends pixels from `start` on, forwards or backwards.
    fn walk<const FORWARDS: bool>(&mut self, gradients: &Gradients, start: usize) {
        let mut at = start;
        loop {
            self.chain.push(at as u32);
            let across = if runs_along_x(gradients, at) { gradients.width } else { 1 };
            self.state[at] = ON;
            for side in [at - across, at + across] {
                self.state[side] = self.state[side].max(BESIDE);
            }
            match self.successor::<FORWARDS>(gradients, at) {
                Some(next) => at = next,
                None => break,
            }
        }
    }

    /// The strongest of the three pixels ahead, if the edge goes on there and nobody has been there.
    #[inline(always)]
    fn successor<const FORWARDS: bool>(&self, gradients: &Gradients, at: usize) -> Option<usize> {
        let (gx, gy) = (gradients.x[at], gradients.y[at]);
        // The direction with the brighter side to its right is (gy, -gx).
        let (forwards, across) =
            if runs_along_x(gradients, at) { (gy > 0, 1) } else { (gx < 0, gradients.width) };
        let (step, side) = (across, if across == 1 { gradients.width } else { 1 });
        let ahead = if forwards == FORWARDS { at + step } else { at - step };
        let magnitude = &gradients.magnitude;
        let mut best = ahead;
        for candidate in [ahead - side, ahead + side] {
            if magnitude[candidate] > magnitude[best] {
                best = candidate;
            }
        }
        let (next_gx, next_gy) = (gradients.x[best], gradients.y[best]);
        let same_polarity = i32::from(gx) * i32::from(next_gx) + i32::from(gy) * i32::from(next_gy) > 0;
        (magnitude[best] >= self.min_magnitude && self.state[best] != ON && same_polarity).then_some(best)
    }
}

/// Whether the edge at a pixel runs along x rather than along y.
#[inline]
fn runs_along_x(gradients: &Gradients, at: usize) -> bool {
    gradients.y[at].abs() > gradients.x[at].abs()
}

/// The positions of a chain's pixels to a fraction: on the gradient's maximum across the edge, by a parabola.
pub(super) fn sub_pixel(gradients: &Gradients, chain: &[u32], points: &mut Vec<Vector2<f32>>) {
    points.clear();
    let width = gradients.width as u32;
    points.extend(chain.iter().map(|&pixel| {
        let at = pixel as usize;
        let along_x = runs_along_x(gradients, at);
        let (field, stride) = if along_x { (&gradients.y, gradients.width) } else { (&gradients.x, 1) };
        let [before, center, after] =
            [at - stride, at, at + stride].map(|at| f32::from(field[at].saturating_abs()));
        let curvature = before - 2.0 * center + after;
        // A pixel beside the ridge may lie on the slope of the profile: it is at most a pixel off.
        let offset =
            if curvature < -1.0 { (0.5 * (before - after) / curvature).clamp(-1.0, 1.0) } else { 0.0 };
        let (x, y) = ((pixel % width) as f32, (pixel / width) as f32);
        if along_x { Vector2::new(x, y + offset) } else { Vector2::new(x + offset, y) }
    }));
}
