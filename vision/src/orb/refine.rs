//! Sub-pixel refinement, where a corner is to a fraction of a pixel: the point at which the edges around it
//! meet [Förstner & Gülch, "A fast operator for detection and precise location of distinct points", 1987].

use crate::{GrayImage, vectorized};

/// Gradients within this distance take part, pixels of the level. Beyond it lie the edges of other corners.
const RADIUS: i32 = 4;
/// Side of the window.
const SIDE: usize = 2 * RADIUS as usize + 1;
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
        vectorized(
            #[inline(always)]
            || self.solve(image, x, y),
        )
    }

    #[inline(always)]
    fn solve(&self, image: &GrayImage, x: u32, y: u32) -> Option<(f32, f32)> {
        let (width, pixels) = (image.width() as usize, image.as_raw());
        let top_left = (y as usize - RADIUS as usize) * width + x as usize - RADIUS as usize;
        let (mut xx, mut xy, mut yy, mut bx, mut by) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for row in 0..SIDE {
            let at = top_left + row * width;
            let (above, center, below) =
                (&pixels[at - width..][..SIDE], &pixels[at - 1..][..SIDE + 2], &pixels[at + width..][..SIDE]);
            let weights = &self.weights[row * SIDE..][..SIDE];
            let dy = row as f32 - RADIUS as f32;
            for column in 0..SIDE {
                let gx = f32::from(center[column + 2]) - f32::from(center[column]);
                let gy = f32::from(below[column]) - f32::from(above[column]);
                let dx = column as f32 - RADIUS as f32;
                let (wx, wy) = (weights[column] * gx, weights[column] * gy);
                let along = gx * dx + gy * dy;
                xx += wx * gx;
                xy += wx * gy;
                yy += wy * gy;
                bx += wx * along;
                by += wy * along;
            }
        }
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
    fn edges_and_plain_images_have_no_corner() {
        let edge = GrayImage::from_fn(32, 32, |x, _| if x < 16 { 30 } else { 200 });
        assert_eq!(Refiner::new().shift(&edge, 16, 16), None);
        assert_eq!(Refiner::new().shift(&GrayImage::new(32, 32), 16, 16), None);
    }
}
