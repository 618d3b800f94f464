//! A straight edge between two endpoints.

use nalgebra::Vector2;

/// A line segment in an image, directed so that the brighter side lies to its right on the screen.
///
/// On the screen (x right, y down) the right of a direction `(dx, dy)` is `(-dy, dx)`: a segment that runs
/// right has the brighter side below it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where it begins, pixels.
    pub start: Vector2<f32>,
    /// Where it ends, pixels.
    pub end: Vector2<f32>,
    /// Standard deviation of the edge's position across the segment, pixels: how well the line fits the edge.
    pub sigma_px: f32,
    /// Mean gradient across the segment, gray levels per pixel.
    pub gradient: f32,
}

impl Segment {
    /// From start to end, pixels.
    #[inline]
    pub fn vector(&self) -> Vector2<f32> {
        self.end - self.start
    }

    /// Length, pixels.
    #[inline]
    pub fn length(&self) -> f32 {
        self.vector().norm()
    }

    /// The point half way, pixels.
    #[inline]
    pub fn midpoint(&self) -> Vector2<f32> {
        (self.start + self.end) * 0.5
    }

    /// Unit vector from start to end; zero for a segment without length.
    #[inline]
    pub fn direction(&self) -> Vector2<f32> {
        self.vector().try_normalize(0.0).unwrap_or_default()
    }

    /// Unit vector to the brighter side.
    #[inline]
    pub fn normal(&self) -> Vector2<f32> {
        let direction = self.direction();
        Vector2::new(-direction.y, direction.x)
    }

    /// The signed distance of a pixel from the segment's line, positive on the brighter side, pixels.
    #[inline]
    pub fn distance(&self, pixel: &Vector2<f32>) -> f32 {
        self.normal().dot(&(pixel - self.start))
    }

    /// Whether every number in it is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        let numbers = [self.start.x, self.start.y, self.end.x, self.end.y, self.sigma_px, self.gradient];
        numbers.iter().all(|number| number.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brighter_side_is_to_the_right() {
        let runs_right = Segment {
            start: Vector2::new(2.0, 5.0),
            end: Vector2::new(8.0, 5.0),
            sigma_px: 0.3,
            gradient: 10.0,
        };
        assert_eq!(runs_right.normal(), Vector2::new(0.0, 1.0));
        assert_eq!(runs_right.distance(&Vector2::new(4.0, 7.0)), 2.0);
        assert_eq!(runs_right.midpoint(), Vector2::new(5.0, 5.0));
        assert_eq!(runs_right.length(), 6.0);
    }
}
