//! Whether, and in which directions, the scene moves in the image.

use super::small::SmallImage;
use crate::vectorized;
use std::ops::Range;

/// Gradients from this on are edges, gray levels: twice what noise of four makes after the reduction.
pub(super) const EDGE_STRENGTH: i16 = 16;
/// Parts of the image that are asked whether they changed, along its width and height.
const PARTS: (usize, usize) = (6, 4);
/// A part with fewer edges than this share of its pixels says nothing.
const MIN_EDGE_SHARE: f64 = 0.01;
/// A part has changed when so many of its edges have gone or turned.
const CHANGED_SHARE: f64 = 0.4;
/// The camera has moved when so many of the parts with edges have changed: of a standing one, people and
/// leaves move in a few.
const MOVED_SHARE: f64 = 0.6;
/// Parts with edges that it takes at least.
const MIN_PARTS: usize = 4;

/// Every so many rows are asked.
const ROW_STEP: usize = 3;
/// Gray levels up to this are black for that purpose.
const BLACK: u8 = 12;

/// Regions along either side whose shift is measured.
pub(super) const REGIONS: usize = 3;
/// Shifts between samples are looked for up to this, pixels of the small image.
const MAX_SHIFT: isize = 14;
/// Profiles must resemble each other as much as this, as a correlation.
const MIN_CORRELATION: f32 = 0.7;

/// Whether the scene has moved from one image to another of the same size. What is left out is not asked, nor
/// what borders on black, which may be a frame.
pub(super) fn has_moved(before: &SmallImage, now: &SmallImage, left_out: &[bool]) -> bool {
    let mut counts = [[0u32; 2]; PARTS.0 * PARTS.1];
    let (width, height) = (now.width, now.height);
    if width < 3 * PARTS.0 || left_out.len() != width * height {
        return false;
    }
    // Some of the rows will do.
    for y in (1..height.saturating_sub(1)).step_by(ROW_STEP) {
        for part_x in 0..PARTS.0 {
            let (left, right) =
                ((part_x * width / PARTS.0).max(1), ((part_x + 1) * width / PARTS.0).min(width - 1));
            let span = y * width + left..y * width + right;
            let [edges, changed] = vectorized(
                #[inline(always)]
                || count(before, now, left_out, span),
            );
            let counts = &mut counts[(y * PARTS.1 / height) * PARTS.0 + part_x];
            counts[0] += edges;
            counts[1] += changed;
        }
    }
    let n_looked_at = (width / PARTS.0) * (height / PARTS.1) / ROW_STEP;
    let with_edges =
        counts.iter().filter(|[edges, _]| f64::from(*edges) > MIN_EDGE_SHARE * n_looked_at as f64);
    let (mut n_parts, mut n_changed) = (0, 0);
    for [edges, changed] in with_edges {
        n_parts += 1;
        n_changed += usize::from(f64::from(*changed) >= CHANGED_SHARE * f64::from(*edges));
    }
    n_parts >= MIN_PARTS && n_changed as f64 >= MOVED_SHARE * n_parts as f64
}

/// How many pixels of a part of a row were edges, and how many of these have changed.
#[inline(always)]
fn count(before: &SmallImage, now: &SmallImage, left_out: &[bool], span: Range<usize>) -> [u32; 2] {
    let (n, width) = (span.len(), before.width);
    let of = |offset: isize| &before.values[span.start.wrapping_add_signed(offset)..][..n];
    let (left, right) = (of(-1), of(1));
    let (above, below) = (of(-(width as isize)), of(width as isize));
    let (x, y) = (&before.gradient_x[span.clone()], &before.gradient_y[span.clone()]);
    let (x_now, y_now) = (&now.gradient_x[span.clone()], &now.gradient_y[span.clone()]);
    let left_out = &left_out[span];
    let (mut edges, mut changed) = (0u32, 0u32);
    for i in 0..n {
        let darkest = left[i].min(right[i]).min(above[i]).min(below[i]);
        let strength = x[i].abs() + y[i].abs();
        let difference = (x[i] - x_now[i]).abs() + (y[i] - y_now[i]).abs();
        let is_edge = (strength >= EDGE_STRENGTH) & (darkest > BLACK) & !left_out[i];
        edges += u32::from(is_edge);
        changed += u32::from(is_edge & (2 * difference > strength + EDGE_STRENGTH));
    }
    [edges, changed]
}

