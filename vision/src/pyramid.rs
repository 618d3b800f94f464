//! The scale pyramid: each level is the one before, shrunk by a constant factor.

use crate::GrayImage;
use crate::scale::BilinearResizer;

/// An image at falling resolutions. Buffers are kept from frame to frame, so a steady stream allocates
/// nothing.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    levels: Vec<GrayImage>,
    scale_factors: Vec<f32>,
    resizer: BilinearResizer,
}

impl Pyramid {
    /// A pyramid of `n_levels` (at least 1) levels, each `scale_factor` (above 1) smaller than the one before
    /// it. It holds no image yet: see [`Pyramid::build`].
    pub fn new(n_levels: usize, scale_factor: f32) -> Self {
        let n_levels = n_levels.max(1);
        Self {
            levels: vec![GrayImage::default(); n_levels],
            scale_factors: (0..n_levels).map(|level| scale_factor.powi(level as i32)).collect(),
            resizer: BilinearResizer::default(),
        }
    }

    /// Fills all levels from `image`, which becomes level 0. Level sizes are rounded, at least 1 pixel.
    pub fn build(&mut self, image: &GrayImage) {
        self.levels[0].reshape(image.width(), image.height());
        self.levels[0].as_raw_mut().copy_from_slice(image.as_raw());
        for level in 1..self.levels.len() {
            let side = |full: u32| ((full as f32 / self.scale_factors[level]).round() as u32).max(1);
            let (width, height) = (side(image.width()), side(image.height()));
            let (finer, coarser) = self.levels.split_at_mut(level);
            self.resizer.resize(&finer[level - 1], width, height, &mut coarser[0]);
        }
    }

    /// The levels, finest first.
    pub fn levels(&self) -> &[GrayImage] {
        &self.levels
    }

    /// One level; 0 is the image itself. Panics if there is no such level.
    pub fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// `scale_factor^level`: pixels of level 0 for one pixel of `level`.
    pub fn scale_factors(&self) -> &[f32] {
        &self.scale_factors
    }
}
