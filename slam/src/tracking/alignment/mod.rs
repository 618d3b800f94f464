//! Direct (photometric) alignment of two images by their gray levels alone: patches about known points and
//! along known lines of the first are found again in the second, all at once, as one rigid scene.
//! [method: Direct alignment]
//!
//! It says where to look for features when the camera moved otherwise than expected, and needs none that were
//! found.

mod level;
mod pyramid;
#[cfg(test)]
mod tests;

use crate::config::AlignmentConfig;
use geometry::nalgebra::{UnitQuaternion, Vector3};
use geometry::{Camera, CameraCorrection, Pose};
use level::{LevelPatches, Motion};
use pyramid::HalvedImages;
use std::sync::Arc;
use vision::GrayImage;

/// Patches that turns are tried with: each turn is a guess that all of them refine.
const N_SEARCH_PATCHES: usize = 60;

/// Aligns images of one camera.
#[derive(Clone, Debug)]
pub(super) struct Aligner {
    camera: Camera,
    config: AlignmentConfig,
}

impl Aligner {
    /// `camera` is that of the images as features are looked for in them.
    pub fn new(camera: Camera, config: AlignmentConfig) -> Self {
        Self { camera, config }
    }

    /// Takes over how the camera differs from its calibration.
    pub fn correct_camera(&mut self, correction: CameraCorrection) {
        if self.camera.correction() != correction {
            self.camera = self.camera.with_correction(correction);
        }
    }

    /// `second_from_first`, by what the first image shows at these positions in its camera's frame. `None` if
    /// too little of it is found again.
    pub fn align(
        &self,
        first: &Arc<GrayImage>,
        second: &Arc<GrayImage>,
        positions: &[Vector3<f64>],
        expected: &Pose,
    ) -> Option<Pose> {
        let config = &self.config;
        let halved = |image| HalvedImages::of(image, &self.camera, config.coarsest_level);
        let (first, second) = (halved(first), halved(second));
        let coarsest = first.coarsest();
        let finest = usize::from(config.finest_level).min(coarsest);

        let few = LevelPatches::prepare(first.level(coarsest), positions, N_SEARCH_PATCHES);
        let mut motion = self.find_turn(&few, second.level(coarsest), &Motion::new(*expected));
        let mut found_share = None;
        for level in (finest..=coarsest).rev() {
            let patches = LevelPatches::prepare(first.level(level), positions, config.max_patches);
            if patches.len() < config.min_patches {
                return None;
            }
            motion = patches.align(second.level(level), motion, config);
            found_share = patches.found_share(second.level(level), &motion, config);
        }
        (found_share? >= config.min_found_share).then_some(motion.second_from_first)
    }

    /// The best of the expected motion and of turns about it, in steps of about one pixel.
    fn find_turn(&self, patches: &LevelPatches, onto: (&GrayImage, &Camera), expected: &Motion) -> Motion {
        let step_rad = 1.0 / onto.1.pinhole().mean_focal_px();
        let n_steps = (self.config.max_turn_deg.to_radians() / step_rad).floor() as i32;
        let mut best = (f64::NEG_INFINITY, *expected);
        for (up, side) in (-n_steps..=n_steps).flat_map(|up| (-n_steps..=n_steps).map(move |side| (up, side)))
        {
            let turn = Vector3::new(f64::from(up), f64::from(side), 0.0) * step_rad;
            let turn =
                Pose { rotation: UnitQuaternion::from_scaled_axis(turn), translation: Vector3::zeros() };
            let motion = Motion::new(turn * expected.second_from_first);
            if let Some(likeness) = patches.correlate(onto, &motion).filter(|likeness| likeness.0 > best.0) {
                best = likeness;
            }
        }
        best.1
    }
}
