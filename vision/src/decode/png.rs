//! PNG files, by the `image` crate.

use std::io::{Cursor, ErrorKind};

use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder, ImageError};

use super::convert::{convert, luma, narrow};
use super::{DecodeError, DecodeLimits};
use crate::GrayImage;

const FORMAT: &str = "PNG";

pub(super) fn has_signature(data: &[u8]) -> bool {
    data.starts_with(b"\x89PNG\r\n\x1a\n")
}

pub(super) fn decode(data: &[u8], limits: &DecodeLimits) -> Result<GrayImage, DecodeError> {
    if !has_signature(data) {
        return Err(DecodeError::WrongFormat { format: FORMAT });
    }
    check_header(data, limits)?;
    let decoder = PngDecoder::new(Cursor::new(data)).map_err(describe)?;
    let (width, height) = decoder.dimensions();
    limits.check_size(width, height)?;
    let color = decoder.color_type();
    let mut pixels = vec![0; decoder.total_bytes() as usize];
    decoder.read_image(&mut pixels).map_err(describe)?;
    let mut out = GrayImage::new(width, height);
    let gray = out.as_raw_mut();
    // 16-bit samples come in the machine's own byte order.
    let wide = |a: u8, b: u8| narrow(u16::from_ne_bytes([a, b]));
    match color {
        ColorType::L8 => gray.copy_from_slice(&pixels),
        ColorType::La8 => convert::<2>(&pixels, gray, |&[v, _]| v),
        ColorType::Rgb8 => convert::<3>(&pixels, gray, |&[r, g, b]| luma(r, g, b)),
        ColorType::Rgba8 => convert::<4>(&pixels, gray, |&[r, g, b, _]| luma(r, g, b)),
        ColorType::L16 => convert::<2>(&pixels, gray, |&[a, b]| wide(a, b)),
        ColorType::La16 => convert::<4>(&pixels, gray, |&[a, b, ..]| wide(a, b)),
        ColorType::Rgb16 => {
            convert::<6>(&pixels, gray, |p| luma(wide(p[0], p[1]), wide(p[2], p[3]), wide(p[4], p[5])));
        }
        ColorType::Rgba16 => {
            convert::<8>(&pixels, gray, |p| luma(wide(p[0], p[1]), wide(p[2], p[3]), wide(p[4], p[5])));
        }
        other => {
            let reason = format!("colour type {other:?} is not supported");
            return Err(DecodeError::Malformed { format: FORMAT, reason });
        }
    }
    Ok(out)
}

/// Reads the size straight from the header chunk, which must come first: nothing else is looked at until it is known
/// to be acceptable.
fn check_header(data: &[u8], limits: &DecodeLimits) -> Result<(), DecodeError> {
    // Signature (8), chunk length (4), "IHDR" (4), width (4), height (4), big-endian.
    let Some(header) = data.get(8..24) else { return Err(DecodeError::Truncated { format: FORMAT }) };
    if &header[4..8] != b"IHDR" {
        let reason = "the header is missing".to_owned();
        return Err(DecodeError::Malformed { format: FORMAT, reason });
    }
    let number = |at: usize| u32::from_be_bytes(std::array::from_fn(|i| header[at + i]));
    limits.check_size(number(8), number(12))
}

fn describe(error: ImageError) -> DecodeError {
    match error {
        ImageError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => {
            DecodeError::Truncated { format: FORMAT }
        }
        other => DecodeError::Malformed { format: FORMAT, reason: other.to_string() },
    }
}