/// How the edges of an image are spread over the columns and rows of its regions, without those that stay.
#[derive(Clone, Debug, Default)]
pub(super) struct Profiles {
    columns: Vec<Vec<f32>>,
    rows: Vec<Vec<f32>>,
}

impl Profiles {
    /// Pixels that vary by no more than `steady` do not count.
    pub fn of(image: &SmallImage, deviations: &[f32], steady: f32) -> Self {
        let (width, height) = (image.width, image.height);
        let (mut columns, mut rows) = (Vec::new(), Vec::new());
        for region in 0..REGIONS * REGIONS {
            let (left, right) = span(region % REGIONS, width);
            let (top, bottom) = span(region / REGIONS, height);
            let (mut by_column, mut by_row) = (vec![0.0; right - left], vec![0.0; bottom - top]);
            for y in top..bottom {
                let row = y * width + left..y * width + right;
                by_row[y - top] = vectorized(
                    #[inline(always)]
                    || add_row(image, deviations, steady, row, &mut by_column),
                );
            }
            columns.push(by_column);
            rows.push(by_row);
        }
        Self { columns, rows }
    }

    /// How far each region has moved since, pixels right and down; 0 where either cannot be told.
    pub fn shifts(&self, now: &Self) -> Vec<[f32; 2]> {
        let of = |before: &[Vec<f32>], now: &[Vec<f32>], region: usize| {
            let (before, now) = (before.get(region)?, &now[region]);
            if before.len() == now.len() { shift(before, now) } else { None }
        };
        let both =
            |region| Some([of(&self.columns, &now.columns, region)?, of(&self.rows, &now.rows, region)?]);
        (0..REGIONS * REGIONS).map(|region| both(region).unwrap_or_default()).collect()
    }
}

/// Adds what varies in a part of a row to the columns, and returns the sum across it.
#[inline(always)]
fn add_row(
    image: &SmallImage,
    deviations: &[f32],
    steady: f32,
    span: Range<usize>,
    by_column: &mut [f32],
) -> f32 {
    let n = span.len();
    let (x, y) = (&image.gradient_x[span.clone()], &image.gradient_y[span.clone()]);
    let (deviations, by_column) = (&deviations[span], &mut by_column[..n]);
    let mut in_row = 0i32;
    for i in 0..n {
        let weight = i16::from(deviations[i] > steady);
        by_column[i] += f32::from(weight * x[i].abs());
        in_row += i32::from(weight * y[i].abs());
    }
    in_row as f32
}

fn span(index: usize, side: usize) -> (usize, usize) {
    (index * side / REGIONS, (index + 1) * side / REGIONS)
}

/// Which region a pixel of the small image is in.
#[inline]
pub(super) fn region_of(x: usize, y: usize, width: usize, height: usize) -> usize {
    (y * REGIONS / height) * REGIONS + x * REGIONS / width
}

/// How far a profile has moved to another, if it resembles it.
fn shift(before: &[f32], now: &[f32]) -> Option<f32> {
    let n = before.len() as isize;
    let max_shift = MAX_SHIFT.min(n / 3);
    let mut best = (MIN_CORRELATION, None);
    for shift in -max_shift..=max_shift {
        let (from, to) = (shift.max(0), (n + shift).min(n));
        let now = &now[from as usize..to as usize];
        let before = &before[(from - shift) as usize..(to - shift) as usize];
        let correlation = correlation(before, now);
        if correlation > best.0 {
            best = (correlation, Some(shift as f32));
        }
    }
    best.1
}

fn correlation(a: &[f32], b: &[f32]) -> f32 {
    let n = a.len() as f32;
    let (mean_a, mean_b) = (a.iter().sum::<f32>() / n, b.iter().sum::<f32>() / n);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}
