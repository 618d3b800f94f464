//! What of a picture is transparent, as those cut out of others are.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::{DecodeLimits, FileFormat};
use crate::GrayImage;

/// Opacity from which on a pixel counts as opaque.
const OPAQUE: u8 = 128;
/// Bytes a decoder may use besides the pixels.
const MAX_WORK_BYTES: u64 = 64 << 20;

/// The opacity of a file's pixels, 0 to 255, if some are transparent. `None` of files without such, and of
/// those that cannot be read.
pub fn decode_alpha(data: &[u8], limits: &DecodeLimits) -> Option<GrayImage> {
    let format = match FileFormat::of(data)? {
        FileFormat::Png => ImageFormat::Png,
        FileFormat::WebP => ImageFormat::WebP,
        FileFormat::Tiff => ImageFormat::Tiff,
        FileFormat::Bmp => ImageFormat::Bmp,
        FileFormat::Jpeg | FileFormat::Pnm => return None,
    };
    if data.len() > limits.max_bytes {
        return None;
    }
    let mut decoder = ImageReader::with_format(Cursor::new(data), format).into_decoder().ok()?;
    let (width, height) = decoder.dimensions();
    limits.check_size(width, height).ok()?;
    if !decoder.color_type().has_alpha() {
        return None;
    }
    let mut allowed = Limits::no_limits();
    allowed.max_alloc = Some(decoder.total_bytes().saturating_add(MAX_WORK_BYTES));
    decoder.set_limits(allowed).ok()?;
    let image = DynamicImage::from_decoder(decoder).ok()?.into_luma_alpha8();
    let alpha: Vec<u8> = image.pixels().map(|pixel| pixel.0[1]).collect();
    let is_transparent = alpha.iter().any(|opacity| *opacity < OPAQUE);
    is_transparent.then(|| GrayImage::from_raw(width, height, alpha).ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, Rgba};

    fn png(opacity: impl Fn(u32, u32) -> u8) -> Vec<u8> {
        let image = ImageBuffer::from_fn(200, 150, |x, y| Rgba([90, 120, 10, opacity(x, y)]));
        let mut file = Vec::new();
        DynamicImage::from(image).write_to(&mut Cursor::new(&mut file), ImageFormat::Png).unwrap();
        file
    }

    #[test]
    fn transparency_is_told_and_its_absence() {
        let limits = DecodeLimits::default();
        let cut = decode_alpha(&png(|x, _| if x < 50 { 0 } else { 255 }), &limits).unwrap();
        assert_eq!(
            (cut.width(), cut.height(), cut.get(49, 3), cut.get(50, 3)),
            (200, 150, Some(0), Some(255))
        );
        assert_eq!(decode_alpha(&png(|_, _| 255), &limits), None, "all opaque");
        assert_eq!(decode_alpha(&png(|_, _| 0)[..200], &limits), None, "cut off");
        assert_eq!(decode_alpha(b"P5 2 2 255 abcd", &limits), None);
        let small = DecodeLimits { max_pixels: 100, ..limits };
        assert_eq!(decode_alpha(&png(|_, _| 0), &small), None);
    }
}
