//! PNG files, by the `png` crate.

use std::io::{Cursor, ErrorKind};

use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};

use super::convert::{convert, luma};
use super::depth::SampleDepth;
use super::{DecodeError, DecodeLimits, FileFormat};
use crate::GrayImage;

const FORMAT: &str = "PNG";

/// Room for chunks besides the pixels, whose size is checked on its own: a palette takes 768 bytes.
const MAX_CHUNK_BYTES: usize = 64 << 20;

pub(super) fn decode(
    data: &[u8],
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    if FileFormat::of(data) != Some(FileFormat::Png) {
        return Err(DecodeError::WrongFormat { format: FORMAT });
    }
    check_header(data, limits)?;
    let mut decoder = Decoder::new_with_limits(Cursor::new(data), Limits { bytes: MAX_CHUNK_BYTES });
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Palettes and samples of fewer than eight bits become bytes, transparent colors an alpha channel.
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(describe)?;
    let (width, height) = reader.info().size();
    limits.check_size(width, height)?;
    let too_large = || DecodeError::TooLarge { width, height, max_pixels: limits.max_pixels };
    let mut pixels = vec![0; reader.output_buffer_size().ok_or_else(too_large)?];
    let frame = reader.next_frame(&mut pixels).map_err(describe)?;
    let mut out = GrayImage::new(width, height);
    let gray = out.as_raw_mut();
    match (frame.color_type, frame.bit_depth) {
        (ColorType::Grayscale, BitDepth::Eight) => gray.copy_from_slice(&pixels),
        (ColorType::GrayscaleAlpha, BitDepth::Eight) => convert::<2>(&pixels, gray, |&[v, _]| v),
        (ColorType::Rgb, BitDepth::Eight) => convert::<3>(&pixels, gray, |&[r, g, b]| luma(r, g, b)),
        (ColorType::Rgba, BitDepth::Eight) => convert::<4>(&pixels, gray, |&[r, g, b, _]| luma(r, g, b)),
        (color, BitDepth::Sixteen) if color != ColorType::Indexed => {
            // Samples are big-endian.
            let samples: Vec<u16> =
                pixels.as_chunks::<2>().0.iter().map(|bytes| u16::from_be_bytes(*bytes)).collect();
            depth.gray_of(&samples, color.samples(), gray);
        }
        (color, bits) => {
            let reason = format!("color type {color:?} of depth {bits:?} is not supported");
            return Err(DecodeError::Malformed { format: FORMAT, reason });
        }
    }
    Ok(out)
}

/// Reads the size straight from the header chunk, which must come first: nothing else is looked at until it
/// is known to be acceptable.
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

fn describe(error: DecodingError) -> DecodeError {
    match error {
        DecodingError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => {
            DecodeError::Truncated { format: FORMAT }
        }
        other => DecodeError::Malformed { format: FORMAT, reason: other.to_string() },
    }
}
