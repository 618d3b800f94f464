//! Regions that bend around a corner or along a curve are cut back until they fill their rectangle.

use super::MIN_DENSITY;
use super::field::Field;
use super::rectangle::Rectangle;
use super::region::{Region, squared_distance};

/// Factor by which the radius around the seed shrinks.
const SHRINKING: f64 = 0.75;

/// The share of a rectangle its region fills.
fn density(region: &Region, rectangle: &Rectangle) -> f64 {
    region.pixels.len() as f64 / (rectangle.length() * rectangle.width())
}

/// A rectangle that is dense enough: the one given, or that of a smaller region.
pub(super) fn densify(field: &mut Field, region: &mut Region, rectangle: Rectangle) -> Option<Rectangle> {
    if density(region, &rectangle) >= MIN_DENSITY {
        return Some(rectangle);
    }
    // First with a tolerance suited to how much the directions vary near the seed.
    let tolerance = tolerance_near_seed(field, region, rectangle.width());
    region.release(field);
    let seed = region.pixels[0];
    region.grow(field, seed, tolerance);
    if region.pixels.len() < 2 {
        return None;
    }
    let rectangle = Rectangle::around(field, region);
    if density(region, &rectangle) >= MIN_DENSITY {
        return Some(rectangle);
    }
    shrink(field, region, rectangle)
}

/// Twice the standard deviation of the directions of the region's pixels closer to the seed than `radius`,
/// radians.
fn tolerance_near_seed(field: &Field, region: &Region, radius: f64) -> f32 {
    let seed = region.pixels[0];
    let towards = field.direction[field.at(seed)];
    let (mut n, mut sum, mut squares) = (0.0f32, 0.0f32, 0.0f32);
    for &pixel in region.pixels.iter().filter(|&&pixel| squared_distance(seed, pixel) < radius * radius) {
        let direction = field.direction[field.at(pixel)];
        let angle = towards.perp(&direction).atan2(towards.dot(&direction));
        n += 1.0;
        sum += angle;
        squares += angle * angle;
    }
    let n = n.max(1.0);
    2.0 * (squares / n - (sum / n).powi(2)).max(0.0).sqrt()
}

/// Gives up the pixels farthest from the seed until the rest is dense enough.
fn shrink(field: &mut Field, region: &mut Region, mut rectangle: Rectangle) -> Option<Rectangle> {
    let seed = region.pixels[0];
    let [start, end] = rectangle.ends();
    let from_seed =
        |end: nalgebra::Vector2<f64>| (end.x - f64::from(seed.x)).hypot(end.y - f64::from(seed.y));
    let mut radius = from_seed(start).max(from_seed(end));
    while density(region, &rectangle) < MIN_DENSITY {
        radius *= SHRINKING;
        region.shrink(field, radius);
        if region.pixels.len() < 2 {
            return None;
        }
        rectangle = Rectangle::around(field, region);
    }
    Some(rectangle)
}
