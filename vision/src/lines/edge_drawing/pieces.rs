//! Cutting an edge into straight pieces.

use nalgebra::Vector2;

use crate::lines::fit::{FittedLine, Moments};
use crate::lines::gradient::Gradients;
use crate::lines::select::Ends;

/// A straight piece of an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub ends: Ends,
    /// Of the edge's pixels, to a fraction.
    pub moments: Moments,
}

/// A piece begins with so many pixels in a row that lie on a line.
pub(super) const SEED: usize = 10;
/// By so much at most they stray from it, squared pixels (mean square).
const MAX_SEED_VARIANCE: f64 = 0.3 * 0.3;
/// Without such a line, the next place tried is so many pixels on.
const SEED_STEP: usize = 3;
/// Farther from the line a pixel does not belong to the piece.
const MAX_DISTANCE_PX: f64 = 0.9;
/// After so many pixels in a row that do not belong to it the piece has ended.
const MAX_STRAYS: usize = 4;
/// A piece whose pixels stray more is a curve, squared pixels.
const MAX_VARIANCE: f64 = 0.5 * 0.5;
/// The line is fitted again whenever the piece has grown by this factor.
const REFIT_GROWTH: f64 = 1.25;
/// The gradient is in line with the piece if its angle to the normal is at most this: the tangent of 0.2
/// radians.
const ALIGNED_TANGENT: f64 = 0.2027;
/// A piece must have this share of pixels whose gradient is in line.
const MIN_ALIGNED_SHARE: f64 = 0.5;

/// Appends the straight pieces of an edge, given as pixel indices and as positions to a fraction.
pub(super) fn cut(gradients: &Gradients, chain: &[u32], points: &[Vector2<f32>], pieces: &mut Vec<Piece>) {
    let mut from = 0;
    while from + SEED <= points.len() {
        let Some(seed) = seed_at(&points[from..from + SEED]) else {
            from += SEED_STEP;
            continue;
        };
        let grown = grow(points, from, seed);
        let line = grown.moments.fit().directed_like(points[grown.end - 1] - points[from]);
        if line.variance <= MAX_VARIANCE && is_aligned(gradients, &chain[from..grown.end], &line) {
            let along = |point: Vector2<f32>| line.at(line.along(point));
            let ends = Ends { start: along(points[from]), end: along(points[grown.end - 1]) };
            pieces.push(Piece { ends, moments: grown.moments });
        }
        from = grown.end;
    }
}

/// The moments of points that lie on a line.
fn seed_at(points: &[Vector2<f32>]) -> Option<Moments> {
    let mut moments = Moments::default();
    for &point in points {
        moments.push(point);
    }
    (moments.fit().variance <= MAX_SEED_VARIANCE).then_some(moments)
}

struct Grown {
    /// Of the points on the line.
    moments: Moments,
    /// One beyond the last of them.
    end: usize,
}

/// Extends a seed at `from` along the chain for as long as points lie on the line.
fn grow(points: &[Vector2<f32>], from: usize, seed: Moments) -> Grown {
    let mut grown = Grown { moments: seed, end: from + SEED };
    let mut line = seed.fit();
    let mut refit_at = REFIT_GROWTH * seed.n;
    for (i, &point) in points.iter().enumerate().skip(from + SEED) {
        if line.distance(point).abs() <= MAX_DISTANCE_PX {
            grown.moments.push(point);
            grown.end = i + 1;
            if grown.moments.n >= refit_at {
                line = grown.moments.fit();
                refit_at = REFIT_GROWTH * grown.moments.n;
            }
        } else if i >= grown.end + MAX_STRAYS {
            break;
        }
    }
    grown
}

/// Whether the gradients along an edge are those of the line.
fn is_aligned(gradients: &Gradients, chain: &[u32], line: &FittedLine) -> bool {
    let normal = Vector2::new(-line.direction.y, line.direction.x);
    let n_aligned = chain
        .iter()
        .filter(|&&at| {
            let at = at as usize;
            let gradient = Vector2::new(f64::from(gradients.x[at]), f64::from(gradients.y[at]));
            gradient.dot(&line.direction).abs() <= ALIGNED_TANGENT * gradient.dot(&normal)
        })
        .count();
    n_aligned as f64 >= MIN_ALIGNED_SHARE * chain.len() as f64
}
