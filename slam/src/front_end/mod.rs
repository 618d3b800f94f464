//! From an image to what the back end works on: keypoints and tracked line segments without lens distortion.

mod lines;

use crate::config::{ConfigError, SlamConfig};
use crate::features::FrameFeatures;
use geometry::Camera;
use geometry::nalgebra::UnitQuaternion;
use lines::LineFrontEnd;
use vision::lines::LineTrackingStatistics;
use vision::{GrayImage, OrbExtractor, scale};

/// Extracts features of one stream of images; follows lines from image to image.
pub(crate) struct FrontEnd {
    camera: Camera,
    config: SlamConfig,
    extractor: OrbExtractor,
    /// Absent where lines are switched off.
    lines: Option<LineFrontEnd>,
}

impl FrontEnd {
    /// `first_track` is the lowest number that a track of lines may get.
    pub fn new(config: &SlamConfig, camera: &Camera, first_track: u64) -> Result<Self, ConfigError> {
        let extractor = OrbExtractor::new(config.orb)
            .map_err(|error| ConfigError { field: "orb", reason: error.to_string() })?;
        let camera = config.working_camera(camera);
        let lines =
            config.features.lines.then(|| LineFrontEnd::new(config, &camera, first_track)).transpose()?;
        Ok(Self { camera, config: config.clone(), extractor, lines })
    }

    /// Asks for so many keypoints per image from now on.
    pub fn set_n_features(&mut self, n_features: usize) {
        self.extractor.set_n_features(n_features);
    }

    /// The image at the size the features are looked for in.
    pub fn working_image(&self, image: GrayImage) -> GrayImage {
        let (width, height) = (self.camera.width(), self.camera.height());
        if (image.width(), image.height()) == (width, height) {
            return image;
        }
        scale::resize_area(&image, width, height)
    }

    /// The keypoints of an image of the working size.
    pub fn extract_points(&mut self, image: &GrayImage) -> FrameFeatures {
        FrameFeatures::from_extracted(self.extractor.extract(image), &self.camera, self.config.pyramid())
    }

    /// Adds the lines of the same image. `now_from_last` is the rotation since the last image, as far as it is known.
    pub fn extract_lines(
        &mut self,
        image: &GrayImage,
        features: FrameFeatures,
        now_from_last: Option<UnitQuaternion<f64>>,
    ) -> (FrameFeatures, LineTrackingStatistics) {
        let Some(lines) = &mut self.lines else { return (features, LineTrackingStatistics::default()) };
        let (lines, statistics) = lines.extract(image, now_from_last);
        (features.with_lines(lines), statistics)
    }
}
