//! JPEG files, by `zune-jpeg`, which gives the luma channel without converting colors.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use super::{DecodeError, DecodeLimits};
use crate::GrayImage;

const FORMAT: &str = "JPEG";
const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];

pub(super) fn has_signature(data: &[u8]) -> bool {
    data.starts_with(b"\xFF\xD8\xFF")
}

pub(super) fn decode(data: &[u8], limits: &DecodeLimits) -> Result<GrayImage, DecodeError> {
    if !has_signature(data) {
        return Err(DecodeError::WrongFormat { format: FORMAT });
    }
    let options = DecoderOptions::default()
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(describe)?;
    let (width, height) = decoder.dimensions().unwrap_or((0, 0));
    let (width, height) = (width as u32, height as u32);
    limits.check_size(width, height)?;
    // The decoder fills what is missing with gray; we would rather know. Only the end-of-image marker tells.
    if !data.windows(2).rev().any(|marker| marker == END_OF_IMAGE) {
        return Err(DecodeError::Truncated { format: FORMAT });
    }
    let pixels = decoder.decode().map_err(describe)?;
    GrayImage::from_raw(width, height, pixels)
        .map_err(|e| DecodeError::Malformed { format: FORMAT, reason: e.to_string() })
}

fn describe(error: DecodeErrors) -> DecodeError {
    match error {
        DecodeErrors::ExhaustedData | DecodeErrors::IoErrors(_) => DecodeError::Truncated { format: FORMAT },
        DecodeErrors::ZeroError => DecodeError::Empty { width: 0, height: 0 },
        other => DecodeError::Malformed { format: FORMAT, reason: format!("{other:?}") },
    }
}
