//! The last images of a session with what was measured in them, for whoever watches.

use super::frame::SentImage;
use slam::ObservedFrame;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Images kept: a third of a second of video, in which a viewer that was told of a frame can ask for it.
const MAX_IMAGES: usize = 10;
/// Bytes of images kept at most; the newest is kept whatever its size, which the limits of messages bound.
const MAX_BYTES: usize = 32 << 20;

/// An image with what was measured in it.
#[derive(Clone, Debug)]
pub struct ShownFrame {
    /// The image as it was sent.
    pub image: SentImage,
    /// What was measured and recognized in it.
    pub observed: ObservedFrame,
}

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub struct Gallery(Arc<Mutex<VecDeque<Arc<ShownFrame>>>>);

impl Gallery {
    /// Keeps a frame; the oldest go when there are too many.
    pub fn show(&self, frame: ShownFrame) {
        let mut frames = self.lock();
        frames.push_back(Arc::new(frame));
        let n_bytes = |frames: &VecDeque<Arc<ShownFrame>>| -> usize {
            frames.iter().map(|frame| frame.image.data.len()).sum()
        };
        while frames.len() > 1 && (frames.len() > MAX_IMAGES || n_bytes(&frames) > MAX_BYTES) {
            frames.pop_front();
        }
    }

    /// Forgets every frame, when the session leaves memory.
    pub fn clear(&self) {
        self.lock().clear();
    }

    /// A frame, if it is still kept.
    pub fn frame(&self, sequence: u64) -> Option<Arc<ShownFrame>> {
        self.lock().iter().find(|frame| frame.observed.sequence == sequence).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<ShownFrame>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::frame::Encoding;
    use geometry::{Camera, CameraModel, CameraParameters};
    use slam::features::{FrameFeatures, PyramidGeometry};

    fn frame(sequence: u64, n_bytes: usize) -> ShownFrame {
        let (model, distortion) = (CameraModel::Pinhole, Vec::new());
        let (fx, fy, cx, cy) = (160.0, 160.0, 79.5, 59.5);
        let camera = CameraParameters { model, width: 160, height: 120, fx, fy, cx, cy, distortion };
        let camera = Camera::new(camera).unwrap();
        let pyramid = PyramidGeometry { n_levels: 1, scale_factor: 1.2 };
        let features = FrameFeatures::from_parts(Vec::new(), Vec::new(), &camera, pyramid).unwrap();
        let (points, lines, primitives) = (Vec::new(), Vec::new(), Vec::new());
        let observed = ObservedFrame { sequence, features: Arc::new(features), points, lines, primitives };
        let data = vec![0; n_bytes].into();
        let image = SentImage { encoding: Encoding::Auto, width: 0, height: 0, row_stride: 0, data };
        ShownFrame { image, observed }
    }

    #[test]
    fn the_last_frames_are_there_and_no_more() {
        let gallery = Gallery::default();
        (0..100).for_each(|sequence| gallery.show(frame(sequence, 1)));
        assert!(gallery.frame(99).is_some() && gallery.frame(90).is_some());
        assert!(gallery.frame(89).is_none());
    }

    #[test]
    fn large_images_push_others_out_but_not_themselves() {
        let gallery = Gallery::default();
        gallery.show(frame(0, 1));
        gallery.show(frame(1, MAX_BYTES));
        assert!(gallery.frame(0).is_none());
        assert_eq!(gallery.frame(1).unwrap().image.data.len(), MAX_BYTES);
    }
}
