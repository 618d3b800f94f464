//! From radiance to gray levels: vignetting, gain, noise and rounding.

use geometry::Camera;
use rand::Rng;

use super::RenderOptions;
use crate::random::{mix, normal, stream};

/// Size of the table of normal numbers that noise is drawn from; a power of two.
const NOISE_TABLE: usize = 4096;

pub(crate) struct Sensor {
    /// Share of light that reaches each pixel, row-major.
    transmission: Vec<f32>,
    /// Normal numbers with the standard deviation of the noise; empty without noise.
    noise: Vec<f32>,
}

impl Sensor {
    pub fn new(camera: &Camera, options: &RenderOptions) -> Self {
        let (width, height) = (camera.width(), camera.height());
        let (middle_x, middle_y) = (0.5 * f64::from(width - 1), 0.5 * f64::from(height - 1));
        let corner = middle_x.hypot(middle_y).max(1.0);
        let transmission = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| {
                let radius = (f64::from(x) - middle_x).hypot(f64::from(y) - middle_y) / corner;
                (1.0 - options.vignetting * radius * radius) as f32
            })
            .collect();
        let mut rng = stream(0, "sensor noise");
        let n = if options.noise_sigma > 0.0 { NOISE_TABLE } else { 0 };
        let noise = (0..n).map(|_| (options.noise_sigma * normal(&mut rng)) as f32).collect();
        Self { transmission, noise }
    }

    /// Gray levels, with noise that depends on `seed`.
    pub fn expose(&self, radiance: &[f32], gain: f64, seed: u64) -> Vec<u8> {
        let gain = gain as f32;
        let lit = radiance.iter().zip(&self.transmission).map(|(value, share)| value * share * gain);
        if self.noise.is_empty() {
            return lit.map(quantize).collect();
        }
        let mut state = mix(seed, stream(seed, "frame noise").random());
        lit.map(|value| {
            // A linear congruential generator (constants of Knuth's MMIX); its high bits are good.
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            quantize(value + self.noise[(state >> 52) as usize & (NOISE_TABLE - 1)])
        })
        .collect()
    }
}

/// Rounded and clamped to 0..=255.
#[inline]
fn quantize(value: f32) -> u8 {
    (value + 0.5) as u8
}
