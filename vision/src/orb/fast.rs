//! FAST-9/16 corners [Rosten & Drummond, "Machine learning for high-speed corner detection", ECCV 2006].
//!
//! A pixel is a corner if 9 neighboring pixels of the 16 on a circle of radius 3 are all brighter, or all
//! darker, than it by more than a threshold. Its *score* is the largest threshold at which that is not yet
//! false: with `b` the largest, over the 16 arcs, of an arc's smallest pixel and `d` the smallest of an arc's
//! largest, the score is `max(b - center, center - d, 0)`. That form needs no branch, so whole vectors of
//! pixels are scored at once.

use super::OrbConfig;
#[cfg(target_arch = "x86_64")]
use super::lanes::Avx2;
use super::lanes::{Lanes, Portable};
use crate::GrayImage;

/// A corner at a whole pixel of its level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Corner {
    pub x: u16,
    pub y: u16,
    /// See the head of this file, gray levels.
    pub score: u8,
    /// From the pixel to where the corner is, once that is [refined](super::refine::Refiner), pixels.
    pub shift: (f32, f32),
}

/// The circle of 16 pixels, (dx, dy), in order around the center.
#[rustfmt::skip]
const CIRCLE: [(isize, isize); 16] = [
    (0, -3), (1, -3), (2, -2), (3, -1), (3, 0), (3, 1), (2, 2), (1, 3),
    (0, 3), (-1, 3), (-2, 2), (-3, 1), (-3, 0), (-3, -1), (-2, -2), (-1, -3),
];
/// The circle's radius, pixels.
const CIRCLE_RADIUS: usize = 3;

/// Finds corners in one level after the other; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Detector {
    /// Score of each pixel; 0 where it was found to be too small to matter.
    scores: Vec<u8>,
    /// Vectors of pixels that hold a score above the threshold.
    hits: Vec<usize>,
    occupied: Vec<bool>,
}

/// A half-open rectangle of pixels.
#[derive(Clone, Copy, Debug)]
struct Region {
    left: usize,
    top: usize,
    right: usize,
    bottom: usize,
}

impl Detector {
    /// Appends the corners of `image` to `corners`: those above `fast_threshold` that are the largest among
    /// their eight neighbors, and in cells that have none, those above `min_fast_threshold`.
    pub fn detect(&mut self, image: &GrayImage, config: &OrbConfig, corners: &mut Vec<Corner>) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let margin = config.edge_margin_px as usize;
        // Coordinates are kept in 16 bits.
        if width <= 2 * margin || height <= 2 * margin || width.max(height) > usize::from(u16::MAX) {
            return;
        }
        self.scores.clear();
        self.scores.resize(width * height, 0);
        let whole = Region { left: margin, top: margin, right: width - margin, bottom: height - margin };
        let n_before = corners.len();
        self.peaks(image, whole, config.fast_threshold, corners);

