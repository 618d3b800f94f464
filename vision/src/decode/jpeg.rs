//! JPEG files, by `zune-jpeg`, which gives the luma channel without converting colors.
//!
//! The decoder fills what is missing with gray; we would rather know. What cameras and programs write besides
//! what it expects is put right before: frames of webcams without Huffman tables, colors that are not YCbCr,
//! files that lack nothing but the marker of their end.

mod structure;

use structure::{End, Frame, PROGRESSIVE, Structure};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

use super::convert::{convert, luma};
use super::{DecodeError, DecodeLimits, FileFormat};
use crate::GrayImage;

const FORMAT: &str = "JPEG";
const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];

/// A segment after which the decoder takes the tables of [ITU T.81, annex K.3] where there are none: the head
/// of frames in AVI files, from which webcams have the habit of leaving them out.
const MOTION_JPEG: [u8; 18] = *b"\xFF\xE0\0\x10AVI1\0\0\0\0\0\0\0\0\0\0";

/// Adobe's segment that says that the components are no differences of colors.
const NO_TRANSFORM: [u8; 16] = *b"\xFF\xEE\0\x0EAdobe\0\x64\0\0\0\0\0";

/// What stands between the last scan and the end when a file is decoded: a code of ones alone, which no table
/// has [ITU T.81, annex C]. Where everything is there it is not read, and where something is missing it is an
/// error; the decoder itself goes on with zeros for ever. One kind of frame has to do without.
const NO_CODE: [u8; 64] = {
    let mut bytes = [0; 64];
    let mut i = 0;
    while i < bytes.len() {
        // A zero behind each keeps it from being a marker.
        bytes[i] = 0xFF;
        i += 2;
    }
    bytes
};

pub(super) fn decode(data: &[u8], limits: &DecodeLimits) -> Result<GrayImage, DecodeError> {
    if FileFormat::of(data) != Some(FileFormat::Jpeg) {
        return Err(DecodeError::WrongFormat { format: FORMAT });
    }
    let head = Structure::head_of(data);
    let Some(frame) = &head.frame else { return Err(TRUNCATED) };
    limits.check_size(u32::from(frame.width), u32::from(frame.height))?;
    refuse_other_kinds(frame)?;
    let colors = Colors::of(frame, head.adobe_transform);
    // Nearly all files: one scan, and the marker of the end at the end.
    if frame.kind != PROGRESSIVE
        && head.is_in_one_scan
        && let Some(end_at) = data.windows(2).rposition(|marker| marker == END_OF_IMAGE)
        && let Ok(image) = pixels(&ended(data, end_at, &head, colors), reads_on(&head), colors, limits)
    {
        return Ok(image);
    }
    decode_with_care(data, colors, limits)
}

/// Decodes a file of which something may be missing, or finds out what is wrong with it.
fn decode_with_care(data: &[u8], colors: Colors, limits: &DecodeLimits) -> Result<GrayImage, DecodeError> {
    let structure = Structure::of(data);
    let reads_on = reads_on(&structure);
    // Where the decoder does not notice, the marker has to be there.
    let is_open = reads_on && structure.end != End::Marked;
    if structure.end == End::CutOff || is_open || !structure.has_every_scan() {
        return Err(TRUNCATED);
    }
    let error = match pixels(&ended(data, structure.end_at, &structure, colors), reads_on, colors, limits) {
        Ok(image) => return Ok(image),
        Err(error) => error,
    };
    // An end may have been put on what was cut off.
    let is_cut_off = structure.end != End::Marked || pixels(data, reads_on, colors, limits).is_ok();
    Err(if is_cut_off { TRUNCATED } else { error })
}

/// The file up to its end, with the segments that the decoder misses right behind the marker of its
/// beginning, and no code before that of its end.
fn ended(data: &[u8], end_at: usize, structure: &Structure, colors: Colors) -> Vec<u8> {
    let tables: &[u8] = if structure.has_huffman_tables { &[] } else { &MOTION_JPEG };
    let is_unsaid = colors == Colors::Rgb && structure.adobe_transform.is_none();
    let adobe: &[u8] = if is_unsaid { &NO_TRANSFORM } else { &[] };
    let (begin, rest) = data[..end_at].split_at(2);
    // Half of a marker, or fill bytes before one.
    let n_kept = rest.len() - rest.iter().rev().take_while(|byte| **byte == 0xFF).count();
    let no_code: &[u8] = if reads_on(structure) { &[] } else { &NO_CODE };
    [begin, tables, adobe, &rest[..n_kept], no_code, &END_OF_IMAGE].concat()
}

/// Whether the decoder reads more blocks than there are.
fn reads_on(structure: &Structure) -> bool {
    structure.frame.as_ref().is_some_and(Frame::is_read_beyond_its_end)
}

