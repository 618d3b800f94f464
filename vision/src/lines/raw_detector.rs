//! What every way of finding segments offers to the [detector](super::detector) that makes them fit for SLAM.

use crate::GrayImage;
use crate::lines::gradient::Gradients;
use crate::lines::select::Ends;

/// Finds segments as they come: any number, to a pixel.
pub(super) trait RawDetector: Send {
    /// Appends the segments of `image`, whose gradient is `gradients`, to `segments`: start and end, brighter
    /// side to the right.
    fn detect(&mut self, image: &GrayImage, gradients: &Gradients, segments: &mut Vec<Ends>);
}
