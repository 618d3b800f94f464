//! Rolling shutter.

use super::ConfigError;

/// Rolling shutter: the rows of an image are read one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct RollingShutterConfig {
    /// Time from the first row to the last, nanoseconds; 0 for a global shutter. Default not known: it cannot
    /// be told from a camera's size, phones take 8 to 35 ms, and is found where the motion shows it.
    pub readout_ns: Option<i64>,
    /// A readout that is not known is seen if it is this many of its standard deviations. Default 3.
    pub min_sigmas: f64,
    /// One look is enough if it is this many, and keyframes left out of the fit speak for it; otherwise two
    /// looks must agree. Default 4.
    pub certain_sigmas: f64,
    /// And at least this, nanoseconds. Default 3 ms: what less does to an image is lost in its noise.
    pub min_readout_ns: i64,
    /// And at most this, nanoseconds. Default 50 ms: phones take up to 35.
    pub max_found_ns: i64,
    /// Decrease of χ² in keyframes left out of the fit from which on they speak for it too. Default 2, as for
    /// the intrinsics.
    pub min_held_out_gain: f64,
    /// How much what it changes by without them may differ from what it does with them, as a share of it.
    /// Default 0.5.
    pub max_held_out_difference: f64,
    /// Looks agree that found the same to this share of it. Default 0.33, as for the intrinsics. That counts
    /// where keyframes left out of the fit do not speak for a readout: points that were fitted with a wrong
    /// one are bent so that they agree with it also in further views.
    pub max_disagreement: f64,
    /// Frames are kept until there are this many keyframes, to be placed anew if a readout is found. Default
    /// 25: the third look at the camera is at 23.
    pub keep_until_keyframes: usize,
    /// One that was taken over is changed by this many standard deviations or more, if keyframes left out of
    /// the fit do not speak against it. Default 0.5: the newer is the better one, as frames were placed
    /// without regard to the shutter before.
    pub min_move_sigmas: f64,
}

/// Slower cameras are not video cameras.
const MAX_READOUT_NS: i64 = 200_000_000;

impl Default for RollingShutterConfig {
    fn default() -> Self {
        Self {
            readout_ns: None,
            min_sigmas: 3.0,
            certain_sigmas: 4.0,
            min_readout_ns: 3_000_000,
            max_found_ns: 50_000_000,
            min_held_out_gain: 2.0,
            max_held_out_difference: 0.5,
            max_disagreement: 0.33,
            keep_until_keyframes: 25,
            min_move_sigmas: 0.5,
        }
    }
}

impl RollingShutterConfig {
    /// Of a readout in milliseconds; what is no such time is refused by
    /// [validation](super::SlamConfig::validate).
    pub fn of_ms(readout_ms: f64) -> Self {
        let readout_ns = if readout_ms.is_finite() { (readout_ms * 1e6).round() as i64 } else { i64::MIN };
        Self { readout_ns: Some(readout_ns), ..Self::default() }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if (0..=MAX_READOUT_NS).contains(&self.readout_ns.unwrap_or(0)) {
            return Ok(());
        }
        let reason = format!("must be 0 to {} ms", MAX_READOUT_NS / 1_000_000);
        Err(ConfigError { field: "rolling_shutter.readout_ns", reason })
    }
}