        let cell = config.cell_size_px as usize;
        let n_columns = (whole.right - whole.left).div_ceil(cell);
        let n_rows = (whole.bottom - whole.top).div_ceil(cell);
        self.occupied.clear();
        self.occupied.resize(n_columns * n_rows, false);
        for corner in &corners[n_before..] {
            let (column, row) =
                ((usize::from(corner.x) - margin) / cell, (usize::from(corner.y) - margin) / cell);
            self.occupied[row * n_columns + column] = true;
        }
        for row in 0..n_rows {
            let top = margin + row * cell;
            let mut column = 0;
            while column < n_columns {
                // Neighboring empty cells are searched as one.
                let rest = &self.occupied[row * n_columns + column..(row + 1) * n_columns];
                let n_empty = rest.iter().take_while(|&&occupied| !occupied).count();
                if n_empty > 0 {
                    let left = margin + column * cell;
                    let right = (left + n_empty * cell).min(whole.right);
                    let region = Region { left, top, right, bottom: (top + cell).min(whole.bottom) };
                    self.peaks(image, region, config.min_fast_threshold, corners);
                }
                column += n_empty.max(1);
            }
        }
    }

    /// Scores `region` and a ring of one pixel around it, and appends the local maxima above `threshold`
    /// inside it.
    fn peaks(&mut self, image: &GrayImage, region: Region, threshold: u8, corners: &mut Vec<Corner>) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && fits::<Avx2>(image) {
            // SAFETY: AVX2 has just been found.
            return unsafe { self.peaks_avx2(image, region, threshold, corners) };
        }
        if fits::<Portable>(image) {
            self.peaks_in_lanes::<Portable>(image, region, threshold, corners);
        } else {
            self.peaks_one_by_one(image, region, threshold, corners);
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn peaks_avx2(&mut self, image: &GrayImage, region: Region, threshold: u8, corners: &mut Vec<Corner>) {
        self.peaks_in_lanes::<Avx2>(image, region, threshold, corners);
    }

    #[inline(always)]
    fn peaks_in_lanes<L: Lanes>(
        &mut self,
        image: &GrayImage,
        region: Region,
        threshold: u8,
        corners: &mut Vec<Corner>,
    ) {
        let (width, pixels) = (image.width() as usize, image.as_raw());
        let circle = CIRCLE.map(|(dx, dy)| dy * width as isize + dx);
        // The last vector of a row is moved back so that its circle stays inside the row.
        let last_start = width - CIRCLE_RADIUS - L::N;
        self.hits.clear();
        for y in region.top - 1..region.bottom + 1 {
            for x in (region.left - 1..region.right + 1).step_by(L::N) {
                let at = y * width + x.min(last_start);
                if let Some(scores) = score_lanes::<L>(pixels, at, &circle, threshold) {
                    scores.store(&mut self.scores[at..]);
                    if scores.saturating_sub(L::splat(threshold)).any_non_zero() {
                        self.hits.push(at);
                    }
                }
            }
        }
        let mut next = 0;
        for &at in &self.hits {
            let mut mask = peak_mask::<L>(&self.scores, at, width, threshold);
            while mask != 0 {
                let peak = at + mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let (x, y) = (peak % width, peak / width);
                let inside =
                    (region.left..region.right).contains(&x) && (region.top..region.bottom).contains(&y);
                // A vector that was moved back repeats pixels of the one before.
                if inside && peak >= next {
                    let score = self.scores[peak];
                    corners.push(Corner { x: x as u16, y: y as u16, score, ..Corner::default() });
                    next = peak + 1;
                }
            }
        }
    }

    /// For levels too narrow for a vector.
    fn peaks_one_by_one(
        &mut self,
        image: &GrayImage,
        region: Region,
        threshold: u8,
        corners: &mut Vec<Corner>,
    ) {
        let width = image.width() as usize;
        for y in region.top - 1..region.bottom + 1 {
            for x in region.left - 1..region.right + 1 {
                self.scores[y * width + x] = score(image, x, y);
            }
        }
        for y in region.top..region.bottom {
            for x in region.left..region.right {
                let at = y * width + x;
                let score = self.scores[at];
                let (before, after) = neighbors(at, width);
                let is_peak = before.iter().all(|&i| self.scores[i] < score)
                    && after.iter().all(|&i| self.scores[i] <= score);
                if score > threshold && is_peak {
                    corners.push(Corner { x: x as u16, y: y as u16, score, ..Corner::default() });
                }
            }
        }
    }
}

/// Whether a vector and the circles of its pixels fit into a row.
fn fits<L: Lanes>(image: &GrayImage) -> bool {
    image.width() as usize >= L::N + 2 * CIRCLE_RADIUS
}

/// The eight neighbors of pixel `at`: those before it in reading order, which must be smaller than a peak,
/// and those after it, which must not be larger. So of equal neighboring scores the first is the peak.
#[inline(always)]
fn neighbors(at: usize, width: usize) -> ([usize; 4], [usize; 4]) {
    (
        [at - width - 1, at - width, at - width + 1, at - 1],
        [at + 1, at + width - 1, at + width, at + width + 1],
    )
}

/// The scores of `L::N` pixels from index `at` on, or `None` if all are certainly at most `threshold`.
#[inline(always)]
fn score_lanes<L: Lanes>(pixels: &[u8], at: usize, circle: &[isize; 16], threshold: u8) -> Option<L> {
    // The circle's lowest pixels are 3 rows down and 1 to the right, its highest as far the other way: one
    // check for what is read.
    let reach = circle[7].unsigned_abs().max(circle[9].unsigned_abs()) + CIRCLE_RADIUS;
    assert!(at >= reach && at + reach + L::N <= pixels.len(), "a circle lies in the image");
    let center = L::load(&pixels[at..]);
    let threshold = L::splat(threshold);
    // Of two opposite pixels every arc of 9 holds at least one. So no arc is brighter throughout than the
    // dimmest of the brighter ones of such pairs; four pairs dismiss most pixels.
    let upright = bounds::<L>(pixels, at, circle, 0, 4);
    if !largest_contrast(center, upright).saturating_sub(threshold).any_non_zero() {
        return None;
    }
    let diagonal = bounds::<L>(pixels, at, circle, 2, 6);
    let both = (upright.0.min(diagonal.0), upright.1.max(diagonal.1));
    if !largest_contrast(center, both).saturating_sub(threshold).any_non_zero() {
        return None;
    }
    Some(largest_contrast(center, arc_extremes::<L>(pixels, at, circle)))
}

