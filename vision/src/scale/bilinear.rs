//! Fast bilinear resizing, in whole numbers.

use crate::{GrayImage, vectorized};

/// Bilinear resizing with buffers kept between calls. Meant for ratios below 2, as between neighboring
/// pyramid levels: beyond, pixels are skipped and detail is aliased.
#[derive(Clone, Debug, Default)]
pub struct BilinearResizer {
    columns: ColumnPlan,
    /// The source rows above and below the row being made, resized along x, in parts of [`ONE`].
    upper: Vec<i16>,
    lower: Vec<i16>,
}

/// Interpolation weights are in parts of this many: a position is exact to 1/128 pixel, and a weight fits a
/// signed byte.
const ONE: i16 = 64;

/// Linear interpolation between old pixels `left` and `left + 1`; `weight` parts of [`ONE`] go to the right
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Tap {
    left: u32,
    weight: i16,
}

impl Tap {
    fn at(index: u32, old: u32, new: u32) -> Self {
        // Pixel centers: the image's edges, not the centers of its outermost pixels, are what coincide.
        let position = (f64::from(index) + 0.5) * f64::from(old) / f64::from(new) - 0.5;
        let position = position.clamp(0.0, f64::from(old - 1));
        let left = (position as u32).min(old.saturating_sub(2));
        let weight = ((position - f64::from(left)) * f64::from(ONE)).round() as i16;
        Self { left, weight }
    }
}

impl BilinearResizer {
    /// Writes `image`, resized to `new_width` x `new_height`, into `out`, reusing its buffer. An empty image
    /// gives black.
    pub fn resize(&mut self, image: &GrayImage, new_width: u32, new_height: u32, out: &mut GrayImage) {
        out.reshape(new_width, new_height);
        if image.is_empty() || out.is_empty() {
            out.as_raw_mut().fill(0);
            return;
        }
        self.columns.prepare(image.width(), new_width);
        self.upper.resize(new_width as usize, 0);
        self.lower.resize(new_width as usize, 0);
        // The source row that `upper` holds; `lower` holds the one after it.
        let mut held = None;
        for y in 0..new_height {
            let tap = Tap::at(y, image.height(), new_height);
            if held != Some(tap.left) {
                if tap.left > 0 && held == Some(tap.left - 1) {
                    std::mem::swap(&mut self.upper, &mut self.lower);
                } else {
                    self.columns.apply(image.row(tap.left), &mut self.upper);
                }
                let below = (tap.left + 1).min(image.height() - 1);
                self.columns.apply(image.row(below), &mut self.lower);
                held = Some(tap.left);
            }
            vectorized(
                #[inline(always)]
                || blend_rows(&self.upper, &self.lower, tap.weight, out.row_mut(y)),
            );
        }
    }
}

#[inline(always)]
fn blend_rows(upper: &[i16], lower: &[i16], weight: i16, out: &mut [u8]) {
    let (upper_weight, lower_weight) = (i32::from(ONE - weight), i32::from(weight));
    for ((out, &upper), &lower) in out.iter_mut().zip(upper).zip(lower) {
        *out = ((i32::from(upper) * upper_weight + i32::from(lower) * lower_weight + 2048) >> 12) as u8;
    }
}

/// Outputs made at once from 16 neighboring source pixels.
const GROUP: usize = 8;
/// Source pixels a group may draw on.
const WINDOW: usize = 16;

/// How the pixels of a new row come from those of an old one.
#[derive(Clone, Debug, Default)]
struct ColumnPlan {
    size: (u32, u32),
    taps: Vec<Tap>,
    /// The taps again, eight at a time, for byte shuffles; empty if some eight span more than 16 pixels.
    groups: Vec<Group>,
}

/// Eight taps: pixels `start + shuffle[2 i]` and `start + shuffle[2 i + 1]`, weighted.
#[derive(Clone, Copy, Debug)]
struct Group {
    start: usize,
    shuffle: [u8; WINDOW],
    weights: [i8; WINDOW],
}

impl Group {
    fn of(taps: &[Tap; GROUP], old: u32) -> Option<Self> {
        let start = taps[0].left.min(old.checked_sub(WINDOW as u32)?);
        let (mut shuffle, mut weights) = ([0; WINDOW], [0; WINDOW]);
        for (i, tap) in taps.iter().enumerate() {
            let left = usize::try_from(tap.left - start).ok().filter(|&left| left + 1 < WINDOW)?;
            (shuffle[2 * i], shuffle[2 * i + 1]) = (left as u8, left as u8 + 1);
            (weights[2 * i], weights[2 * i + 1]) = ((ONE - tap.weight) as i8, tap.weight as i8);
        }
        Some(Self { start: start as usize, shuffle, weights })
    }
}

impl ColumnPlan {
    /// Makes the plan for these widths, unless it is there already.
    fn prepare(&mut self, old: u32, new: u32) {
        if self.size == (old, new) {
            return;
        }
        self.size = (old, new);
        self.taps = (0..new).map(|x| Tap::at(x, old, new)).collect();
        let groups: Option<Vec<Group>> =
            self.taps.as_chunks().0.iter().map(|taps| Group::of(taps, old)).collect();
        self.groups = groups.unwrap_or_default();
    }