const TRUNCATED: DecodeError = DecodeError::Truncated { format: FORMAT };

/// What the components are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Colors {
    /// One that is gray, or brightness and two differences of colors.
    Luma,
    /// Red, green, blue.
    Rgb,
    /// Four, of printing.
    Cmyk,
}

impl Colors {
    fn of(frame: &Frame, adobe_transform: Option<u8>) -> Self {
        match (&frame.components[..], adobe_transform) {
            ([_, _, _, _, ..], _) => Self::Cmyk,
            ([_, _, _], Some(0)) | (b"RGB", None) => Self::Rgb,
            _ => Self::Luma,
        }
    }
}

/// Refuses what the decoder does not know, in words that say what to do.
fn refuse_other_kinds(frame: &Frame) -> Result<(), DecodeError> {
    let refused = |what: &str| {
        let reason = format!("{what} is not read; save it as baseline or progressive JPEG, or as PNG");
        Err(DecodeError::Malformed { format: FORMAT, reason })
    };
    if let Some((across, down)) = frame.misread_sampling() {
        return refused(&format!("JPEG with components sampled by {across} x {down}"));
    }
    match frame.kind {
        0xC3 | 0xC7 | 0xCB | 0xCF => refused("lossless JPEG compression"),
        0xC9..=0xCF => refused("arithmetic coding"),
        0xC5 | 0xC6 => refused("hierarchical JPEG compression"),
        _ if frame.n_bits != 8 => refused(&format!("JPEG with {} bits a sample", frame.n_bits)),
        0xC0 | 0xC1 | PROGRESSIVE if frame.components.is_empty() => refused("a frame without components"),
        _ => Ok(()),
    }
}

fn pixels(
    data: &[u8],
    reads_on: bool,
    colors: Colors,
    limits: &DecodeLimits,
) -> Result<GrayImage, DecodeError> {
    // Strictly, so that a scan that ends early is an error and no gray area; but not beyond the end.
    match unpack(data, colors, limits, !reads_on) {
        Err(Refused::ByStrictness) => unpack(data, colors, limits, false),
        outcome => outcome,
    }
    .map_err(|refused| match refused {
        Refused::Because(error) => error,
        Refused::ByStrictness => TRUNCATED,
    })
}

enum Refused {
    Because(DecodeError),
    /// By a rule that many files break without harm.
    ByStrictness,
}

fn unpack(data: &[u8], colors: Colors, limits: &DecodeLimits, is_strict: bool) -> Result<GrayImage, Refused> {
    let options = DecoderOptions::default()
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .set_strict_mode(is_strict)
        .jpeg_set_out_colorspace(if colors == Colors::Luma { ColorSpace::Luma } else { ColorSpace::RGB });
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(describe)?;
    let (width, height) = decoder.dimensions().unwrap_or((0, 0));
    let (width, height) = (width as u32, height as u32);
    limits.check_size(width, height).map_err(Refused::Because)?;
    let pixels = decoder.decode().map_err(describe)?;
    let malformed = |reason: String| Refused::Because(DecodeError::Malformed { format: FORMAT, reason });
    if colors == Colors::Luma {
        return GrayImage::from_raw(width, height, pixels).map_err(|error| malformed(error.to_string()));
    }
    let mut gray = GrayImage::new(width, height);
    if pixels.len() != 3 * gray.as_raw().len() {
        return Err(malformed(format!("{} bytes of colors for {width}x{height} pixels", pixels.len())));
    }
    convert::<3>(&pixels, gray.as_raw_mut(), |&[r, g, b]| luma(r, g, b));
    Ok(gray)
}

fn describe(error: DecodeErrors) -> Refused {
    let sentence = match error {
        DecodeErrors::ExhaustedData | DecodeErrors::IoErrors(_) => return Refused::Because(TRUNCATED),
        DecodeErrors::ZeroError => return Refused::Because(DecodeError::Empty { width: 0, height: 0 }),
        // What a person reads, without the names of types.
        DecodeErrors::Format(sentence)
        | DecodeErrors::HuffmanDecode(sentence)
        | DecodeErrors::SofError(sentence)
        | DecodeErrors::SosError(sentence)
        | DecodeErrors::DqtError(sentence)
        | DecodeErrors::MCUError(sentence) => sentence,
        DecodeErrors::FormatStatic(sentence) => sentence.to_owned(),
        other => format!("{other:?}"),
    };
    if ["Extra bytes between headers", "number of components but found"]
        .iter()
        .any(|rule| sentence.contains(rule))
    {
        return Refused::ByStrictness;
    }
    if ["Premature end of buffer", "No more bytes left in stream", "Marker missing"]
        .iter()
        .any(|end| sentence.contains(end))
    {
        return Refused::Because(TRUNCATED);
    }
    Refused::Because(DecodeError::Malformed { format: FORMAT, reason: sentence })
}
