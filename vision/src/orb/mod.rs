//! ORB features: FAST corners over a scale pyramid, spread over the image, oriented by the intensity centroid
//! and described by steered BRIEF [Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV
//! 2011].

mod blur;
mod brief;
mod fast;
mod lanes;
mod orientation;
mod pattern;
mod quota;
mod refine;
mod spread;
#[cfg(test)]
mod tests;

use crate::mask::Clearance;
use crate::{GrayImage, Pyramid};
use fast::Corner;
use std::sync::Arc;

/// A described place in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Column, pixels of level 0; the center of the left-most pixel is 0.
    pub x: f32,
    /// Row, pixels of level 0; the center of the top-most pixel is 0.
    pub y: f32,
    /// Pyramid level it was found at, 0 the finest.
    pub octave: u8,
    /// Orientation, radians in [0, 2 pi), from x towards y (clockwise on the screen).
    pub angle: f32,
    /// Corner strength: the largest FAST threshold at which it is still a corner, gray levels.
    pub response: f32,
}

/// 256 binary tests on the surroundings of a keypoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Descriptor(
    /// Test `i` is bit `i % 64` of word `i / 64`.
    pub [u64; 4],
);

impl Descriptor {
    /// Bits.
    pub const N_BITS: u32 = 256;

    /// Hamming distance, 0 to 256 bits.
    #[inline]
    pub fn distance(&self, other: &Self) -> u32 {
        self.0.iter().zip(&other.0).map(|(a, b)| (a ^ b).count_ones()).sum()
    }

    /// Bit `index`; panics from 256 on.
    #[inline]
    pub fn bit(&self, index: u32) -> bool {
        self.0[(index / 64) as usize] >> (index % 64) & 1 == 1
    }

    /// The words in order, each little-endian.
    pub fn to_bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        for (chunk, word) in bytes.chunks_exact_mut(8).zip(self.0) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Inverse of [`Descriptor::to_bytes`].
    pub fn from_bytes(bytes: &[u8; 32]) -> Self {
        Self(std::array::from_fn(|word| {
            u64::from_le_bytes(std::array::from_fn(|byte| bytes[8 * word + byte]))
        }))
    }
}

/// Keypoints and their descriptors, at equal indices; ordered by octave.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Where.
    pub keypoints: Vec<Keypoint>,
    /// What it looks like there.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}

/// How features are extracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbConfig {
    /// Features wanted per image; fewer come out where there is not enough texture. Default 1000.
    pub n_features: usize,
    /// Pyramid levels, 1 to 16. Default 8: covers a change of scale of 3.6.
    pub n_levels: usize,
    /// Ratio of neighboring levels' sizes, above 1 and at most 2. Default 1.2.
    pub scale_factor: f32,
    /// A corner's circle must differ by more than this, gray levels. Default 20.
    pub fast_threshold: u8,
    /// Threshold for cells where `fast_threshold` finds nothing, gray levels, at least 1. Default 7.
    pub min_fast_threshold: u8,
    /// Side of those cells, pixels of their level, at least 8. Default 30.
    pub cell_size_px: u32,
    /// Keypoints keep this distance from the edges of their level, pixels; at least 16, so that the patch of
    /// orientation and descriptor (radius 15) lies inside. Default 16.
    pub edge_margin_px: u32,
    /// Find corners to a fraction of a pixel and drop those that are none: the steps of a slanted edge look
    /// like corners and slide along it as the camera moves. Default true: finding them better lowered the
    /// median trajectory error on EuRoC part b by about a tenth; dropping the others lowered it on POV
    /// office, all edges and plain walls, from 0.24 to 0.03 m with lines. Points alone do not last there
    /// without them.
    pub refine_corners: bool,
    /// Share of the features chosen for covering the image, each the strongest of its square; the rest are
    /// the strongest anywhere, which are the ones found again most often. 0 to 1. Default 0.5: on EuRoC
    /// V1_01, 5 frames apart, 492 correct matches in 101 squares of 32 px; at 0 it is 580 in 73, at 0.25 550
    /// in 84, at 1 365 in 132. Cover matters more than number for the pose: from 0.25 to 0.5 the trajectory
    /// error on EuRoC part b fell from 0.0043 to 0.0036 m.
    pub spread_share: f32,
}

