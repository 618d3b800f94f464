//! Configuration of line tracking.

use crate::lines::{EdgeSupportConfig, LineFlowConfig, LineMatchConfig, LineMergeConfig};

/// How lines are tracked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineTrackerConfig {
    /// Shorter segments are dropped, detected or tracked, pixels (`tau_s` of Jiang et al.). Default 20.
    pub min_length_px: f32,
    /// A new line must be at least this long, pixels. Default 30: short ones come and go.
    pub min_new_length_px: f32,
    /// Most lines tracked. Default 200.
    pub max_lines: usize,
    /// Most detections looked at, the longest. Default 400.
    pub max_detections: usize,
    /// Most frames in a row a line is kept by flow alone. Default 3.
    pub max_flow_only_frames: u32,
    /// By how much flow alone is less exact across a line than a detection. Default 1.5.
    pub flow_sigma_factor: f32,
    /// Largest Hamming distance of a line kept by flow alone from what it looked like, bits of 256. Default
    /// 60: unrelated edges lie at 83 on average, the same edge below 20.
    pub max_flow_distance: u32,
    /// A detection shorter than the predicted line by more than this share is merged with it. Default 0.1.
    pub merge_if_longer_by: f32,
    /// How segments are followed.
    pub flow: LineFlowConfig,
    /// What makes a predicted and a detected segment one.
    pub predicted_match: LineMatchConfig,
    /// What makes a detected segment that of a line flow lost.
    pub unpredicted_match: LineMatchConfig,
    /// What makes segments pieces of one line.
    pub merging: LineMergeConfig,
    /// What the image must show where flow puts a line.
    pub support: EdgeSupportConfig,
}

impl Default for LineTrackerConfig {
    fn default() -> Self {
        Self {
            min_length_px: 20.0,
            min_new_length_px: 30.0,
            max_lines: 200,
            max_detections: 400,
            max_flow_only_frames: 3,
            flow_sigma_factor: 1.5,
            max_flow_distance: 60,
            merge_if_longer_by: 0.1,
            flow: LineFlowConfig::default(),
            predicted_match: LineMatchConfig::PREDICTED,
            unpredicted_match: LineMatchConfig::NEIGHBORING,
            merging: LineMergeConfig::default(),
            support: EdgeSupportConfig::default(),
        }
    }
}

/// Why a [`LineTrackerConfig`] is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LineTrackerConfigError {
    /// `min_length_px` is not at least 8.
    #[error("min_length_px must be at least 8, not {0}")]
    MinLength(f32),
    /// `min_new_length_px` is below `min_length_px`.
    #[error("min_new_length_px must be at least min_length_px, not {0}")]
    MinNewLength(f32),
    /// `max_lines` or `max_detections` is not 1 to 2000.
    #[error("max_lines and max_detections must be between 1 and 2000, not {0}")]
    Limit(usize),
    /// `flow_sigma_factor` is not at least 1.
    #[error("flow_sigma_factor must be at least 1, not {0}")]
    FlowSigmaFactor(f32),
    /// `flow` asks for fewer than 2 samples, or for more at least than at most.
    #[error("flow needs 2 <= min_samples <= max_samples, not {min_samples} and {max_samples}")]
    Samples {
        /// As configured.
        min_samples: usize,
        /// As configured.
        max_samples: usize,
    },
    /// A number that must be above 0 is not.
    #[error("{name} must be above 0, not {value}")]
    NotPositive {
        /// Which.
        name: &'static str,
        /// As configured.
        value: f32,
    },
}

/// Most lines and detections anybody may ask for: time grows with their product.
const MAX_LIMIT: usize = 2000;
/// Shorter segments have no direction to speak of, pixels.
const MIN_MIN_LENGTH_PX: f32 = 8.0;

impl LineTrackerConfig {
    /// Whether lines can be tracked like this.
    pub fn validate(&self) -> Result<(), LineTrackerConfigError> {
        use LineTrackerConfigError as Error;
        if !(MIN_MIN_LENGTH_PX..).contains(&self.min_length_px) {
            return Err(Error::MinLength(self.min_length_px));
        }
        if !(self.min_length_px..).contains(&self.min_new_length_px) {
            return Err(Error::MinNewLength(self.min_new_length_px));
        }
        for limit in [self.max_lines, self.max_detections] {
            if !(1..=MAX_LIMIT).contains(&limit) {
                return Err(Error::Limit(limit));
            }
        }
        if !(self.flow_sigma_factor >= 1.0 && self.flow_sigma_factor.is_finite()) {
            return Err(Error::FlowSigmaFactor(self.flow_sigma_factor));
        }
        let LineFlowConfig { min_samples, max_samples, sample_spacing_px, inlier_px, .. } = self.flow;
        if !(2..=max_samples).contains(&min_samples) {
            return Err(Error::Samples { min_samples, max_samples });
        }
        let positive = [
            ("sample_spacing_px", sample_spacing_px),
            ("inlier_px", inlier_px),
            ("max_fit_px", self.flow.max_fit_px),
            ("min_gradient", self.support.min_gradient),
            ("max_hole_px", self.support.max_hole_px),
        ];
        match positive.into_iter().find(|(_, value)| value.is_nan() || *value <= 0.0) {
            Some((name, value)) => Err(Error::NotPositive { name, value }),
            None => Ok(()),
        }
    }
}
