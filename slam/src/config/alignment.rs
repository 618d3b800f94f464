//! Configuration of direct (photometric) alignment.

use super::ConfigError;

/// Direct (photometric) alignment of a frame with the last one, where features are lost to speed or blur.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignmentConfig {
    /// Half resolutions of the image, of which the coarsest is used first. Default 4: 40 x 30 pixels of 640
    /// x 480.
    pub coarsest_level: u8,
    /// The last one used. Default 1: features take it from there.
    pub finest_level: u8,
    /// Turns of the camera that are tried on the coarsest level, to either side and up and down, degrees.
    /// Default 20: what a hand does in a third of a second.
    pub max_turn_deg: f64,
    /// Patches compared at most. Default 200: more add time and little else.
    pub max_patches: usize,
    /// Patches that must be visible in both images. Default 15.
    pub min_patches: usize,
    /// Gray levels beyond which a pixel's residual counts less. Default 9.
    pub huber_gray_levels: f64,
    /// Mean difference up to which a patch is found again, gray levels. Default 15.
    pub max_patch_difference: f64,
    /// Share of the patches that must be found again. Default 0.5.
    pub min_found_share: f64,
    /// Steps of the optimizer on each level. Default 15.
    pub max_iterations: usize,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            coarsest_level: 4,
            finest_level: 1,
            max_turn_deg: 20.0,
            max_patches: 200,
            min_patches: 15,
            huber_gray_levels: 9.0,
            max_patch_difference: 15.0,
            min_found_share: 0.5,
            max_iterations: 15,
        }
    }
}

impl AlignmentConfig {
    /// # Errors
    /// Names the field that cannot be used.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let error = |field, reason: &str| Err(ConfigError { field, reason: reason.to_owned() });
        if self.coarsest_level > 8 || self.finest_level > self.coarsest_level {
            return error(
                "alignment.finest_level",
                "levels run from coarsest_level, at most 8, down to finest_level",
            );
        }
        if !(0.0..=60.0).contains(&self.max_turn_deg) {
            return error("alignment.max_turn_deg", "must be between 0 and 60");
        }
        if !(0.1..=255.0).contains(&self.huber_gray_levels) {
            return error("alignment.huber_grey_levels", "must be between 0.1 and 255");
        }
        Ok(())
    }
}
