//! Configuration of self-calibration: refinement of the intrinsics.

use super::ConfigError;

/// Self-calibration: whether and when the intrinsics (focal length and principal point) are estimated along
/// with the map.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// Standard deviation of the focal length as given, as a share of it. Default 0.01: what calibrations by
    /// hand, autofocus and warming up leave.
    pub focal_sigma: f64,
    /// Standard deviation of the principal point as given, either way, in focal lengths. Default 0.01, for
    /// the same reasons.
    pub center_sigma: f64,
    /// Keyframes from which on it is tried. Default 10.
    pub min_keyframes: usize,
    /// It is tried again when there are this many times as many keyframes. Default 1.5.
    pub growth: f64,
    /// Keyframes beyond which it is no longer tried. Default 60: the camera is known by then, and the time
    /// that adjusting all keyframes takes grows.
    pub max_keyframes: usize,
    /// Decrease of χ² from which on the camera is in doubt. Default 10: 170 looks at rendered cameras, which
    /// are exactly as given, brought 1 in the median and 10 to 21 in one of twenty; a camera off by 1 %, 15
    /// to 29.
    pub min_gain: f64,
    /// Decrease of χ² from which on one look is enough. Default 40: twice what any camera that was as given
    /// brought.
    pub certain_gain: f64,
    /// How much two looks in a row may disagree, as a share of the correction, for the camera to be taken
    /// over. Default 0.33: the rendered ones among them that were in doubt twice disagreed by 0.45 and more,
    /// the camera that was off by 0.15.
    pub max_disagreement: f64,
    /// Iterations of each adjustment. Default 10.
    pub max_iterations: usize,
}

impl CalibrationConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let refuse = |field, reason: &str| Err(ConfigError { field, reason: reason.to_owned() });
        if !(self.focal_sigma > 0.0 && self.center_sigma > 0.0) {
            return refuse("calibration.focal_sigma", "must be above 0, and calibration.centre_sigma too");
        }
        if self.min_keyframes < 3 {
            return refuse(
                "calibration.min_keyframes",
                "must be at least 3: two views say nothing of the camera",
            );
        }
        if !(self.growth.is_finite() && self.growth > 1.0) {
            return refuse("calibration.growth", "must be above 1");
        }
        Ok(())
    }
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            focal_sigma: 0.01,
            center_sigma: 0.01,
            min_keyframes: 10,
            growth: 1.5,
            max_keyframes: 60,
            min_gain: 10.0,
            certain_gain: 40.0,
            max_disagreement: 0.33,
            max_iterations: 10,
        }
    }
}
