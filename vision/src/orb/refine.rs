//! Sub-pixel refinement, where a corner is to a fraction of a pixel: the point at which the edges around it
//! meet [Förstner & Gülch, "A fast operator for detection and precise location of distinct points", 1987].

use crate::GrayImage;

/// Gradients within this distance take part, pixels of the level. Beyond it lie the edges of other corners.
const RADIUS: i32 = 4;
/// Side of the window.
const SIDE: usize = 2 * RADIUS as usize + 1;
/// Columns of the window that are summed up side by side; the one left over has a sum of its own.
const LANES: usize = SIDE - 1;
/// Pixels read of each row.
const ROW: usize = SIDE + 2;
/// A corner that would move farther than this is not one: it stays where it was detected, pixels.
const MAX_SHIFT: f32 = 1.5;
/// Ratio of the structure tensor's eigenvalues below which the place along an edge is not determined. At 0.05
/// blurred corners of real images go too: the trajectory error on EuRoC part b doubles.
const MIN_EIGENVALUE_RATIO: f32 = 0.02;

/// Finds corners to a fraction of a pixel.
#[derive(Clone, Debug)]
pub(super) struct Refiner {
    /// Gaussian weights of the window, row by row.
    weights: [f32; SIDE * SIDE],
}

impl Refiner {
    pub fn new() -> Self {
        // The weight falls to a seventh at the window's edge, so that what enters or leaves there hardly
        // matters.
        let sigma = RADIUS as f32 / 2.0;
        let squared = |i: usize| (i as f32 - RADIUS as f32).powi(2);
        let weight = |i: usize| (-(squared(i % SIDE) + squared(i / SIDE)) / (2.0 * sigma * sigma)).exp();
        Self { weights: std::array::from_fn(weight) }
    }

    /// The shift of the corner at a pixel at least `RADIUS + 1` from the border, pixels; `None` where there
    /// is no corner: its place along an edge is not determined, or it would be somewhere else.
    ///
    /// Every gradient `g` at offset `o` says that the corner lies on the edge through `o`: `g·(shift − o) =
    /// 0`. The weighted least squares solution is `(Σ w g gᵀ)⁻¹ Σ w g gᵀ o`.
    pub fn shift(&self, image: &GrayImage, x: u32, y: u32) -> Option<(f32, f32)> {
        self.normal_equations(image, x, y).solve()
    }

    fn normal_equations(&self, image: &GrayImage, x: u32, y: u32) -> NormalEquations {
        let window = Window::around(image, x, y);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: AVX2 has just been found.
            return unsafe { self.sum_avx2(&window) };
        }
        self.sum(&window)
    }

    /// Column by column, the last one for itself: the order in which vectors of eight add up.
    fn sum(&self, window: &Window) -> NormalEquations {
        let columns: [NormalEquations; SIDE] = std::array::from_fn(|column| self.column(window, column));
        let sums = |of: fn(&NormalEquations) -> f32| {
            sum_lanes(std::array::from_fn(|i| of(&columns[i]))) + of(&columns[LANES])
        };
        NormalEquations {
            xx: sums(|column| column.xx),
            xy: sums(|column| column.xy),
            yy: sums(|column| column.yy),
            bx: sums(|column| column.bx),
            by: sums(|column| column.by),
        }
    }

    /// The share of one column of the window.
    #[inline(always)]
    fn column(&self, window: &Window, column: usize) -> NormalEquations {
        let mut sums = NormalEquations::default();
        let dx = column as f32 - RADIUS as f32;
        for row in 0..SIDE {
            let [above, center, below] = window.rows(row);
            let gx = f32::from(center[column + 2]) - f32::from(center[column]);
            let gy = f32::from(below[column + 1]) - f32::from(above[column + 1]);
            let dy = row as f32 - RADIUS as f32;
            let weight = self.weights[row * SIDE + column];
            let (wx, wy) = (weight * gx, weight * gy);
            let along = gx * dx + gy * dy;
            sums.xx += wx * gx;
            sums.xy += wx * gy;
            sums.yy += wy * gy;
            sums.bx += wx * along;
            sums.by += wy * along;
        }
        sums
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn sum_avx2(&self, window: &Window) -> NormalEquations {
        use std::arch::x86_64::*;
        let read = |row: &[u8; ROW], first: usize| {
            let bytes: &[u8; LANES] = row[first..first + LANES].as_array().expect("eight bytes");
            // SAFETY: eight bytes are read from eight.
            let bytes = unsafe { _mm_loadl_epi64(bytes.as_ptr().cast()) };
            _mm256_cvtepu8_epi32(bytes)
        };
        let offsets = _mm256_setr_ps(-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0);
        let mut sums = [_mm256_setzero_ps(); 5];
        for row in 0..SIDE {
            let [above, center, below] = window.rows(row);
            let gx = _mm256_cvtepi32_ps(_mm256_sub_epi32(read(center, 2), read(center, 0)));
            let gy = _mm256_cvtepi32_ps(_mm256_sub_epi32(read(below, 1), read(above, 1)));
            let weights: &[f32; LANES] =
                self.weights[row * SIDE..][..LANES].as_array().expect("eight weights");
            // SAFETY: eight numbers are read from eight.
            let weights = unsafe { _mm256_loadu_ps(weights.as_ptr()) };
            let (wx, wy) = (_mm256_mul_ps(weights, gx), _mm256_mul_ps(weights, gy));
            let dy = _mm256_set1_ps(row as f32 - RADIUS as f32);
            let along = _mm256_add_ps(_mm256_mul_ps(gx, offsets), _mm256_mul_ps(gy, dy));
            let products = [(wx, gx), (wx, gy), (wy, gy), (wx, along), (wy, along)];
            for (sum, (a, b)) in sums.iter_mut().zip(products) {
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(a, b));
            }
        }
        let last = self.column(window, LANES);
        let [xx, xy, yy, bx, by] = sums.map(|sum| {
            let mut lanes = [0.0; LANES];
            // SAFETY: the array has room for eight numbers.
            unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), sum) };
            sum_lanes(lanes)
        });
        NormalEquations {
            xx: xx + last.xx,
            xy: xy + last.xy,
            yy: yy + last.yy,
            bx: bx + last.bx,
            by: by + last.by,
        }
    }
}

