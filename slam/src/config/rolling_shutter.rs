//! Rolling shutter.

use super::ConfigError;

/// Rolling shutter: the rows of an image are read one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RollingShutterConfig {
    /// Time from the first row to the last, nanoseconds. Default 0, a global shutter: how long a camera takes
    /// cannot be told from its size, and phones take 8 to 35 ms.
    pub readout_ns: i64,
}

/// Slower cameras are not video cameras.
const MAX_READOUT_NS: i64 = 200_000_000;

impl RollingShutterConfig {
    /// Of a readout in milliseconds; what is no such time is refused by
    /// [validation](super::SlamConfig::validate).
    pub fn of_ms(readout_ms: f64) -> Self {
        let readout_ns = if readout_ms.is_finite() { (readout_ms * 1e6).round() as i64 } else { i64::MIN };
        Self { readout_ns }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if (0..=MAX_READOUT_NS).contains(&self.readout_ns) {
            return Ok(());
        }
        let reason = format!("must be 0 to {} ms", MAX_READOUT_NS / 1_000_000);
        Err(ConfigError { field: "rolling_shutter.readout_ns", reason })
    }
}
