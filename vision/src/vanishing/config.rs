//! Configuration of vanishing-point estimation.

use thiserror::Error;

/// How vanishing points are looked for. The defaults suit endpoints known to 0.3 to 1 pixel at a focal length
/// of about 500 pixels, but nothing depends on either: noise comes with each segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VanishingConfig {
    /// Only this many segments are looked at, the longest; the rest is in no vanishing point. Linking takes
    /// time with the square of it. At least 2. Default 200.
    pub max_segments: usize,
    /// Directions tried, known ones included; 300 to 500 are enough, since all are refined. At least 1.
    /// Default 500.
    pub n_hypotheses: usize,
    /// A segment accepts a direction that its endpoints deviate from by no more than this, each to its side
    /// of the line from its middle to the vanishing point, in standard deviations of an endpoint (2 pixels
    /// for endpoints known to 1 pixel). Noise alone moves them by `1 / sqrt 2`, but the direction is
    /// uncertain as well.
    ///
    /// Default 2. Over 100 scenes of 3 x 40 segments and 30 others: 1.5 left 0.18 duplicates a scene and
    /// errors up to 2.6 degrees, 2 left 0.05 and 1.4 degrees; 2.3 does no better there, and misses a third of
    /// the directions of 15 segments under 60 pixels where 2 misses a fifth.
    pub max_deviation: f64,
    /// Vanishing points need this many segments. Chance must be excluded all the same, see
    /// `max_log10_false_alarms`. At least 3. Default 5.
    pub min_segments: usize,
    /// As `min_segments`, near a direction known beforehand. At least 3. Default 3.
    pub min_segments_known: usize,
    /// The expected number of vanishing points that would be found among as many segments without any order,
    /// if this one were taken: its logarithm to base 10 must be lower. Default -1: one of ten frames without
    /// order shows a vanishing point.
    pub max_log10_false_alarms: f64,
    /// Vanishing points nearer to one another are one, degrees. Default 2.
    pub merge_deg: f64,
    /// Directions with a greater standard deviation are not worth reporting, degrees. Default 3.
    pub max_sigma_deg: f64,
    /// How far a prediction may be off, degrees: segments within this much (and their noise) are tried with
    /// it, and what is further from all predictions came from none of them. Default 3.
    pub prediction_gate_deg: f64,
    /// Rounds of giving segments to the nearest direction and fitting anew. At least 1. Default 3.
    pub n_rounds: usize,
    /// Segments of this angular length should have a vanishing point, degrees; see
    /// [`VanishingPoints::explained`](super::VanishingPoints::explained). Default 6: some 50 pixels.
    pub long_segment_deg: f64,
}

impl Default for VanishingConfig {
    fn default() -> Self {
        Self {
            max_segments: 200,
            n_hypotheses: 500,
            max_deviation: 2.0,
            min_segments: 5,
            min_segments_known: 3,
            max_log10_false_alarms: -1.0,
            merge_deg: 2.0,
            max_sigma_deg: 3.0,
            prediction_gate_deg: 3.0,
            n_rounds: 3,
            long_segment_deg: 6.0,
        }
    }
}

/// What is wrong with a [`VanishingConfig`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum VanishingConfigError {
    /// A number of things is outside the range that makes sense.
    #[error("`{name}` is {value}, but must be {min} to {max}")]
    Count {
        /// The field.
        name: &'static str,
        /// Its value.
        value: usize,
        /// The least that makes sense.
        min: usize,
        /// The most.
        max: usize,
    },
    /// A quantity is outside the range that makes sense.
    #[error("`{name}` is {value}, but must be over {min} and at most {max}")]
    Quantity {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The bound below, itself excluded.
        min: f64,
        /// The bound above.
        max: f64,
    },
}

impl VanishingConfig {
    /// Whether it makes sense, and keeps time and memory within bounds.
    pub fn validate(&self) -> Result<(), VanishingConfigError> {
        for (name, value, min, max) in [
            ("max_segments", self.max_segments, 2, 1000),
            ("n_hypotheses", self.n_hypotheses, 1, 10_000),
            ("min_segments", self.min_segments, 3, 1000),
            ("min_segments_known", self.min_segments_known, 3, 1000),
            ("n_rounds", self.n_rounds, 1, 20),
        ] {
            if !(min..=max).contains(&value) {
                return Err(VanishingConfigError::Count { name, value, min, max });
            }
        }
        for (name, value, min, max) in [
            ("max_deviation", self.max_deviation, 0.0, 10.0),
            ("max_log10_false_alarms", self.max_log10_false_alarms, -300.0, 300.0),
            ("merge_deg", self.merge_deg, 0.0, 30.0),
            ("max_sigma_deg", self.max_sigma_deg, 0.0, 90.0),
            ("prediction_gate_deg", self.prediction_gate_deg, 0.0, 30.0),
            ("long_segment_deg", self.long_segment_deg, 0.0, 180.0),
        ] {
            if !(value > min && value <= max) {
                return Err(VanishingConfigError::Quantity { name, value, min, max });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_no_sense_is_named() {
        let good = VanishingConfig::default();
        assert_eq!(good.validate(), Ok(()));
        let without_hypotheses = VanishingConfig { n_hypotheses: 0, ..good };
        let error = without_hypotheses.validate().unwrap_err();
        assert_eq!(error.to_string(), "`n_hypotheses` is 0, but must be 1 to 10000");
        for max_deviation in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            assert!(VanishingConfig { max_deviation, ..good }.validate().is_err(), "{max_deviation}");
        }
    }
}