impl Default for OrbConfig {
    fn default() -> Self {
        Self {
            n_features: 1000,
            n_levels: 8,
            scale_factor: 1.2,
            fast_threshold: 20,
            min_fast_threshold: 7,
            cell_size_px: 30,
            edge_margin_px: MIN_EDGE_MARGIN_PX,
            refine_corners: true,
            spread_share: 0.5,
        }
    }
}

/// Whether the patch of a corner found in a level, whose pixels are `scale` pixels of the image wide and
/// high, is clear of what is left out.
fn is_clear(clearance: &Clearance, corner: &Corner, scale: [f32; 2]) -> bool {
    let full = |at: u16, scale: f32| ((f32::from(at) + 0.5) * scale - 0.5).round().max(0.0) as u32;
    let distance = clearance.at(full(corner.x, scale[0]), full(corner.y, scale[1]));
    f32::from(distance) >= (MIN_EDGE_MARGIN_PX as f32 * scale[0].max(scale[1])).min(f32::from(u8::MAX))
}

/// Radius of the patch that orientation and descriptor look at, pixels of the keypoint's level.
pub(crate) const PATCH_RADIUS_PX: u32 = 15;
const MIN_EDGE_MARGIN_PX: u32 = PATCH_RADIUS_PX + 1;

/// Which field of an [`OrbConfig`] is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OrbConfigError {
    /// `n_levels` is not 1 to 16.
    #[error("n_levels must be between 1 and 16, not {0}")]
    Levels(usize),
    /// `scale_factor` is not above 1 and at most 2.
    #[error("scale_factor must be above 1 and at most 2, not {0}")]
    ScaleFactor(f32),
    /// `min_fast_threshold` is 0 or above `fast_threshold`.
    #[error(
        "min_fast_threshold must be between 1 and fast_threshold ({fast_threshold}), not {min_fast_threshold}"
    )]
    Thresholds {
        /// As configured.
        fast_threshold: u8,
        /// As configured.
        min_fast_threshold: u8,
    },
    /// `cell_size_px` is below 8.
    #[error("cell_size_px must be at least 8, not {0}")]
    CellSize(u32),
    /// `edge_margin_px` is below 16.
    #[error("edge_margin_px must be at least 16, not {0}")]
    EdgeMargin(u32),
    /// `spread_share` is not between 0 and 1.
    #[error("spread_share must be between 0 and 1, not {0}")]
    SpreadShare(f32),
}

impl OrbConfig {
    /// Checks every field's range.
    pub fn validate(&self) -> Result<(), OrbConfigError> {
        if !(1..=16).contains(&self.n_levels) {
            return Err(OrbConfigError::Levels(self.n_levels));
        }
        if !(self.scale_factor > 1.0 && self.scale_factor <= 2.0) {
            return Err(OrbConfigError::ScaleFactor(self.scale_factor));
        }
        if !(1..=self.fast_threshold).contains(&self.min_fast_threshold) {
            return Err(OrbConfigError::Thresholds {
                fast_threshold: self.fast_threshold,
                min_fast_threshold: self.min_fast_threshold,
            });
        }
        if self.cell_size_px < 8 {
            return Err(OrbConfigError::CellSize(self.cell_size_px));
        }
        if self.edge_margin_px < MIN_EDGE_MARGIN_PX {
            return Err(OrbConfigError::EdgeMargin(self.edge_margin_px));
        }
        if !(0.0..=1.0).contains(&self.spread_share) {
            return Err(OrbConfigError::SpreadShare(self.spread_share));
        }
        Ok(())
    }

    /// Standard deviation of a keypoint's position, pixels of level 0: `scale_factor^octave`, that is one
    /// pixel of the level it was found at.
    pub fn level_sigma_px(&self, octave: u8) -> f32 {
        self.scale_factor.powi(i32::from(octave))
    }
}

/// Extracts [`Features`]; keeps its buffers from image to image.
#[derive(Clone, Debug)]
pub struct OrbExtractor {
    config: OrbConfig,
    pyramid: Pyramid,
    detector: fast::Detector,
    /// Corners of each level.
    corners: Vec<Vec<Corner>>,
    kept: Vec<Corner>,
    blur: blur::Blur,
    /// Each level, blurred.
    blurred: Vec<GrayImage>,
    refiner: refine::Refiner,
    tests: brief::SteeredTests,
    /// How far pixels are from what is not to be used, if anything is not.
    clearance: Option<Arc<Clearance>>,
}

