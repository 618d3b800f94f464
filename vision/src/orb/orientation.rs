//! Orientation by the intensity centroid [Rosin, "Measuring corner properties", CVIU 1999; Rublee et al.,
//! ICCV 2011].

use std::f32::consts::TAU;

use super::PATCH_RADIUS_PX;
use crate::{GrayImage, vectorized};

const RADIUS: usize = PATCH_RADIUS_PX as usize;
/// Pixels read of each row: one more than the patch has, to fill vectors.
const ROW: usize = 2 * RADIUS + 2;

/// For each |dy|: for each dx from -15 to 16, dx if the pixel is in the disc, else 0; and 1 if it is, else 0.
static WEIGHTS: [([i16; ROW], [i16; ROW]); RADIUS + 1] = disc_weights();

const fn disc_weights() -> [([i16; ROW], [i16; ROW]); RADIUS + 1] {
    let mut weights = [([0; ROW], [0; ROW]); RADIUS + 1];
    let mut dy = 0;
    while dy <= RADIUS {
        let mut column = 0;
        while column < ROW {
            let dx = column as i16 - RADIUS as i16;
            // Pixels whose center is within radius 15.5: rounder than those within 15.
            if dx as i32 * dx as i32 + (dy * dy) as i32 <= (RADIUS * (RADIUS + 1)) as i32 {
                weights[dy].0[column] = dx;
                weights[dy].1[column] = 1;
            }
            column += 1;
        }
        dy += 1;
    }
    weights
}

/// Direction from (x, y), at least 16 pixels from the image's edges, to the centroid of the disc of radius 15
/// around it, radians in [0, 2 pi).
pub(super) fn angle(image: &GrayImage, x: u32, y: u32) -> f32 {
    let (m10, m01) = vectorized(
        #[inline(always)]
        || moments(image, x, y),
    );
    let angle = (m01 as f32).atan2(m10 as f32);
    // A tiny negative angle plus 2 pi rounds to 2 pi, which stands for 0.
    let turned = if angle < 0.0 { angle + TAU } else { angle };
    if turned < TAU { turned } else { 0.0 }
}

/// Sums of `dx * I` and `dy * I` over the disc.
#[inline(always)]
fn moments(image: &GrayImage, x: u32, y: u32) -> (i32, i32) {
    let (x, y, width) = (x as usize, y as usize, image.width() as usize);
    let row = |y: usize| -> &[u8; ROW] {
        let from = y * width + x - RADIUS;
        image.as_raw()[from..from + ROW].as_array().expect("the slice has this length")
    };
    let mut m10 = [0i32; ROW];
    let mut m01 = 0i32;
    // The rows above and below at the same distance have the same weights along x, opposite ones along y.
    for (dy, (column_weights, inside)) in WEIGHTS.iter().enumerate() {
        let (above, below) = (row(y - dy), row(y + dy));
        let mut difference = 0i32;
        for i in 0..ROW {
            let (a, b) = (i16::from(above[i]), i16::from(below[i]));
            // The middle row is its own mirror image: counted twice here, taken off again below.
            m10[i] += i32::from(column_weights[i]) * i32::from(a + b);
            difference += i32::from(inside[i]) * i32::from(b - a);
        }
        m01 += dy as i32 * difference;
    }
    let middle: i32 = row(y).iter().zip(&WEIGHTS[0].0).map(|(&p, &w)| i32::from(p) * i32::from(w)).sum();
    (m10.iter().sum::<i32>() - middle, m01)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images;

    #[test]
    fn moments_are_sums_over_the_disc() {
        let image = test_images::noise(64, 64, 255, 1);
        for (x, y) in [(16, 16), (47, 47), (30, 21)] {
            let mut expected = (0, 0);
            for dy in -15i32..=15 {
                for dx in -15i32..=15 {
                    if dx * dx + dy * dy <= 240 {
                        let value = i32::from(image.row((y as i32 + dy) as u32)[(x as i32 + dx) as usize]);
                        expected = (expected.0 + dx * value, expected.1 + dy * value);
                    }
                }
            }
            assert_eq!(moments(&image, x, y), expected);
        }
    }

    #[test]
    fn the_angle_points_to_the_bright_side() {
        for degrees in (0..360).step_by(15) {
            let direction = (degrees as f32).to_radians();
            let image = GrayImage::from_fn(64, 64, |x, y| {
                let along = (x as f32 - 32.0) * direction.cos() + (y as f32 - 32.0) * direction.sin();
                (128.0 + 4.0 * along) as u8
            });
            let found = angle(&image, 32, 32);
            let error = (found - direction + std::f32::consts::PI).rem_euclid(TAU) - std::f32::consts::PI;
            assert!(error.abs() < 0.01, "{degrees} degrees found as {}", found.to_degrees());
            assert!((0.0..TAU).contains(&found));
        }
    }

    #[test]
    fn a_plain_patch_has_angle_zero() {
        assert_eq!(angle(&GrayImage::from_fn(40, 40, |_, _| 200), 20, 20), 0.0);
    }
}
