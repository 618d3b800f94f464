//! Pixels of other kinds to 8-bit gray.

use super::PixelFormat;

/// Converts a row of raw pixels of one byte a channel; `row` holds `out.len()` of them.
pub(super) fn raw_row_to_gray(row: &[u8], format: PixelFormat, out: &mut [u8]) {
    match format {
        PixelFormat::Gray8 => out.copy_from_slice(row),
        // Samples of 16 bits are scaled by all of them, and not by their row.
        PixelFormat::Gray16 => convert::<2>(row, out, |&[_, high]| high),
        PixelFormat::Rgb8 => convert::<3>(row, out, |&[r, g, b]| luma(r, g, b)),
        PixelFormat::Bgr8 => convert::<3>(row, out, |&[b, g, r]| luma(r, g, b)),
        PixelFormat::Rgba8 => convert::<4>(row, out, |&[r, g, b, _]| luma(r, g, b)),
        PixelFormat::Bgra8 => convert::<4>(row, out, |&[b, g, r, _]| luma(r, g, b)),
    }
}

/// Converts pixels of `N` bytes each.
pub(super) fn convert<const N: usize>(row: &[u8], out: &mut [u8], to_gray: impl Fn(&[u8; N]) -> u8) {
    for (out, pixel) in out.iter_mut().zip(row.as_chunks::<N>().0) {
        *out = to_gray(pixel);
    }
}

/// Luma of ITU-R BT.601, 0.299 R + 0.587 G + 0.114 B, rounded, in parts of 2^16.
pub(super) fn luma(r: u8, g: u8, b: u8) -> u8 {
    ((u32::from(r) * 19595 + u32::from(g) * 38470 + u32::from(b) * 7471 + (1 << 15)) >> 16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gray_colors_keep_their_level() {
        for v in 0..=255 {
            assert_eq!(luma(v, v, v), v);
        }
    }

    #[test]
    fn channels_are_taken_in_the_order_of_the_format() {
        let mut out = [0];
        let mut gray = |format, pixel: &[u8]| {
            raw_row_to_gray(pixel, format, &mut out);
            out[0]
        };
        let red = 76; // 0.299 * 255
        assert_eq!(gray(PixelFormat::Rgb8, &[255, 0, 0]), red);
        assert_eq!(gray(PixelFormat::Bgr8, &[0, 0, 255]), red);
        assert_eq!(gray(PixelFormat::Rgba8, &[255, 0, 0, 9]), red);
        assert_eq!(gray(PixelFormat::Bgra8, &[0, 0, 255, 9]), red);
    }
}
