//! Connected pixels whose level lines run the same way.

use nalgebra::Vector2;

use super::field::{Field, Pixel};

/// A region; keeps its buffer from one to the next.
#[derive(Clone, Debug, Default)]
pub(super) struct Region {
    /// The seed first.
    pub pixels: Vec<Pixel>,
    /// Sum of the pixels' unit directions.
    pub sum: Vector2<f32>,
}

impl Region {
    /// Gathers the free pixels connected to `seed` whose direction is within `tolerance`, radians, of the
    /// region's, and takes them.
    pub fn grow(&mut self, field: &mut Field, seed: Pixel, tolerance: f32) {
        let stride = field.stride;
        let at = field.at(seed);
        let (directions, taken) = (field.direction.as_slice(), field.taken.as_mut_slice());
        taken[at] = 1;
        self.pixels.clear();
        self.pixels.push(seed);
        let mut sum = directions[at];
        // Cosines are compared by their signed squares, which spares a square root for every pixel won.
        let min_square = tolerance.cos() * tolerance.cos().abs();
        let mut least = min_square * sum.norm_squared();
        let mut i = 0;
        while let Some(&pixel) = self.pixels.get(i) {
            i += 1;
            let corner = (pixel.y as usize * stride) + pixel.x as usize;
            for dy in 0..3 {
                let first = corner + dy * stride;
                let row = &mut taken[first..first + 3];
                // Inside a region nearly always.
                if row == [1; 3] {
                    continue;
                }
                let directions = &directions[first..first + 3];
                for dx in 0..3 {
                    if row[dx] != 0 {
                        continue;
                    }
                    let direction = directions[dx];
                    let dot = direction.dot(&sum);
                    if dot * dot.abs() < least {
                        continue;
                    }
                    row[dx] = 1;
                    sum += direction;
                    least = min_square * sum.norm_squared();
                    // A free pixel is inside the image: neither coordinate falls below 0.
                    self.pixels.push(Pixel { x: pixel.x + dx as u32 - 1, y: pixel.y + dy as u32 - 1 });
                }
            }
        }
        self.sum = sum;
    }

    /// Gives all pixels back.
    pub fn release(&self, field: &mut Field) {
        for &pixel in &self.pixels {
            let at = field.at(pixel);
            field.taken[at] = 0;
        }
    }

    /// Gives back the pixels farther than `radius` from the seed.
    pub fn shrink(&mut self, field: &mut Field, radius: f64) {
        let Some(&seed) = self.pixels.first() else { return };
        let mut sum = Vector2::zeros();
        self.pixels.retain(|&pixel| {
            let at = field.at(pixel);
            let near = squared_distance(seed, pixel) <= radius * radius;
            if near {
                sum += field.direction[at];
            } else {
                field.taken[at] = 0;
            }
            near
        });
        self.sum = sum;
    }
}

/// Squared distance of two pixels.
pub(super) fn squared_distance(a: Pixel, b: Pixel) -> f64 {
    let (dx, dy) = (f64::from(a.x) - f64::from(b.x), f64::from(a.y) - f64::from(b.y));
    dx * dx + dy * dy
}
