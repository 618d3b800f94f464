//! What the camera does to the image.

use std::f64::consts::TAU;

/// How sensitivity changes over time.
#[derive(Clone, Debug, PartialEq)]
pub enum ExposureCurve {
    /// Always this gain; 1 shows full white as 255.
    Constant(f64),
    /// Swings about 1, as an automatic exposure does between bright and dark places.
    Swing {
        /// Greatest deviation from 1.
        amplitude: f64,
        /// Duration of one swing, in seconds.
        period_s: f64,
    },
    /// `(seconds, gain)` in order of time; linear in between, constant outside.
    Table(Vec<(f64, f64)>),
}

impl ExposureCurve {
    /// The gain at `t_s` seconds.
    pub fn gain(&self, t_s: f64) -> f64 {
        match self {
            Self::Constant(gain) => *gain,
            Self::Swing { amplitude, period_s } => 1.0 + amplitude * (TAU * t_s / period_s).sin(),
            Self::Table(knots) => {
                let next = knots.partition_point(|(time, _)| *time <= t_s);
                match (next.checked_sub(1).map(|i| knots[i]), knots.get(next)) {
                    (Some((t0, g0)), Some((t1, g1))) => g0 + (g1 - g0) * (t_s - t0) / (t1 - t0),
                    (Some((_, gain)), None) | (None, Some(&(_, gain))) => gain,
                    (None, None) => 1.0,
                }
            }
        }
    }
}

/// Sensor and quality.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOptions {
    /// Standard deviation of the noise of each pixel, in gray levels. Default 2, as of an indoor webcam.
    pub noise_sigma: f64,
    /// Gain over time. Default constant 1.
    pub exposure: ExposureCurve,
    /// Time for which the shutter is open, in seconds; with one sample there is no blur.
    pub shutter_s: f64,
    /// Images averaged over the shutter time. Default 1: no motion blur.
    pub blur_samples: usize,
    /// Time from the first row's exposure to the last row's, in seconds: a rolling shutter, as phones and
    /// webcams have, reads its rows one after the other. Default 0: a global shutter.
    pub readout_s: f64,
    /// Share of light lost in the farthest corner of the image. Default 0.1.
    pub vignetting: f64,
    /// Side of a texel, in map units. Default 0.004: a pixel's footprint at 2 units distance.
    pub texel: f64,
    /// Threads that share a frame. The image does not depend on it. Default 1.
    pub threads: usize,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            noise_sigma: 2.0,
            exposure: ExposureCurve::Constant(1.0),
            shutter_s: 0.01,
            blur_samples: 1,
            readout_s: 0.0,
            vignetting: 0.1,
            texel: 0.004,
            threads: 1,
        }
    }
}

impl RenderOptions {
    /// No noise, no vignetting, no blur: for tests against the truth.
    pub fn ideal() -> Self {
        Self { noise_sigma: 0.0, vignetting: 0.0, ..Self::default() }
    }
}
