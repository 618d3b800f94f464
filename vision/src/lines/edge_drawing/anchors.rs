//! Where edges are followed from: pixels on the crest of the gradient across the edge.

use crate::lines::gradient::{Gradients, UNITS_PER_LEVEL};
use crate::vectorized;

/// An anchor's gradient exceeds those of its two neighbors across the edge by this in all, gray levels per
/// pixel.
const MIN_PROMINENCE: i16 = UNITS_PER_LEVEL as i16;
/// Every so-many-th pixel along an edge may be an anchor; one is enough to find the edge.
const STEP: i16 = 2;
/// Magnitudes are sorted into bins of 256.
const BIN_SHIFT: u32 = 8;
const N_BINS: usize = 128;

/// Finds anchors; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Anchors {
    /// Per inner pixel of a row, 1 for an anchor.
    flags: Vec<u8>,
    found: Vec<u32>,
    sorted: Vec<u32>,
}

impl Anchors {
    /// The anchors of an image as pixel indices, those with the largest gradient first (up to the width of a
    /// bin), in reading order otherwise.
    pub fn find(&mut self, gradients: &Gradients, min_magnitude: i16) -> &[u32] {
        let (width, height) = (gradients.width, gradients.height);
        self.found.clear();
        if width < 3 {
            self.sorted.clear();
            return &self.sorted;
        }
        for y in 1..height.saturating_sub(1) {
            vectorized(
                #[inline(always)]
                || self.flag_row(gradients, y, min_magnitude),
            );
            let (chunks, rest) = self.flags.as_chunks::<8>();
            for (chunk_index, chunk) in chunks.iter().enumerate() {
                // Flags are rare: eight are looked at together.
                let mut left = u64::from_le_bytes(*chunk);
                while left != 0 {
                    let x = 1 + 8 * chunk_index + left.trailing_zeros() as usize / 8;
                    self.found.push((y * width + x) as u32);
                    left &= left - 1;
                }
            }
            let begin = 1 + self.flags.len() - rest.len();
            let last = rest.iter().enumerate().filter(|&(_, &flag)| flag != 0);
            self.found.extend(last.map(|(i, _)| (y * width + begin + i) as u32));
        }
        self.sort(gradients)
    }

    /// Flags pixels 1 to `width - 2` of row `y`: 1 for an anchor, 0 for none. Edges that run along x are cut
    /// by every so-many-th column, the others by rows. Without branches: many pixels are done at once.
    #[inline(always)]
    fn flag_row(&mut self, gradients: &Gradients, y: usize, min_magnitude: i16) {
        let n = gradients.width - 2;
        let at = y * gradients.width + 1;
        let around = |start: usize| &gradients.magnitude[start..][..n];
        let (center, left, right) = (around(at), around(at - 1), around(at + 1));
        let (above, below) = (around(at - gradients.width), around(at + gradients.width));
        let (gx, gy) = (&gradients.x[at..][..n], &gradients.y[at..][..n]);
        let on_row = if y.is_multiple_of(STEP as usize) { -1i16 } else { 0 };
        self.flags.resize(n, 0);
        for (i, flag) in self.flags.iter_mut().enumerate() {
            let along_x = mask(gy[i].abs() > gx[i].abs());
            let choose = |across: i16, other: i16| (across & along_x) | (other & !along_x);
            let before = center[i] - choose(above[i], left[i]);
            let after = center[i] - choose(below[i], right[i]);
            // An edge half way between two pixels is equally strong on both.
            let is_peak = mask(before >= 0) & mask(after >= 0);
            let is_prominent = mask(before.saturating_add(after) >= MIN_PROMINENCE);
            let on_grid = choose(mask((i as i16).wrapping_add(1) % STEP == 0), on_row);
            let is_strong = mask(center[i] >= min_magnitude);
            *flag = (is_strong & is_peak & is_prominent & on_grid & 1) as u8;
        }
    }

    /// Sorts what was found by counting.
    fn sort(&mut self, gradients: &Gradients) -> &[u32] {
        let bin = |anchor: u32| N_BINS - 1 - (gradients.magnitude[anchor as usize] >> BIN_SHIFT) as usize;
        let mut starts = [0usize; N_BINS + 1];
        for &anchor in &self.found {
            starts[bin(anchor) + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        self.sorted.resize(self.found.len(), 0);
        for &anchor in &self.found {
            let slot = &mut starts[bin(anchor)];
            self.sorted[*slot] = anchor;
            *slot += 1;
        }
        &self.sorted
    }
}

/// All bits or none.
#[inline(always)]
fn mask(condition: bool) -> i16 {
    -i16::from(condition)
}
