//! Finds a chessboard in an image: saddles of the gray levels, joined into a lattice, located to a few
//! hundredths of a pixel.

mod lattice;
mod locate;
mod saddles;

use crate::{Board, View};
use geometry::nalgebra::Vector2;
use vision::{GrayImage, scale};

/// How a board is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectionConfig {
    /// Longer sides of the images that the board is looked for in, one after the other, pixels; what is
    /// larger is reduced, for blur and noise hide corners, and squares must be seven pixels wide. Default
    /// 640, 1280, 320 and 2560.
    pub sides_px: [u32; 4],
    /// Gray levels between black and white squares, at least. Default 12.
    pub min_contrast: f32,
    /// Corners are located in a window of this share of the distance to the nearest neighbor, to all sides.
    /// Default 0.6: edges that do not meet in the corner begin at 1.
    pub window_share: f64,
    /// The same at most, pixels. Default 12: beyond, lenses bend the edges.
    pub max_window_px: f64,
}

impl Default for DetectionConfig {
    fn default() -> Self {
        Self { sides_px: [640, 1280, 320, 2560], min_contrast: 12.0, window_share: 0.6, max_window_px: 12.0 }
    }
}

/// The corners of the whole board in an image; `None` where it is not seen, or not all of it.
pub fn find_board(image: &GrayImage, board: &Board, config: &DetectionConfig) -> Option<View> {
    let longer = image.width().max(image.height());
    let mut looked_at = Vec::new();
    for side in config.sides_px {
        let factor = (f64::from(side) / f64::from(longer.max(1))).min(1.0);
        let size = [image.width(), image.height()].map(|n| (f64::from(n) * factor).round().max(1.0) as u32);
        if looked_at.contains(&size) {
            continue;
        }
        looked_at.push(size);
        let is_whole = size == [image.width(), image.height()];
        let reduced = if is_whole { image.clone() } else { scale::resize_area(image, size[0], size[1]) };
        let Some(corners) = lattice::find(&saddles::find(&reduced, config, board.n_corners()), board) else {
            continue;
        };
        let up = Vector2::new(image.width(), image.height())
            .cast::<f64>()
            .component_div(&Vector2::new(size[0], size[1]).cast());
        let at_full_size = corners
            .iter()
            .map(|corner| (corner.add_scalar(0.5)).component_mul(&up).add_scalar(-0.5))
            .collect();
        if let Some(located) = locate::locate(image, at_full_size, board, config) {
            return Some(View { corners: located });
        }
    }
    None
}