impl OrbExtractor {
    /// An extractor, if `config` is valid.
    pub fn new(config: OrbConfig) -> Result<Self, OrbConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            pyramid: Pyramid::new(config.n_levels, config.scale_factor),
            detector: fast::Detector::default(),
            corners: vec![Vec::new(); config.n_levels],
            kept: Vec::new(),
            blur: blur::Blur::default(),
            blurred: vec![GrayImage::default(); config.n_levels],
            refiner: refine::Refiner::new(),
            tests: brief::SteeredTests::new(),
            clearance: None,
        })
    }

    /// The configuration in force.
    pub fn config(&self) -> &OrbConfig {
        &self.config
    }

    /// Changes the number of features wanted, for example while a map is being initialized.
    pub fn set_n_features(&mut self, n_features: usize) {
        self.config.n_features = n_features;
    }

    /// Keeps the patches of keypoints clear of what a mask of the images leaves out, as of their edges. A
    /// mask for images of another size than those extracted is not heeded.
    pub fn set_clearance(&mut self, clearance: Option<Arc<Clearance>>) {
        self.clearance = clearance;
    }

    /// Standard deviation of a keypoint's position: see [`OrbConfig::level_sigma_px`].
    pub fn level_sigma_px(&self, octave: u8) -> f32 {
        self.config.level_sigma_px(octave)
    }

    /// The pyramid of the image extracted last.
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Finds and describes keypoints. An image without texture, or too small, gives few or none.
    pub fn extract(&mut self, image: &GrayImage) -> Features {
        let mut features = Features::default();
        if image.is_empty() {
            return features;
        }
        self.pyramid.build(image);
        let size = (image.width(), image.height());
        let clearance = self.clearance.as_deref().filter(|clearance| clearance.size() == size);
        let levels = self.pyramid.levels().iter().zip(&mut self.corners).zip(&mut self.blurred);
        for ((level_image, corners), blurred) in levels {
            corners.clear();
            self.detector.detect(level_image, &self.config, corners);
            if let Some(clearance) = clearance {
                let scale = [
                    image.width() as f32 / level_image.width() as f32,
                    image.height() as f32 / level_image.height() as f32,
                ];
                corners.retain(|corner| is_clear(clearance, corner, scale));
            }
            self.blur.apply(level_image, blurred);
            if self.config.refine_corners {
                corners.retain_mut(|corner| {
                    let shift = self.refiner.shift(blurred, u32::from(corner.x), u32::from(corner.y));
                    corner.shift = shift.unwrap_or_default();
                    shift.is_some()
                });
            }
        }
        features.keypoints.reserve(self.config.n_features);
        features.descriptors.reserve(self.config.n_features);
        let quotas = quota::per_level(&self.config, self.corners.iter().map(Vec::len));
        for (level, quota) in quotas.into_iter().enumerate() {
            let level_image = self.pyramid.level(level);
            let (width, height) = (level_image.width(), level_image.height());
            let share = self.config.spread_share;
            spread::spread(&mut self.corners[level], width, height, quota, share, &mut self.kept);
            if !self.kept.is_empty() {
                self.describe_level(level, &mut features);
            }
        }
        features
    }

    /// Appends the corners of `self.kept`, which are of `level`, to `features`.
    fn describe_level(&mut self, level: usize, features: &mut Features) {
        let (image, blurred) = (self.pyramid.level(level), &self.blurred[level]);
        // The levels' sizes are rounded, so that the scales along x and y differ a little.
        let full = self.pyramid.level(0);
        let scale_x = full.width() as f32 / image.width() as f32;
        let scale_y = full.height() as f32 / image.height() as f32;
        for corner in &self.kept {
            let (x, y) = (u32::from(corner.x), u32::from(corner.y));
            let angle = orientation::angle(image, x, y);
            let (shift_x, shift_y) = corner.shift;
            features.keypoints.push(Keypoint {
                // Pixel centers are at integers, the image's edge at -0.5; edges coincide in all levels.
                x: (x as f32 + shift_x + 0.5) * scale_x - 0.5,
                y: (y as f32 + shift_y + 0.5) * scale_y - 0.5,
                octave: level as u8,
                angle,
                response: f32::from(corner.score),
            });
            features.descriptors.push(self.tests.describe(blurred, x, y, angle));
        }
    }
}
