//! Locates corners between pixels.

use super::DetectionConfig;
use crate::Board;
use geometry::nalgebra::{Matrix2, Vector2};
use vision::GrayImage;

/// Rounds at most; each begins where the last ended.
const MAX_ROUNDS: usize = 20;
/// Steps below this are not worth another round, pixels.
const TOLERANCE_PX: f64 = 1e-3;
/// The smallest window, pixels to all sides.
const MIN_WINDOW_PX: f64 = 2.0;
/// Standard deviation of the weights, in windows.
const WEIGHT_SHARE: f64 = 0.5;

/// Corners where all gradients around point away from them or have none: `Σ w g gᵀ (p - q) = 0` over pixels
/// `p` with gradient `g`, for the corner `q` [Förstner & Gülch 1987]. `None` if one moves away from where it
/// was found.
pub fn locate(
    image: &GrayImage,
    found: Vec<Vector2<f64>>,
    board: &Board,
    config: &DetectionConfig,
) -> Option<Vec<Vector2<f64>>> {
    let reach = |idx: usize| {
        let (column, row) = ((idx % board.columns()) as isize, (idx / board.columns()) as isize);
        let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(|(dx, dy)| {
            let (x, y) = (column + dx, row + dy);
            let is_inside =
                (0..board.columns() as isize).contains(&x) && (0..board.rows() as isize).contains(&y);
            is_inside.then(|| found[y as usize * board.columns() + x as usize])
        });
        beside.map(|other| (other - found[idx]).norm()).fold(f64::INFINITY, f64::min)
    };
    (0..found.len())
        .map(|idx| {
            let spacing = reach(idx);
            let window = (config.window_share * spacing).clamp(MIN_WINDOW_PX, config.max_window_px);
            let corner = locate_one(image, found[idx], window)?;
            ((corner - found[idx]).norm() < 0.5 * spacing).then_some(corner)
        })
        .collect()
}

fn locate_one(image: &GrayImage, start: Vector2<f64>, window: f64) -> Option<Vector2<f64>> {
    let reach = window.ceil() as i32;
    let mut corner = start;
    for _ in 0..MAX_ROUNDS {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let offset = Vector2::new(f64::from(dx), f64::from(dy));
                let weight = (-0.5 * (offset.norm() / (WEIGHT_SHARE * window)).powi(2)).exp();
                let gradient = gradient(image, &(corner + offset))?;
                let outer = gradient * gradient.transpose() * weight;
                normal += outer;
                right += outer * offset;
            }
        }
        let step = normal.try_inverse()? * right;
        corner += step;
        if !step.iter().all(|x| x.is_finite()) || (corner - start).norm() > 2.0 * window + 2.0 {
            return None;
        }
        if step.norm() < TOLERANCE_PX {
            return Some(corner);
        }
    }
    Some(corner)
}

/// Central differences over two pixels; `None` at the image's border.
fn gradient(image: &GrayImage, at: &Vector2<f64>) -> Option<Vector2<f64>> {
    let dx = sample(image, at.x + 1.0, at.y)? - sample(image, at.x - 1.0, at.y)?;
    let dy = sample(image, at.x, at.y + 1.0)? - sample(image, at.x, at.y - 1.0)?;
    Some(Vector2::new(0.5 * dx, 0.5 * dy))
}

fn sample(image: &GrayImage, x: f64, y: f64) -> Option<f64> {
    let (left, top) = (x.floor(), y.floor());
    if !(left >= 0.0 && top >= 0.0) {
        return None;
    }
    let (u, v) = (x - left, y - top);
    let value = |dx: u32, dy: u32| image.get(left as u32 + dx, top as u32 + dy).map(f64::from);
    let upper = (1.0 - u) * value(0, 0)? + u * value(1, 0)?;
    let lower = (1.0 - u) * value(0, 1)? + u * value(1, 1)?;
    Some((1.0 - v) * upper + v * lower)
}
