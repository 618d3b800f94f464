//! Lines through shifts and through points.

use nalgebra::Vector2;

use crate::lines::fit::{FittedLine, Moments};

/// Most pairs of places tried for the line most places agree on: with 30 % outliers any one pair is good
/// every other time, so 40 all but never fail together.
const MAX_PAIRS: usize = 40;

/// How far an edge has moved across itself, linear in the position along it: `offset + slope * along`,
/// pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ShiftLine {
    pub offset: f32,
    pub slope: f32,
}

impl ShiftLine {
    pub fn at(&self, along: f32) -> f32 {
        self.offset + self.slope * along
    }

    /// The line most of the `(along, shift)` agree on within `tolerance` pixels, fitted to those. Pairs of
    /// places well apart are tried in a fixed order. `None` if fewer than half agree on any line, or there
    /// are fewer than two.
    pub fn fit(shifts: &[(f32, f32)], tolerance: f32) -> Option<Self> {
        let n = shifts.len();
        let min_apart = n.div_ceil(3).max(1);
        let n_pairs = n.saturating_sub(min_apart) * (n.saturating_sub(min_apart) + 1) / 2;
        let stride = n_pairs.div_ceil(MAX_PAIRS).max(1);
        let pairs = (0..n).flat_map(|i| (i + min_apart..n).map(move |j| (i, j))).step_by(stride);
        let agrees = |line: &Self, shift: &&(f32, f32)| (line.at(shift.0) - shift.1).abs() <= tolerance;
        let mut best: Option<(usize, Self)> = None;
        for (i, j) in pairs {
            let Some(line) = Self::through(shifts[i], shifts[j]) else { continue };
            let n_agreeing = shifts.iter().filter(|shift| agrees(&line, shift)).count();
            if best.is_none_or(|(n_best, _)| n_agreeing > n_best) {
                best = Some((n_agreeing, line));
                if n_agreeing == n {
                    break;
                }
            }
        }
        let (n_agreeing, line) = best?;
        let agreeing = shifts.iter().filter(|shift| agrees(&line, shift));
        (2 * n_agreeing >= n).then(|| Self::least_squares(agreeing).unwrap_or(line))
    }

    fn through(a: (f32, f32), b: (f32, f32)) -> Option<Self> {
        let slope = (b.1 - a.1) / (b.0 - a.0);
        slope.is_finite().then_some(Self { offset: a.1 - slope * a.0, slope })
    }

    fn least_squares<'a>(shifts: impl Iterator<Item = &'a (f32, f32)> + Clone) -> Option<Self> {
        let n = shifts.clone().count() as f32;
        let sum = shifts.clone().fold((0.0, 0.0), |sum, shift| (sum.0 + shift.0, sum.1 + shift.1));
        let mean = (sum.0 / n, sum.1 / n);
        let (mut spread, mut joint) = (0.0, 0.0);
        for (along, shift) in shifts {
            spread += (along - mean.0).powi(2);
            joint += (along - mean.0) * (shift - mean.1);
        }
        let slope = joint / spread;
        slope.is_finite().then_some(Self { offset: mean.1 - slope * mean.0, slope })
    }
}

/// The line of least squared distances, directed within a right angle of `towards`. `None` for fewer than two
/// points or points that are not finite.
pub(super) fn fit_points(points: &[Vector2<f32>], towards: Vector2<f32>) -> Option<FittedLine> {
    if points.len() < 2 || !points.iter().all(|point| point.iter().all(|value| value.is_finite())) {
        return None;
    }
    let mut moments = Moments::default();
    points.iter().for_each(|point| moments.push(*point));
    Some(moments.fit().directed_like(towards))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_of_outliers_does_not_matter() {
        let shifts: Vec<(f32, f32)> = (0..18)
            .map(|i| {
                (10.0 * i as f32, if i % 3 == 1 { -20.0 + i as f32 } else { 2.0 + 0.03 * 10.0 * i as f32 })
            })
            .collect();
        let line = ShiftLine::fit(&shifts, 0.5).unwrap();
        assert!((line.offset - 2.0).abs() < 1e-3 && (line.slope - 0.03).abs() < 1e-4, "{line:?}");
        assert_eq!(ShiftLine::fit(&[], 1.0), None);
        assert_eq!(ShiftLine::fit(&[(1.0, 1.0)], 1.0), None);
        assert_eq!(ShiftLine::fit(&[(1.0, 1.0), (1.0, 4.0)], 1.0), None);
    }

    #[test]
    fn points_of_any_direction_are_fitted() {
        for degrees in [0.0f32, 37.0, 90.0, 143.0] {
            let along = Vector2::new(degrees.to_radians().cos(), degrees.to_radians().sin());
            let across = Vector2::new(-along.y, along.x);
            let points: Vec<_> = (0..10)
                .map(|i| {
                    let side = if i % 2 == 0 { 0.2 } else { -0.2 };
                    Vector2::new(300.0, 200.0) + along * (10.0 * i as f32) + across * side
                })
                .collect();
            let line = fit_points(&points, -along).unwrap();
            assert!(line.direction.dot(&along.cast()) < -0.999);
            assert!((line.sigma_px() - 0.2).abs() < 0.01, "{}", line.sigma_px());
        }
        assert!(fit_points(&[Vector2::zeros()], Vector2::x()).is_none());
    }
}
