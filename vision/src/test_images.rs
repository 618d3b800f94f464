//! Images for this crate's tests, drawn from a seed.

use crate::GrayImage;

/// The 64-bit generator of Knuth's MMIX: plenty for drawing test images.
pub(crate) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        let mut random = Self(seed ^ 0x9E37_79B9_7F4A_7C15);
        random.bits();
        random
    }

    /// 32 random bits.
    pub fn bits(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 32) as u32
    }

    /// Uniform in `0..n`.
    pub fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.bits()) * u64::from(n)) >> 32) as u32
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / (1u32 << 24) as f32
    }
}

/// Every pixel uniform in `0..=amplitude`.
pub(crate) fn noise(width: u32, height: u32, amplitude: u8, seed: u64) -> GrayImage {
    let mut random = Random::new(seed);
    GrayImage::from_fn(width, height, |_, _| random.below(u32::from(amplitude) + 1) as u8)
}

/// Overlapping rectangles of random size and brightness: many corners, at several scales.
pub(crate) fn blobs(width: u32, height: u32, seed: u64) -> GrayImage {
    let mut random = Random::new(seed);
    let mut image = GrayImage::from_fn(width, height, |_, _| 128);
    for _ in 0..width * height / 250 {
        let (w, h) = (4 + random.below(24), 4 + random.below(24));
        let (left, top) = (random.below(width), random.below(height));
        let value = random.below(256) as u8;
        for y in top..(top + h).min(height) {
            let right = (left + w).min(width);
            image.row_mut(y)[left as usize..right as usize].fill(value);
        }
    }
    image
}
