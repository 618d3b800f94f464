//! Front end (feature extraction): from an image to keypoints and tracked line segments without lens
//! distortion.

mod line_stage;
mod lines;
mod scene_mask;
mod weak_texture;

use crate::clock::Stopwatch;
use crate::config::{ConfigError, SlamConfig, Threading};
use crate::features::FrameFeatures;
use crate::input::SceneMask;
use geometry::nalgebra::{UnitQuaternion, Vector2};
use geometry::{Camera, CameraCorrection};
use line_stage::LineStage;
use lines::LineFrontEnd;
use scene_mask::MaskStage;
use std::sync::Arc;
use vision::lines::LineTrackingStatistics;
use vision::mask::{Clearance, Mask};
use vision::scale::BilinearResizer;
use vision::{GrayImage, OrbExtractor, scale};
use weak_texture::WeakTexture;

pub(crate) use weak_texture::CameraState;

/// Extracts features of one stream of images; follows lines from image to image.
pub(crate) struct FrontEnd {
    /// As it was given: features are handed out as the calibration alone has them.
    camera: Camera,
    config: SlamConfig,
    extractor: OrbExtractor,
    weak_texture: WeakTexture,
    /// Absent where lines are switched off.
    lines: Option<LineStage>,
    mask: MaskStage,
}

impl FrontEnd {
    /// `first_track` is the lowest number that a track of lines may get, `mask` what was known not to be the
    /// scene.
    pub fn new(
        config: &SlamConfig,
        camera: &Camera,
        first_track: u64,
        mask: Option<SceneMask>,
    ) -> Result<Self, ConfigError> {
        let extractor = OrbExtractor::new(config.orb)
            .map_err(|error| ConfigError { field: "orb", reason: error.to_string() })?;
        let camera = config.working_camera(camera).with_correction(CameraCorrection::default());
        let lines = config.features.lines.then(|| line_stage(config, &camera, first_track)).transpose()?;
        let weak_texture = WeakTexture::new(config);
        let mask = MaskStage::new(mask, config.features.find_mask);
        let mut front_end = Self { camera, config: config.clone(), extractor, weak_texture, lines, mask };
        front_end.use_mask();
        Ok(front_end)
    }

    /// Takes over how the camera differs from its calibration.
    pub fn correct_camera(&mut self, correction: CameraCorrection) {
        if let Some(lines) = &mut self.lines {
            lines.set_camera(&self.camera.with_correction(correction));
        }
    }

    /// Looks at an image for what is not the scene, and leaves it out from now on. Returns whether that has
    /// changed.
    pub fn look_for_mask(&mut self, image: &GrayImage) -> bool {
        let has_changed = self.mask.look(image);
        if has_changed {
            self.use_mask();
        }
        has_changed
    }

    /// What is left out of the images at present.
    pub fn mask(&self) -> Option<&SceneMask> {
        self.mask.mask()
    }

    fn use_mask(&mut self) {
        let (width, height) = (self.camera.width(), self.camera.height());
        let mask = self.mask.mask().map(|known| known.mask.resized(width, height));
        // Behind a rim nothing is looked for, and the rest is all there is: how wide an image is decides how
        // far matches are looked for, and how far a camera has moved.
        let used = mask
            .as_ref()
            .and_then(Mask::used_box)
            .map(|[low, high]| [low, high].map(|(x, y)| Vector2::new(x, y).cast::<f64>().add_scalar(-0.5)));
        self.camera = self.camera.with_used_box(used);
        let clearance = mask.map(|mask| Arc::new(Clearance::of(&mask)));
        self.extractor.set_clearance(clearance.clone());
        if let Some(lines) = &mut self.lines {
            lines.set_clearance(clearance);
        }
    }

    /// Asks for so many keypoints per image from now on.
    pub fn set_n_features(&mut self, n_features: usize) {
        self.extractor.set_n_features(n_features);
    }

    /// What the camera is doing when the next image comes: where it has no pose, texture too weak for
    /// ordinary corners is amplified.
    pub fn set_camera_state(&mut self, camera: CameraState) {
        self.weak_texture.set_camera_state(camera);
    }

    /// The image at the size the features are looked for in.
    pub fn working_image(&self, image: GrayImage) -> GrayImage {
        let (width, height) = (self.camera.width(), self.camera.height());
        if (image.width(), image.height()) == (width, height) {
            return image;
        }
        if width < image.width() {
            return scale::resize_area(&image, width, height);
        }
        let mut enlarged = GrayImage::default();
        BilinearResizer::default().resize(&image, width, height, &mut enlarged);
        enlarged
    }

    /// Keypoints and lines of an image of the working size, looked for beside each other unless all is to be
    /// inline. `now_from_last` is the rotation since the last image, as far as it is known.
    pub fn extract(
        &mut self,
        image: &Arc<GrayImage>,
        now_from_last: Option<UnitQuaternion<f64>>,
        stopwatch: &mut Stopwatch,
    ) -> (FrameFeatures, LineTrackingStatistics) {
        let Self { camera, config, extractor, weak_texture, lines, mask: _ } = self;
        let pyramid = config.pyramid();
        let extract_points =
            || FrameFeatures::from_extracted(weak_texture.extract(extractor, image), camera, pyramid);
        let Some(lines) = lines else {
            return (stopwatch.time("points", extract_points), LineTrackingStatistics::default());
        };
        let (features, (lines, statistics)) =
            lines.extract_beside(image, now_from_last, stopwatch, ("points", extract_points));
        (features.with_lines(lines), statistics)
    }
}

fn line_stage(config: &SlamConfig, camera: &Camera, first_track: u64) -> Result<LineStage, ConfigError> {
    let lines = LineFrontEnd::new(config, camera, first_track)?;
    match config.threading {
        Threading::Inline => Ok(LineStage::inline(lines)),
        Threading::Background => LineStage::background(lines).map_err(|error| ConfigError {
            field: "threading",
            reason: format!("the thread that looks for lines cannot be started: {error}"),
        }),
    }
}
