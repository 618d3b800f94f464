//! The rectangle around a region.

use nalgebra::Vector2;

use super::field::Field;
use super::region::Region;

/// A rectangle along the principal axis of a region, in pixels of the shrunk image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rectangle {
    /// Center of the region's gradient.
    pub center: Vector2<f64>,
    /// Unit vector along it, brighter side to the right.
    pub direction: Vector2<f64>,
    /// Where it begins and ends along `direction` from `center`.
    pub along: [f64; 2],
    /// Where it begins and ends to the right of `direction` from `center`.
    pub across: [f64; 2],
}

impl Rectangle {
    /// The rectangle around a region's pixels, weighted by their gradient.
    pub fn around(field: &Field, region: &Region) -> Self {
        let origin = region.pixels[0];
        let offset =
            |x: u32, y: u32| (f64::from(x) - f64::from(origin.x), f64::from(y) - f64::from(origin.y));
        let (mut weight, mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &pixel in &region.pixels {
            let w = f64::from(field.magnitude[field.at(pixel)]);
            let (px, py) = offset(pixel.x, pixel.y);
            weight += w;
            x += w * px;
            y += w * py;
            xx += w * px * px;
            xy += w * px * py;
            yy += w * py * py;
        }
        let (x, y) = (x / weight, y / weight);
        let (xx, xy, yy) = (xx / weight - x * x, xy / weight - x * y, yy / weight - y * y);
        let half = 0.5 * (xx - yy);
        let radius = half.hypot(xy);
        // Of the two ways to write the eigenvector of the larger eigenvalue, the one without cancellation.
        let axis =
            if half >= 0.0 { Vector2::new(half + radius, xy) } else { Vector2::new(xy, radius - half) };
        let sum = region.sum.cast::<f64>();
        let mut direction =
            axis.try_normalize(1e-12).or_else(|| sum.try_normalize(1e-12)).unwrap_or_else(Vector2::x);
        if direction.dot(&sum) < 0.0 {
            direction = -direction;
        }
        let (mut along, mut widest) = ([0.0f64; 2], [0.0f64; 2]);
        for &pixel in &region.pixels {
            let (px, py) = offset(pixel.x, pixel.y);
            let (px, py) = (px - x, py - y);
            let (a, b) = (px * direction.x + py * direction.y, py * direction.x - px * direction.y);
            extend(&mut along, a);
            extend(&mut widest, b);
        }
        // The line stays on the center of the gradient, with the width shared out to both sides.
        let half_width = 0.5 * (widest[1] - widest[0]).max(1.0);
        let center = Vector2::new(x + f64::from(origin.x), y + f64::from(origin.y));
        Self { center, direction, along, across: [-half_width, half_width] }
    }

    pub fn length(&self) -> f64 {
        self.along[1] - self.along[0]
    }

    pub fn width(&self) -> f64 {
        self.across[1] - self.across[0]
    }

    /// To the right of the direction.
    pub fn normal(&self) -> Vector2<f64> {
        Vector2::new(-self.direction.y, self.direction.x)
    }

    /// Start and end of its middle line.
    pub fn ends(&self) -> [Vector2<f64>; 2] {
        let middle = self.center + self.normal() * (0.5 * (self.across[0] + self.across[1]));
        self.along.map(|along| middle + self.direction * along)
    }

    /// Calls `visit` with row, first and last column of the pixels inside, for each row of an image of the
    /// given size.
    pub fn visit_rows(&self, width: usize, height: usize, mut visit: impl FnMut(usize, usize, usize)) {
        let (d, n) = (self.direction, self.normal());
        let corners = [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(i, j)| self.center.y + self.along[i] * d.y + self.across[j] * n.y);
        let top = corners.iter().copied().fold(f64::INFINITY, f64::min).ceil().max(0.0);
        let bottom =
            corners.iter().copied().fold(f64::NEG_INFINITY, f64::max).floor().min(height as f64 - 1.0);
        if top > bottom {
            return;
        }
        for row in top as usize..=bottom as usize {
            let dy = row as f64 - self.center.y;
            // The part of the row inside both pairs of parallel sides.
            let (mut from, mut to) = (0.0f64, width as f64 - 1.0);
            for (axis, [low, high]) in [(d, self.along), (n, self.across)] {
                if axis.x.abs() < 1e-9 {
                    if !(low..=high).contains(&(dy * axis.y)) {
                        to = -1.0;
                    }
                    continue;
                }
                let bounds = [low, high].map(|bound| self.center.x + (bound - dy * axis.y) / axis.x);
                from = from.max(bounds[0].min(bounds[1]));
                to = to.min(bounds[0].max(bounds[1]));
            }
            let (from, to) = (from.ceil(), to.floor());
            if from <= to {
                visit(row, from as usize, to as usize);
            }
        }
    }
}

/// Makes an interval contain a number.
#[inline]
fn extend(interval: &mut [f64; 2], value: f64) {
    // Unlike `min` and `max`, without care for numbers that are none: half the work.
    interval[0] = if value < interval[0] { value } else { interval[0] };
    interval[1] = if value > interval[1] { value } else { interval[1] };
}
