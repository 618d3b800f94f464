//! Configuration of a session. Every field has a default, a unit and a reason.

mod alignment;
mod calibration;
mod continuity;
mod initialization;
mod keyframes;
mod lines;
mod loops;
mod mapping;
mod primitives;
mod relocalization;
mod rolling_shutter;
mod submaps;
mod tracking;

pub use alignment::AlignmentConfig;
pub use calibration::{CalibrationConfig, CalibrationTrust};
pub use continuity::ContinuityConfig;
pub use initialization::InitializationConfig;
pub use keyframes::KeyframeConfig;
pub use lines::LineConfig;
pub use loops::LoopConfig;
pub use mapping::MappingConfig;
pub use primitives::PrimitiveConfig;
pub use relocalization::RelocalizationConfig;
pub use rolling_shutter::RollingShutterConfig;
pub use submaps::SubmapConfig;
pub use tracking::TrackingConfig;

use crate::features::PyramidGeometry;
use geometry::Camera;
use vision::OrbConfig;

/// How the stages of a session share the machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Threading {
    /// Every stage in turn on the caller's thread: same frames and seed, same bytes out.
    Inline,
    /// Mapping runs on a thread of its own beside tracking.
    #[default]
    Background,
}

/// What a session uses beside points: the ablation of Jiang et al..
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureSwitches {
    /// Line segments are tracked, mapped and optimized. Default on.
    pub lines: bool,
    /// Vanishing directions are shared by keyframes as global primitives; needs `lines`. Default on.
    pub global_primitives: bool,
    /// Places seen before are recognized: loops are closed and submaps merged. Default on.
    pub loop_closing: bool,
    /// Self-calibration: focal length and principal point are checked and refined as the map grows. Default
    /// on.
    pub refine_calibration: bool,
    /// What stays where it is in the image while the scene moves is found and left out: black borders,
    /// watermarks, a car's bonnet. Default on.
    pub find_mask: bool,
}

impl Default for FeatureSwitches {
    fn default() -> Self {
        Self {
            lines: true,
            global_primitives: true,
            loop_closing: true,
            refine_calibration: true,
            find_mask: true,
        }
    }
}

/// Configuration of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct SlamConfig {
    /// How the stages share the machine. Default background.
    pub threading: Threading,
    /// Seed of every random choice. Default 0.
    pub seed: u64,
    /// What the session uses. Default everything.
    pub features: FeatureSwitches,
    /// Images wider than this are scaled down to it, and the calibration with them, pixels. Default 1280: the
    /// front end's time grows with the area, and corners of larger images are no better located.
    pub working_width_px: u32,
    /// Images of fewer pixels than this are worked on at twice their width and height; 0 for none. Default
    /// 160 000, half of VGA: corners are looked for in cells, patches and levels that are meant for such a
    /// size. KITTI 00 at 416 x 128: 3.6 % of the path became 0.5.
    pub enlarge_below_px: u32,
    /// Whether images are worked on at twice their width and height although they are not small, because a
    /// border leaves fewer pixels of them than `enlarge_below_px`. Default not: a session decides it with its
    /// first image, and keeps it.
    pub enlarge_for_border: bool,
    /// The extractor of points.
    pub orb: OrbConfig,
    /// Initialization: the first map.
    pub initialization: InitializationConfig,
    /// Tracking.
    pub tracking: TrackingConfig,
    /// Relocalization.
    pub relocalization: RelocalizationConfig,
    /// When a frame is kept.
    pub keyframes: KeyframeConfig,
    /// Extending the map.
    pub mapping: MappingConfig,
    /// Line tracking and line mapping.
    pub lines: LineConfig,
    /// Global primitives: directions shared by keyframes.
    pub primitives: PrimitiveConfig,
    /// Direct (photometric) alignment, where features are lost.
    pub alignment: AlignmentConfig,
    /// Motion continuity: how far a lost camera can have moved.
    pub continuity: ContinuityConfig,
    /// Loop closing and map merging.
    pub loops: LoopConfig,
    /// Beginning submaps.
    pub submaps: SubmapConfig,
    /// Self-calibration.
    pub calibration: CalibrationConfig,
    /// Rolling shutter.
    pub rolling_shutter: RollingShutterConfig,
}

impl Default for SlamConfig {
    fn default() -> Self {
        Self {
            threading: Threading::default(),
            seed: 0,
            features: FeatureSwitches::default(),
            working_width_px: 1280,
            enlarge_below_px: 160_000,
            enlarge_for_border: false,
            orb: OrbConfig::default(),
            initialization: InitializationConfig::default(),
            tracking: TrackingConfig::default(),
            relocalization: RelocalizationConfig::default(),
            keyframes: KeyframeConfig::default(),
            mapping: MappingConfig::default(),
            lines: LineConfig::default(),
            primitives: PrimitiveConfig::default(),
            alignment: AlignmentConfig::default(),
            continuity: ContinuityConfig::default(),
            loops: LoopConfig::default(),
            submaps: SubmapConfig::default(),
            calibration: CalibrationConfig::default(),
            rolling_shutter: RollingShutterConfig::default(),
        }
    }
}

/// How many times as wide and as high small images are worked on.
const ENLARGEMENT: u32 = 2;

/// A field of the configuration that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct ConfigError {
    /// Which field, such as `orb.n_features`.
    pub field: &'static str,
    /// What is wrong with it, in a plain sentence.
    pub reason: String,
}