fn sum_lanes(lanes: [f32; LANES]) -> f32 {
    lanes.iter().sum()
}

/// The window around a pixel with one more pixel on each side.
struct Window<'a> {
    rows: [&'a [u8; ROW]; ROW],
}

impl<'a> Window<'a> {
    fn around(image: &'a GrayImage, x: u32, y: u32) -> Self {
        let (width, margin) = (image.width() as usize, RADIUS as usize + 1);
        let top_left = (y as usize - margin) * width + x as usize - margin;
        let pixels = &image.as_raw()[top_left..];
        let row = |row: usize| pixels[row * width..][..ROW].as_array().expect("a row's length");
        Self { rows: std::array::from_fn(row) }
    }

    /// The rows above, at and below row `row` of the window.
    #[inline(always)]
    fn rows(&self, row: usize) -> [&'a [u8; ROW]; 3] {
        [self.rows[row], self.rows[row + 1], self.rows[row + 2]]
    }
}

/// `A = Σ w g gᵀ` and `b = Σ w g gᵀ o`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct NormalEquations {
    xx: f32,
    xy: f32,
    yy: f32,
    bx: f32,
    by: f32,
}

impl NormalEquations {
    fn solve(self) -> Option<(f32, f32)> {
        let Self { xx, xy, yy, bx, by } = self;
        let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
        // For eigenvalues a >= b: determinant / trace² = (b/a) / (1 + b/a)².
        let ratio = MIN_EIGENVALUE_RATIO / ((1.0 + MIN_EIGENVALUE_RATIO) * (1.0 + MIN_EIGENVALUE_RATIO));
        if determinant <= ratio * trace * trace {
            return None;
        }
        let (dx, dy) = ((yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant);
        (dx.abs().max(dy.abs()) <= MAX_SHIFT).then_some((dx, dy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corner of a bright quadrant at a given place, each pixel the mean of its area.
    fn quadrant(corner_x: f32, corner_y: f32) -> GrayImage {
        let covered = |pixel: u32, edge: f32| (pixel as f32 + 0.5 - edge).clamp(0.0, 1.0);
        GrayImage::from_fn(32, 32, |x, y| {
            (40.0 + 150.0 * covered(x, corner_x) * covered(y, corner_y)).round() as u8
        })
    }

    #[test]
    fn corners_between_pixels_are_found() {
        for (x, y) in [(16.0, 16.0), (16.3, 15.8), (15.6, 16.45), (16.5, 16.5)] {
            let (dx, dy) = Refiner::new().shift(&quadrant(x, y), 16, 16).unwrap();
            let (error_x, error_y) = (16.0 + dx - x, 16.0 + dy - y);
            assert!(
                error_x.abs() < 0.15 && error_y.abs() < 0.15,
                "({x}, {y}): off by ({error_x}, {error_y})"
            );
        }
    }

    #[test]
    fn shifts_follow_the_corner() {
        let shift = |x: f32| Refiner::new().shift(&quadrant(x, 16.0), 16, 16).unwrap().0;
        for step in 1..8 {
            let moved = shift(15.6 + 0.1 * step as f32) - shift(15.6);
            assert!((moved - 0.1 * step as f32).abs() < 0.05, "step {step}: moved by {moved}");
        }
    }

    #[test]
    fn every_processor_computes_the_same() {
        let image = crate::test_images::noise(40, 30, 255, 1);
        for (x, y) in [(5, 5), (34, 24), (20, 11)] {
            let refiner = Refiner::new();
            let anywhere = refiner.sum(&Window::around(&image, x, y));
            assert_eq!(refiner.normal_equations(&image, x, y), anywhere);
            assert!(anywhere.xx > 0.0);
        }
    }

    #[test]
    fn edges_and_plain_images_have_no_corner() {
        let edge = GrayImage::from_fn(32, 32, |x, _| if x < 16 { 30 } else { 200 });
        assert_eq!(Refiner::new().shift(&edge, 16, 16), None);
        assert_eq!(Refiner::new().shift(&GrayImage::new(32, 32), 16, 16), None);
    }
}
