//! The images that flow works on, from fine to coarse.

use crate::GrayImage;
use crate::lines::sampling::halve;

/// The levels flow works on: the image, and the same in half and quarter the resolution.
#[derive(Clone, Debug, Default)]
pub struct FlowPyramid {
    pub(super) levels: [GrayImage; N_LEVELS],
}

/// Levels: at the coarsest a pixel is four of the image's.
pub(super) const N_LEVELS: usize = 3;

impl FlowPyramid {
    /// Fills all levels, reusing their buffers.
    pub fn build(&mut self, image: &GrayImage) {
        self.levels[0].reshape(image.width(), image.height());
        self.levels[0].as_raw_mut().copy_from_slice(image.as_raw());
        for level in 1..N_LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(level);
            halve(&finer[level - 1], &mut coarser[0]);
        }
    }

    /// The image itself.
    pub fn image(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// The image in half its resolution.
    pub(in crate::lines) fn halved(&self) -> &GrayImage {
        &self.levels[1]
    }
}
