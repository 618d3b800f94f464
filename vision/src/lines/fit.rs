//! Total least squares: the line with the smallest sum of squared distances from some points.

use nalgebra::Vector2;

/// Sums over points, from which the best line follows; sums of two sets of points add up to those of both.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    /// Points.
    pub n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

/// A line through a point, with how well it fits.
#[derive(Clone, Copy, Debug)]
pub(super) struct FittedLine {
    /// Mean of the points.
    pub center: Vector2<f64>,
    /// Unit vector along the line, of either sense.
    pub direction: Vector2<f64>,
    /// Variance of the points across the line, squared pixels.
    pub variance: f64,
}

impl Moments {
    #[inline]
    pub fn push(&mut self, point: Vector2<f32>) {
        let (x, y) = (f64::from(point.x), f64::from(point.y));
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// The moments of both sets of points together.
    pub fn merged(&self, other: &Self) -> Self {
        Self {
            n: self.n + other.n,
            x: self.x + other.x,
            y: self.y + other.y,
            xx: self.xx + other.xx,
            xy: self.xy + other.xy,
            yy: self.yy + other.yy,
        }
    }

    /// The best line through at least two points; one that has no direction for points that all coincide runs
    /// along x.
    pub fn fit(&self) -> FittedLine {
        let n = self.n.max(1.0);
        let center = Vector2::new(self.x / n, self.y / n);
        let xx = self.xx / n - center.x * center.x;
        let xy = self.xy / n - center.x * center.y;
        let yy = self.yy / n - center.y * center.y;
        // Eigenvalues of [[xx, xy], [xy, yy]]: mean -+ radius.
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let radius = (half * half + xy * xy).sqrt();
        // Of the two ways to write the eigenvector of the larger one, the one without cancellation.
        let along =
            if half >= 0.0 { Vector2::new(half + radius, xy) } else { Vector2::new(xy, radius - half) };
        let direction = along.try_normalize(1e-12).unwrap_or_else(Vector2::x);
        FittedLine { center, direction, variance: (mean - radius).max(0.0) }
    }
}

impl FittedLine {
    /// Root mean square distance of the points from the line, pixels.
    #[inline]
    pub fn sigma_px(&self) -> f32 {
        self.variance.sqrt() as f32
    }

    /// Distance of a point from the line, pixels, signed.
    #[inline]
    pub fn distance(&self, point: Vector2<f32>) -> f64 {
        let offset = point.cast::<f64>() - self.center;
        self.direction.x * offset.y - self.direction.y * offset.x
    }

    /// Where a point's foot lies along the line, pixels from the center.
    #[inline]
    pub fn along(&self, point: Vector2<f32>) -> f64 {
        (point.cast::<f64>() - self.center).dot(&self.direction)
    }

    /// The point at `along`.
    #[inline]
    pub fn at(&self, along: f64) -> Vector2<f32> {
        (self.center + self.direction * along).cast()
    }

    /// Turned, if need be, to run the same way as `direction`.
    pub fn directed_like(mut self, direction: Vector2<f32>) -> Self {
        if self.direction.dot(&direction.cast()) < 0.0 {
            self.direction = -self.direction;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Random;

    #[test]
    fn the_line_through_points_in_any_direction_is_found() {
        for degrees in (0..180).step_by(15) {
            let angle = f64::from(degrees).to_radians();
            let (direction, normal) =
                (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
            let mut random = Random::new(7);
            let mut halves = [Moments::default(); 2];
            for i in 0..2000 {
                let across = f64::from(random.unit()) - 0.5;
                let point = Vector2::new(300.0, 200.0) + direction * f64::from(i) * 0.1 + normal * across;
                halves[i as usize % 2].push(point.cast());
            }
            let line = halves[0].merged(&halves[1]).fit().directed_like(direction.cast());
            assert!((line.direction - direction).norm() < 2e-3, "{degrees} degrees");
            assert!((line.variance - 1.0 / 12.0).abs() < 5e-3, "{degrees} degrees: {}", line.variance);
            assert!(line.distance(Vector2::new(300.0, 200.0)).abs() < 0.05);
        }
    }

    #[test]
    fn points_that_coincide_give_a_finite_line() {
        let mut moments = Moments::default();
        for _ in 0..5 {
            moments.push(Vector2::new(3.0, 4.0));
        }
        let line = moments.fit();
        assert!(line.variance < 1e-9 && (line.direction.norm() - 1.0).abs() < 1e-9);
        assert!(Moments::default().fit().center.norm() < 1e-9);
    }
}