// Functions, not closures, and loops, not `array::from_fn`, as only what is surely inlined into a caller with
// AVX2 is compiled with it.

/// Pixel `k` of the circle around each pixel, for which [`score_lanes`] has made sure that it is there.
#[inline(always)]
fn on_circle<L: Lanes>(pixels: &[u8], at: usize, circle: &[isize; 16], k: usize) -> L {
    // SAFETY: no offset of the circle is larger than the reach on either side that `score_lanes` checked.
    unsafe { L::load_unchecked(pixels, at.wrapping_add_signed(circle[k % 16])) }
}

/// How far the brightest is above `center` or the darkest below it, whichever is more.
#[inline(always)]
fn largest_contrast<L: Lanes>(center: L, (brightest, darkest): (L, L)) -> L {
    brightest.saturating_sub(center).max(center.saturating_sub(darkest))
}

/// No arc is brighter throughout than the first, none darker than the second; from the pixels `a` and `b` of
/// the circle and those opposite.
#[inline(always)]
fn bounds<L: Lanes>(pixels: &[u8], at: usize, circle: &[isize; 16], a: usize, b: usize) -> (L, L) {
    let (p, q) = (on_circle::<L>(pixels, at, circle, a), on_circle::<L>(pixels, at, circle, a + 8));
    let (r, s) = (on_circle::<L>(pixels, at, circle, b), on_circle::<L>(pixels, at, circle, b + 8));
    (p.max(q).min(r.max(s)), p.min(q).max(r.min(s)))
}

/// The largest of the 16 arcs' smallest pixels, and the smallest of their largest.
#[inline(always)]
fn arc_extremes<L: Lanes>(pixels: &[u8], at: usize, circle: &[isize; 16]) -> (L, L) {
    let mut values = [L::splat(0); 16];
    for (k, value) in values.iter_mut().enumerate() {
        *value = on_circle(pixels, at, circle, k);
    }
    // Extremes of 2, 4 and 8 neighboring pixels, from every odd position on. The arcs of 9 from an even
    // position `k` and from `k + 1` share the 8 pixels from `k + 1` on and differ in one: two arcs for one.
    let mut two = [(values[0], values[0]); 8];
    for (i, pair) in two.iter_mut().enumerate() {
        let (a, b) = (values[2 * i + 1], values[(2 * i + 2) % 16]);
        *pair = (a.min(b), a.max(b));
    }
    let eight = join(&join(&two, 1), 2);
    let mut extremes = pair_of_arcs(&values, &eight, 0);
    for i in 1..8 {
        let arcs = pair_of_arcs(&values, &eight, i);
        extremes = (extremes.0.max(arcs.0), extremes.1.min(arcs.1));
    }
    extremes
}

/// Extremes of twice as many pixels: of each part and the one `step` parts on.
#[inline(always)]
fn join<L: Lanes>(parts: &[(L, L); 8], step: usize) -> [(L, L); 8] {
    let mut joined = *parts;
    for (i, extremes) in joined.iter_mut().enumerate() {
        let next = parts[(i + step) % 8];
        *extremes = (extremes.0.min(next.0), extremes.1.max(next.1));
    }
    joined
}

/// The brighter of the two arcs' smallest pixels and the darker of their largest, of the arcs from pixel `2
/// i` and from the one after it.
#[inline(always)]
fn pair_of_arcs<L: Lanes>(values: &[L; 16], eight: &[(L, L); 8], i: usize) -> (L, L) {
    let (a, b) = (values[2 * i], values[(2 * i + 9) % 16]);
    (eight[i].0.min(a.max(b)), eight[i].1.max(a.min(b)))
}

/// Bit `i` tells whether pixel `at + i` is above `threshold` and a local maximum.
#[inline(always)]
fn peak_mask<L: Lanes>(scores: &[u8], at: usize, width: usize, threshold: u8) -> u32 {
    let score = L::load(&scores[at..]);
    let (before, after) = neighbors(at, width);
    // `score > max(before, threshold)` and `score >= after`, that is `score > after - 1` for scores above 0.
    let floor = largest::<L>(scores, before)
        .max(L::splat(threshold))
        .max(largest::<L>(scores, after).saturating_sub(L::splat(1)));
    score.saturating_sub(floor).non_zero_mask()
}