impl SlamConfig {
    /// Checks that every field can be used.
    ///
    /// # Errors
    /// The first field that cannot.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let refuse = |field, reason: &str| Err(ConfigError { field, reason: reason.to_owned() });
        self.orb.validate().map_err(|error| ConfigError { field: "orb", reason: error.to_string() })?;
        if !(100..=10_000).contains(&self.orb.n_features) {
            return refuse("orb.n_features", "must be between 100 and 10000");
        }
        if !(160..=8192).contains(&self.working_width_px) {
            return refuse("working_width_px", "must be between 160 and 8192");
        }
        if self.initialization.max_reference_views == 0 || self.initialization.max_attempts_per_frame == 0 {
            return refuse("initialization.max_reference_views", "must be at least 1");
        }
        if self.tracking.min_weak_inliers < 6 || self.tracking.min_weak_inliers > self.tracking.min_inliers {
            return refuse(
                "tracking.min_weak_inliers",
                "must be at least 6 and at most tracking.min_inliers",
            );
        }
        if self.keyframes.max_keyframes < 10 {
            return refuse("keyframes.max_keyframes", "must be at least 10");
        }
        if self.loops.min_first_inliers < 3 || self.loops.min_inliers < self.loops.min_first_inliers {
            return refuse(
                "loops.min_inliers",
                "must be at least loops.min_first_inliers, which must be at least 3",
            );
        }
        self.calibration.validate()?;
        self.rolling_shutter.validate()?;
        if !(self.loops.max_scale_change >= 1.0 && self.loops.max_drift_share >= 0.0) {
            return refuse(
                "loops.max_scale_change",
                "must be at least 1, and loops.max_drift_share not negative",
            );
        }
        if self.submaps.max_lost_ns < 0 || self.submaps.search_interval == 0 {
            return refuse(
                "submaps.max_lost_ns",
                "must not be negative, and submaps.search_interval at least 1",
            );
        }
        self.alignment.validate()
    }

    /// Whether the readout of the camera's shutter is looked for, until it is known.
    pub(crate) fn looks_for_readout(&self, is_known: bool) -> bool {
        self.rolling_shutter.readout_ns.is_none() && self.features.refine_calibration && !is_known
    }

    /// The camera the engine works with: the session's, scaled down where its images are wider than the
    /// working width, and up where they are small.
    pub fn working_camera(&self, camera: &Camera) -> Camera {
        let is_small = camera.width().saturating_mul(camera.height()) < self.enlarge_below_px;
        if (is_small || self.enlarge_for_border) && self.can_enlarge(camera) {
            return camera.scaled(f64::from(ENLARGEMENT), f64::from(ENLARGEMENT));
        }
        if camera.width() <= self.working_width_px {
            return camera.clone();
        }
        let factor = f64::from(self.working_width_px) / f64::from(camera.width());
        let height = (f64::from(camera.height()) * factor).round().max(1.0);
        camera.scaled(factor, height / f64::from(camera.height()))
    }

    /// The configuration for a camera that is added to a map of this one: images are worked on as they are
    /// where a border leaves little of them, and enlarged if they are small, whatever the map's own were.
    #[must_use]
    pub fn of_added_camera(&self) -> Self {
        let enlarge_below_px = Self::default().enlarge_below_px;
        Self { enlarge_for_border: false, enlarge_below_px, ..self.clone() }
    }

    fn can_enlarge(&self, camera: &Camera) -> bool {
        ENLARGEMENT.saturating_mul(camera.width()) <= self.working_width_px
    }

    /// Whether images of this camera are to be enlarged since no more of them is used than a box of so many
    /// pixels, which is small.
    pub(crate) fn is_enlarged_for(&self, camera: &Camera, n_used_px: u32) -> bool {
        n_used_px < self.enlarge_below_px && self.can_enlarge(camera)
    }

    /// The resolutions the extractor looks at.
    pub fn pyramid(&self) -> PyramidGeometry {
        PyramidGeometry { n_levels: self.orb.n_levels as u8, scale_factor: f64::from(self.orb.scale_factor) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{CameraModel, CameraParameters};

    fn camera(width: u32, height: u32) -> Camera {
        let (fx, fy, cx, cy) = (240.0, 241.0, 203.2, 62.7);
        let model = CameraModel::Pinhole;
        Camera::new(CameraParameters { model, width, height, fx, fy, cx, cy, distortion: Vec::new() })
            .unwrap()
    }

    #[test]
    fn small_images_are_worked_on_enlarged() {
        let config = SlamConfig::default();
        let size = |camera: &Camera| (camera.width(), camera.height());
        assert_eq!(size(&config.working_camera(&camera(416, 128))), (832, 256));
        assert_eq!(size(&config.working_camera(&camera(640, 480))), (640, 480));
        assert_eq!(size(&config.working_camera(&camera(2560, 1920))), (1280, 960));
        // A pixel's ray stays what it was.
        let (small, large) = (camera(416, 128), config.working_camera(&camera(416, 128)));
        let ray = |camera: &Camera, x, y| camera.pinhole().bearing(&geometry::nalgebra::Vector2::new(x, y));
        assert!((ray(&small, 10.0, 20.0) - ray(&large, 20.5, 40.5)).norm() < 1e-12);
        let bordered = SlamConfig { enlarge_for_border: true, ..config.clone() };
        assert_eq!(size(&bordered.working_camera(&camera(640, 480))), (1280, 960));
        assert_eq!(size(&bordered.working_camera(&camera(1280, 960))), (1280, 960));
        let before = SlamConfig { enlarge_below_px: 0, ..config };
        assert_eq!(size(&before.working_camera(&camera(416, 128))), (416, 128));
    }
}
