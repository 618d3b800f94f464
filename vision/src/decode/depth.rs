//! Samples of more than eight bits.
//!
//! Cameras of 10, 12 or 14 bits write their samples into 16 without scaling them, so that read as 16 bits
//! they are nearly black. The range is taken from what is there, and the same for all images of a session.

use super::convert::luma;

/// Bits that samples of 16 may use.
const WIDTHS: [u32; 5] = [8, 10, 12, 14, 16];

/// How many bits of 16 the samples of a camera use: as many as the greatest yet seen needs. It only grows, so
/// that after the first bright image all are scaled alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleDepth {
    bits: u32,
}

impl Default for SampleDepth {
    /// Nothing has been seen.
    fn default() -> Self {
        Self { bits: WIDTHS[0] }
    }
}

impl SampleDepth {
    /// The bits in use.
    pub fn bits(self) -> u32 {
        self.bits
    }

    /// Takes note of the samples of an image.
    pub(super) fn note(&mut self, samples: impl Iterator<Item = u16>) {
        let greatest = samples.fold(0, u16::max);
        let needed = u16::BITS - greatest.leading_zeros();
        let bits = WIDTHS.into_iter().find(|bits| *bits >= needed).unwrap_or(u16::BITS);
        self.bits = self.bits.max(bits);
    }

    /// A sample in eight bits, so that the greatest becomes 255; rounded.
    pub(super) fn narrow(self, sample: u16) -> u8 {
        let greatest = (1u32 << self.bits) - 1;
        ((u32::from(sample) * 255 + greatest / 2) / greatest).min(255) as u8
    }

    /// Gray of 16-bit samples, `channels` a pixel: gray, gray with alpha, color, color with alpha.
    pub(super) fn gray_of(&mut self, samples: &[u16], channels: usize, out: &mut [u8]) {
        let n_colors = if channels >= 3 { 3 } else { 1 };
        let pixels = || samples.chunks_exact(channels.max(1));
        self.note(pixels().flat_map(|pixel| pixel[..n_colors].iter().copied()));
        // A table of all samples is as much work as a small image, and spares a division for each.
        let table: Vec<u8> = (0..=u16::MAX).map(|sample| self.narrow(sample)).collect();
        let narrow = |sample: u16| table[usize::from(sample)];
        for (out, pixel) in out.iter_mut().zip(pixels()) {
            *out = match pixel {
                [r, g, b, ..] => luma(narrow(*r), narrow(*g), narrow(*b)),
                [gray, ..] => narrow(*gray),
                [] => 0,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_is_that_of_the_samples_and_only_grows() {
        let mut depth = SampleDepth::default();
        let mut gray = |samples: &[u16]| {
            let mut out = vec![0; samples.len()];
            depth.gray_of(samples, 1, &mut out);
            out
        };
        assert_eq!(gray(&[0, 255]), [0, 255]);
        assert_eq!(gray(&[0, 2048, 4095]), [0, 128, 255]);
        assert_eq!(gray(&[0, 255]), [0, 16], "a dark image of the same camera is dark");
        assert_eq!(gray(&[65535, 32768, 257]), [255, 128, 1]);
    }

    #[test]
    fn alpha_tells_nothing_of_the_range() {
        let mut depth = SampleDepth::default();
        let mut out = [0; 2];
        depth.gray_of(&[1023, 65535, 0, 65535], 2, &mut out);
        assert_eq!((depth.bits(), out), (10, [255, 0]));
        depth.gray_of(&[1023, 1023, 1023, 65535, 0, 0, 0, 65535], 4, &mut out);
        assert_eq!((depth.bits(), out), (10, [255, 0]));
    }

    #[test]
    fn sixteen_bits_become_eight_as_division_by_257_would() {
        let mut depth = SampleDepth::default();
        depth.note([u16::MAX].into_iter());
        for sample in 0..=u16::MAX {
            assert_eq!(u32::from(depth.narrow(sample)), (u32::from(sample) + 128) / 257);
        }
    }
}