/// The largest of the scores at four places.
#[inline(always)]
fn largest<L: Lanes>(scores: &[u8], at: [usize; 4]) -> L {
    let first = L::load(&scores[at[0]..]).max(L::load(&scores[at[1]..]));
    first.max(L::load(&scores[at[2]..]).max(L::load(&scores[at[3]..])))
}

/// The score of one pixel, straight from the definition.
fn score(image: &GrayImage, x: usize, y: usize) -> u8 {
    let pixels = image.as_raw();
    let at = y * image.width() as usize + x;
    let pixel =
        |dx: isize, dy: isize| i32::from(pixels[at.wrapping_add_signed(dy * image.width() as isize + dx)]);
    let center = pixel(0, 0);
    let difference = CIRCLE.map(|(dx, dy)| pixel(dx, dy) - center);
    let arc = |start: usize, sign: i32| (start..start + 9).map(|k| sign * difference[k % 16]).min();
    let best = (0..16).filter_map(|start| arc(start, 1).max(arc(start, -1))).max();
    best.unwrap_or(0).max(0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    /// What [`Detector::detect`] says it does, the slow way.
    fn expected(image: &GrayImage, config: &OrbConfig) -> Vec<Corner> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let margin = config.edge_margin_px as usize;
        let cell = config.cell_size_px as usize;
        let mut corners = Vec::new();
        for top in (margin..height - margin).step_by(cell) {
            for left in (margin..width - margin).step_by(cell) {
                let mut found = Vec::new();
                for y in top..(top + cell).min(height - margin) {
                    for x in left..(left + cell).min(width - margin) {
                        let own = score(image, x, y);
                        let is_peak = (y - 1..=y + 1).flat_map(|v| (x - 1..=x + 1).map(move |u| (u, v))).all(
                            |(u, v)| {
                                let other = score(image, u, v);
                                if (v, u) < (y, x) { other < own } else { other <= own }
                            },
                        );
                        if is_peak && own > config.min_fast_threshold {
                            found.push(Corner { x: x as u16, y: y as u16, score: own, ..Corner::default() });
                        }
                    }
                }
                if found.iter().any(|c| c.score > config.fast_threshold) {
                    found.retain(|c| c.score > config.fast_threshold);
                }
                corners.extend(found);
            }
        }
        corners.sort_by_key(|c| (c.y, c.x));
        corners
    }

    #[test]
    fn corners_are_those_of_the_definition() {
        let config = OrbConfig::default();
        // Widths around the sizes of the vectors, and one wide enough for several.
        for (width, height) in [(33, 60), (36, 40), (38, 50), (39, 44), (64, 41), (97, 75), (160, 120)] {
            for image in [
                test_images::blobs(width, height, 1),
                test_images::noise(width, height, 30, 2),
                test_images::noise(width, height, 255, 3),
                GrayImage::from_fn(width, height, |_, _| 255),
            ] {
                let mut corners = Vec::new();
                Detector::default().detect(&image, &config, &mut corners);
                corners.sort_by_key(|c| (c.y, c.x));
                assert_eq!(corners, expected(&image, &config), "{width}x{height}");
            }
        }
    }

    #[test]
    fn portable_vectors_find_the_same() {
        let image = test_images::blobs(150, 110, 4);
        let region = Region { left: 16, top: 16, right: 134, bottom: 94 };
        let (mut by_detection, mut portable, mut one_by_one) = (Vec::new(), Vec::new(), Vec::new());
        let detector = || Detector { scores: vec![0; 150 * 110], ..Detector::default() };
        detector().peaks(&image, region, 12, &mut by_detection);
        detector().peaks_in_lanes::<Portable>(&image, region, 12, &mut portable);
        detector().peaks_one_by_one(&image, region, 12, &mut one_by_one);
        assert!(one_by_one.len() > 20);
        assert_eq!(by_detection, one_by_one);
        assert_eq!(portable, one_by_one);
    }

    #[test]
    fn the_corner_of_a_bright_square_is_found() {
        let image = GrayImage::from_fn(80, 80, |x, y| if x >= 40 && y >= 40 { 200 } else { 50 });
        let mut corners = Vec::new();
        Detector::default().detect(&image, &OrbConfig::default(), &mut corners);
        assert!(!corners.is_empty());
        for corner in corners {
            assert!(corner.x.abs_diff(40) <= 2 && corner.y.abs_diff(40) <= 2, "{corner:?}");
            assert_eq!(corner.score, 150);
        }
    }
}
