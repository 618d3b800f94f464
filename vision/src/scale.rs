//! Shrinking images: by area for good looks at any ratio, bilinearly and fast for the pyramid.

use crate::GrayImage;

/// Shrinks (or stretches) `image` to `new_width` x `new_height` by averaging over the area each new pixel covers.
///
/// Fine detail is averaged away rather than aliased. An empty image, or an empty size, gives a black image.
pub fn resize_area(image: &GrayImage, new_width: u32, new_height: u32) -> GrayImage {
    let mut out = GrayImage::new(new_width, new_height);
    if out.is_empty() || image.is_empty() {
        return out;
    }
    let columns = AreaSpan::for_axis(image.width(), new_width);
    let rows = AreaSpan::for_axis(image.height(), new_height);
    let mut sums = vec![0.0f32; image.width() as usize];
    for (y, row_span) in rows.iter().enumerate() {
        sums.fill(0.0);
        for (offset, &weight) in row_span.weights.iter().enumerate() {
            let row = image.row(row_span.start + offset as u32);
            for (sum, &pixel) in sums.iter_mut().zip(row) {
                *sum += weight * f32::from(pixel);
            }
        }
        for (pixel, span) in out.row_mut(y as u32).iter_mut().zip(&columns) {
            let inputs = &sums[span.start as usize..];
            let value: f32 = span.weights.iter().zip(inputs).map(|(w, v)| w * v).sum();
            *pixel = (value + 0.5) as u8;
        }
    }
    out
}

/// The old pixels one new pixel covers along one axis, with the shares they have in it (summing to 1).
struct AreaSpan {
    start: u32,
    weights: Vec<f32>,
}

impl AreaSpan {
    fn for_axis(old: u32, new: u32) -> Vec<Self> {
        let step = f64::from(old) / f64::from(new);
        let span = |index: u32| {
            let (from, to) = (f64::from(index) * step, (f64::from(index) + 1.0) * step);
            let start = (from.floor() as u32).min(old - 1);
            let end = (to.ceil() as u32).clamp(start + 1, old);
            let covered = |pixel: u32| (to.min(f64::from(pixel) + 1.0) - from.max(f64::from(pixel))).max(0.0);
            let total: f64 = (start..end).map(covered).sum();
            let weights = (start..end).map(|pixel| (covered(pixel) / total) as f32).collect();
            Self { start, weights }
        };
        (0..new).map(span).collect()
    }
}

/// Bilinear resizing with buffers kept between calls. Meant for ratios below 2, as between neighbouring pyramid levels.
#[derive(Clone, Debug, Default)]
pub struct BilinearResizer {
    columns: Vec<Tap>,
    upper: Vec<u16>,
    lower: Vec<u16>,
}

/// Linear interpolation between old pixels `left` and `left + 1`; `weight` of 128 parts goes to the right one.
#[derive(Clone, Copy, Debug)]
struct Tap {
    left: u32,
    weight: u16,
}

/// Interpolation weights are in parts of this many.
const WEIGHT_ONE: u16 = 128;

impl Tap {
    fn at(index: u32, old: u32, new: u32) -> Self {
        // Pixel centres: the image's edges, not the centres of its outermost pixels, are what coincide.
        let position = (f64::from(index) + 0.5) * f64::from(old) / f64::from(new) - 0.5;
        let position = position.clamp(0.0, f64::from(old - 1));
        let left = (position as u32).min(old.saturating_sub(2));
        let weight = ((position - f64::from(left)) * f64::from(WEIGHT_ONE)).round() as u16;
        Self { left, weight }
    }
}

impl BilinearResizer {
    /// Writes `image`, resized to `new_width` x `new_height`, into `out`, reusing its buffer.
    pub fn resize(&mut self, image: &GrayImage, new_width: u32, new_height: u32, out: &mut GrayImage) {
        out.reshape(new_width, new_height);
        if image.is_empty() || out.is_empty() {
            out.as_raw_mut().fill(0);
            return;
        }
        self.columns.clear();
        self.columns.extend((0..new_width).map(|x| Tap::at(x, image.width(), new_width)));
        self.upper.resize(new_width as usize, 0);
        self.lower.resize(new_width as usize, 0);
        let mut held = None;
        for y in 0..new_height {
            let tap = Tap::at(y, image.height(), new_height);
            let below = (tap.left + 1).min(image.height() - 1);
            if held != Some(tap.left) {
                if held.is_some_and(|row| row + 1 == tap.left) {
                    std::mem::swap(&mut self.upper, &mut self.lower);
                } else {
                    interpolate_row(image.row(tap.left), &self.columns, &mut self.upper);
                }
                interpolate_row(image.row(below), &self.columns, &mut self.lower);
                held = Some(tap.left);
            }
            blend_rows(&self.upper, &self.lower, tap.weight, out.row_mut(y));
        }
    }
}

fn interpolate_row(row: &[u8], columns: &[Tap], out: &mut [u16]) {
    for (out, tap) in out.iter_mut().zip(columns) {
        let left = tap.left as usize;
        let right = (left + 1).min(row.len() - 1);
        *out = u16::from(row[left]) * (WEIGHT_ONE - tap.weight) + u16::from(row[right]) * tap.weight;
    }
}

fn blend_rows(upper: &[u16], lower: &[u16], weight: u16, out: &mut [u8]) {
    let (upper_weight, lower_weight) = (u32::from(WEIGHT_ONE - weight), u32::from(weight));
    for ((out, &upper), &lower) in out.iter_mut().zip(upper).zip(lower) {
        *out = ((u32::from(upper) * upper_weight + u32::from(lower) * lower_weight + (1 << 13)) >> 14) as u8;
    }
}
