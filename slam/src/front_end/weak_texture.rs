//! Weak texture: where ordinary thresholds find too few corners for a map, local contrast is amplified first.
//! [method: Weak texture]

use crate::config::SlamConfig;
use vision::contrast::ContrastAmplifier;
use vision::{Features, GrayImage, OrbExtractor};

/// Frames in a row that must be too poor, or rich again, before that is believed: one blurred image says
/// nothing.
const N_AGREEING_FRAMES: usize = 3;
/// Corners above the ordinary threshold, as a multiple of what a map needs, from which on an image needs no
/// amplification.
const RICH_FACTOR: usize = 4;

/// What a session's camera is doing, as far as amplification depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CameraState {
    /// It begins a map.
    Beginning,
    /// It has a pose in the map.
    Followed,
    /// It is looked for in the map.
    Lost,
}

/// Decides whether a session's images are amplified. Descriptors of amplified images are matched with those
/// of others less well, so the decision holds until the scene has clearly changed.
///
/// The state is not stored. A lost camera is looked for both ways, as its images need it: so a resumed
/// session finds out what its map was made of.
#[derive(Debug)]
pub(super) struct WeakTexture {
    amplifier: ContrastAmplifier,
    is_on: bool,
    camera: CameraState,
    /// Frames in a row that speak for the other choice.
    n_against: usize,
    /// Keypoints that a first map needs.
    min_keypoints: usize,
    /// Gray levels from which on a corner counts as ordinary texture.
    ordinary_threshold: f32,
}

impl WeakTexture {
    pub fn new(config: &SlamConfig) -> Self {
        Self {
            amplifier: ContrastAmplifier::default(),
            is_on: false,
            camera: CameraState::Beginning,
            n_against: 0,
            min_keypoints: config.initialization.min_keypoints,
            ordinary_threshold: f32::from(config.orb.min_fast_threshold),
        }
    }

    /// Amplification is begun only while the camera has no pose: a map of ordinary corners that is being
    /// followed would lose its own.
    pub fn set_camera_state(&mut self, camera: CameraState) {
        self.camera = camera;
    }

    /// The features of an image, amplified if the session needs it.
    pub fn extract(&mut self, extractor: &mut OrbExtractor, image: &GrayImage) -> Features {
        if !self.is_on {
            let features = extractor.extract(image);
            let is_poor = features.len() < self.min_keypoints;
            self.count(self.camera != CameraState::Followed && is_poor);
            return features;
        }
        let (amplified, gain) = self.amplifier.amplify(image);
        let features = extractor.extract(&amplified);
        let threshold = gain * self.ordinary_threshold;
        let n_ordinary = features.keypoints.iter().filter(|corner| corner.response > threshold).count();
        // A lost camera has nothing to lose by a change, and what it is looked for in may be of either kind.
        let factor = if self.camera == CameraState::Lost { 1 } else { RICH_FACTOR };
        self.count(n_ordinary >= factor * self.min_keypoints);
        features
    }

    /// Takes note of whether a frame speaks against the present choice.
    fn count(&mut self, is_against: bool) {
        self.n_against = if is_against { self.n_against + 1 } else { 0 };
        if self.n_against >= N_AGREEING_FRAMES {
            self.is_on = !self.is_on;
            self.n_against = 0;
            tracing::info!(amplified = self.is_on, "local contrast of images");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vision::OrbConfig;

    /// Faint speckles of a few gray levels, or plain ones.
    fn speckled(contrast: u8) -> GrayImage {
        let hash = |x: u32, y: u32| (x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77)) >> 13;
        GrayImage::from_fn(320, 240, |x, y| 100 + contrast * (hash(x / 6, y / 6) % 3) as u8)
    }

    #[test]
    fn faint_texture_is_amplified_until_there_is_plain_texture() {
        let mut extractor = OrbExtractor::new(OrbConfig::default()).unwrap();
        let mut weak = WeakTexture::new(&SlamConfig::default());
        weak.set_camera_state(CameraState::Beginning);
        for _ in 0..N_AGREEING_FRAMES {
            assert!(weak.extract(&mut extractor, &speckled(2)).len() < 100);
        }
        assert!(weak.is_on);
        weak.set_camera_state(CameraState::Followed);
        assert!(weak.extract(&mut extractor, &speckled(2)).len() > 300);
        for _ in 0..N_AGREEING_FRAMES {
            weak.extract(&mut extractor, &speckled(60));
        }
        assert!(!weak.is_on);
    }

    #[test]
    fn a_map_of_ordinary_corners_that_is_followed_keeps_them() {
        let mut extractor = OrbExtractor::new(OrbConfig::default()).unwrap();
        let mut weak = WeakTexture::new(&SlamConfig::default());
        weak.set_camera_state(CameraState::Followed);
        for _ in 0..3 * N_AGREEING_FRAMES {
            weak.extract(&mut extractor, &speckled(2));
        }
        assert!(!weak.is_on, "there was no map to begin");
    }

    #[test]
    fn a_lost_camera_is_looked_for_amplified_and_as_it_is() {
        let mut extractor = OrbExtractor::new(OrbConfig::default()).unwrap();
        let mut weak = WeakTexture::new(&SlamConfig::default());
        weak.set_camera_state(CameraState::Lost);
        let mut show = |contrast: u8| {
            for _ in 0..N_AGREEING_FRAMES {
                weak.extract(&mut extractor, &speckled(contrast));
            }
            weak.is_on
        };
        assert!(show(2), "a map may have been made of weak texture");
        assert!(!show(60), "or of ordinary corners");
    }
}
