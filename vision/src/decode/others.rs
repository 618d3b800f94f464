//! BMP, WebP, TIFF and PNM files, by the crate `image`. Its decoders read the size first.

use std::io::Cursor;

use image::codecs::bmp::BmpDecoder;
use image::codecs::pnm::PnmDecoder;
use image::codecs::tiff::TiffDecoder;
use image::codecs::webp::WebPDecoder;
use image::error::ImageError;
use image::{DynamicImage, ImageDecoder, Limits};

use super::convert::{convert, luma};
use super::depth::SampleDepth;
use super::{DecodeError, DecodeLimits, FileFormat};
use crate::GrayImage;

/// Bytes a decoder may use besides the pixels: a strip or tile, tables.
const MAX_WORK_BYTES: u64 = 64 << 20;

/// Bytes of a pixel at most: four channels of 16 bits. What needs more is refused.
const MAX_PIXEL_BYTES: u64 = 8;

pub(super) fn decode(
    format: FileFormat,
    data: &[u8],
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    let describe = |error: ImageError| describe(format, &error);
    let file = Cursor::new(data);
    match format {
        FileFormat::Bmp => unpack(format, BmpDecoder::new(file).map_err(describe)?, limits, depth),
        FileFormat::WebP => unpack(format, WebPDecoder::new(file).map_err(describe)?, limits, depth),
        FileFormat::Tiff => unpack(format, TiffDecoder::new(file).map_err(describe)?, limits, depth),
        FileFormat::Pnm => unpack(format, PnmDecoder::new(file).map_err(describe)?, limits, depth),
        FileFormat::Png | FileFormat::Jpeg => Err(DecodeError::WrongFormat { format: format.name() }),
    }
}

fn unpack(
    format: FileFormat,
    mut decoder: impl ImageDecoder,
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    let describe = |error: ImageError| describe(format, &error);
    let (width, height) = decoder.dimensions();
    limits.check_size(width, height)?;
    let n_pixels = u64::from(width) * u64::from(height);
    if decoder.total_bytes() > MAX_PIXEL_BYTES * n_pixels {
        let reason = format!("pixels of {:?} are not read", decoder.original_color_type());
        return Err(DecodeError::Malformed { format: format.name(), reason });
    }
    let mut allowed = Limits::no_limits();
    allowed.max_alloc = Some(decoder.total_bytes() + MAX_WORK_BYTES);
    decoder.set_limits(allowed).map_err(describe)?;
    to_gray(format, DynamicImage::from_decoder(decoder).map_err(describe)?, depth)
}

fn to_gray(
    format: FileFormat,
    image: DynamicImage,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    let mut out = GrayImage::new(image.width(), image.height());
    let gray = out.as_raw_mut();
    match &image {
        DynamicImage::ImageLuma8(pixels) => gray.copy_from_slice(pixels),
        DynamicImage::ImageLumaA8(pixels) => convert::<2>(pixels, gray, |&[v, _]| v),
        DynamicImage::ImageRgb8(pixels) => convert::<3>(pixels, gray, |&[r, g, b]| luma(r, g, b)),
        DynamicImage::ImageRgba8(pixels) => convert::<4>(pixels, gray, |&[r, g, b, _]| luma(r, g, b)),
        DynamicImage::ImageLuma16(samples) => depth.gray_of(samples, 1, gray),
        DynamicImage::ImageLumaA16(samples) => depth.gray_of(samples, 2, gray),
        DynamicImage::ImageRgb16(samples) => depth.gray_of(samples, 3, gray),
        DynamicImage::ImageRgba16(samples) => depth.gray_of(samples, 4, gray),
        other => {
            let reason = format!("pixels of {:?} are not read", other.color());
            return Err(DecodeError::Malformed { format: format.name(), reason });
        }
    }
    Ok(out)
}

fn describe(format: FileFormat, error: &ImageError) -> DecodeError {
    let format = format.name();
    let is_end = |error: &std::io::Error| error.kind() == std::io::ErrorKind::UnexpectedEof;
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        let io = error.downcast_ref::<std::io::Error>();
        if io.is_some_and(is_end)
            || matches!(error.downcast_ref(), Some(ImageError::IoError(io)) if is_end(io))
        {
            return DecodeError::Truncated { format };
        }
        cause = error.source();
    }
    DecodeError::Malformed { format, reason: error.to_string() }
}
