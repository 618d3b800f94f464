//! Steered BRIEF descriptors [Calonder et al., "BRIEF", ECCV 2010; Rublee et al., ICCV 2011].

use super::{Descriptor, PATCH_RADIUS_PX};
use crate::GrayImage;

/// The 256 tests.
#[derive(Clone, Debug)]
pub(super) struct Pattern {
    tests: Vec<[(f32, f32); 2]>,
}

impl Pattern {
    pub fn new() -> Self {
        let mut state = 0x5EED_0F0Bu64;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let radius = PATCH_RADIUS_PX as f32 - 1.0;
        let mut point = || loop {
            // The sum of 12 uniforms less 6 is close to a unit Gaussian.
            let mut gauss = || ((0..12).map(|_| uniform()).sum::<f32>() - 6.0) * 31.0 / 5.0;
            let (x, y) = (gauss(), gauss());
            if x * x + y * y < radius * radius {
                return (x, y);
            }
        };
        Self { tests: (0..256).map(|_| [point(), point()]).collect() }
    }

    pub fn describe(&self, blurred: &GrayImage, x: u32, y: u32, angle: f32) -> Descriptor {
        let (sin, cos) = angle.sin_cos();
        let value = |(px, py): (f32, f32)| {
            let dx = (cos * px - sin * py).round() as i32;
            let dy = (sin * px + cos * py).round() as i32;
            blurred.row((y as i32 + dy) as u32)[(x as i32 + dx) as usize]
        };
        let mut words = [0; 4];
        for (i, &[a, b]) in self.tests.iter().enumerate() {
            words[i / 64] |= u64::from(value(a) < value(b)) << (i % 64);
        }
        Descriptor(words)
    }
}

/// Gaussian blur, 7x7, sigma 2.
pub(super) fn blur(image: &GrayImage, out: &mut GrayImage) {
    const WEIGHTS: [u32; 7] = [18, 34, 49, 54, 49, 34, 18];
    let (width, height) = (image.width() as i32, image.height() as i32);
    out.reshape(image.width(), image.height());
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0;
            for (dy, wy) in (-3..=3).zip(WEIGHTS) {
                let row = image.row((y + dy).clamp(0, height - 1) as u32);
                for (dx, wx) in (-3..=3).zip(WEIGHTS) {
                    sum += wy * wx * u32::from(row[(x + dx).clamp(0, width - 1) as usize]);
                }
            }
            out.row_mut(y as u32)[x as usize] = ((sum + (1 << 15)) >> 16) as u8;
        }
    }
}