    /// Resizes one row; `row` and `out` have the lengths the plan is for.
    fn apply(&self, row: &[u8], out: &mut [i16]) {
        #[cfg(target_arch = "x86_64")]
        if !self.groups.is_empty() && std::arch::is_x86_feature_detected!("ssse3") {
            // SAFETY: SSSE3 has just been found.
            unsafe { apply_groups(&self.groups, row, out) };
            let n_done = self.groups.len() * GROUP;
            return apply_taps(&self.taps[n_done..], row, &mut out[n_done..]);
        }
        apply_taps(&self.taps, row, out);
    }
}

fn apply_taps(taps: &[Tap], row: &[u8], out: &mut [i16]) {
    for (out, tap) in out.iter_mut().zip(taps) {
        let left = tap.left as usize;
        let right = (left + 1).min(row.len() - 1);
        *out = i16::from(row[left]) * (ONE - tap.weight) + i16::from(row[right]) * tap.weight;
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "ssse3")]
fn apply_groups(groups: &[Group], row: &[u8], out: &mut [i16]) {
    use std::arch::x86_64::{_mm_loadu_si128, _mm_maddubs_epi16, _mm_shuffle_epi8, _mm_storeu_si128};
    for (group, out) in groups.iter().zip(out.as_chunks_mut::<GROUP>().0) {
        let window = &row[group.start..group.start + WINDOW];
        // SAFETY: all four are 16 bytes long.
        unsafe {
            let pixels = _mm_loadu_si128(window.as_ptr().cast());
            let pairs = _mm_shuffle_epi8(pixels, _mm_loadu_si128(group.shuffle.as_ptr().cast()));
            let weights = _mm_loadu_si128(group.weights.as_ptr().cast());
            _mm_storeu_si128(out.as_mut_ptr().cast(), _mm_maddubs_epi16(pairs, weights));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    fn resized(image: &GrayImage, width: u32, height: u32) -> GrayImage {
        let mut out = GrayImage::default();
        BilinearResizer::default().resize(image, width, height, &mut out);
        out
    }

    #[test]
    fn resizing_interpolates_between_pixel_centers() {
        let image = test_images::noise(97, 61, 255, 1);
        for (width, height) in [(81, 51), (97, 61), (50, 40), (90, 9), (130, 70), (1, 1)] {
            let out = resized(&image, width, height);
            let along = |index: u32, old: u32, new: u32| {
                let position = (f64::from(index) + 0.5) * f64::from(old) / f64::from(new) - 0.5;
                let position = position.clamp(0.0, f64::from(old) - 1.0);
                let left = (position as u32).min(old - 2);
                (left, position - f64::from(left))
            };
            for y in 0..height {
                for x in 0..width {
                    let ((u, a), (v, b)) = (along(x, 97, width), along(y, 61, height));
                    let pixel = |dx: u32, dy: u32| f64::from(image.row(v + dy)[(u + dx) as usize]);
                    let upper = pixel(0, 0) * (1.0 - a) + pixel(1, 0) * a;
                    let lower = pixel(0, 1) * (1.0 - a) + pixel(1, 1) * a;
                    let error = f64::from(out.row(y)[x as usize]) - (upper * (1.0 - b) + lower * b);
                    // Weights are rounded to 1/128 along both axes.
                    assert!(error.abs() <= 0.5 + 2.0 * 255.0 / 128.0, "{error} at ({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn shuffled_groups_equal_single_taps() {
        let image = test_images::noise(640, 1, 255, 2);
        let mut plan = ColumnPlan::default();
        for new in [533, 532, 400, 640] {
            plan.prepare(640, new);
            assert_eq!(plan.groups.len(), new as usize / GROUP);
            let (mut by_groups, mut by_taps) = (vec![0; new as usize], vec![0; new as usize]);
            plan.apply(image.row(0), &mut by_groups);
            apply_taps(&plan.taps, image.row(0), &mut by_taps);
            assert_eq!(by_groups, by_taps);
        }
        // Too wide a span, too short a row.
        for (old, new) in [(640, 200), (10, 8)] {
            plan.prepare(old, new);
            assert!(plan.groups.is_empty());
        }
    }

    #[test]
    fn sizes_of_one_and_none_are_handled() {
        let one = GrayImage::from_fn(1, 1, |_, _| 9);
        assert_eq!(resized(&one, 3, 2), GrayImage::from_fn(3, 2, |_, _| 9));
        assert_eq!(resized(&GrayImage::new(0, 0), 2, 2), GrayImage::new(2, 2));
        assert!(resized(&one, 0, 5).is_empty());
    }

    #[test]
    fn white_stays_white() {
        let image = GrayImage::from_fn(200, 100, |_, _| 255);
        assert_eq!(resized(&image, 167, 83), GrayImage::from_fn(167, 83, |_, _| 255));
    }
}
