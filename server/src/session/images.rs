//! The images of frames that may become keyframes, until the map says which did.
//!
//! The engine decides about keyframes after the frame was handed in: the first map is made from earlier
//! views, and mapping may run behind tracking. So images of candidates are held, by reference, within bounds.

use super::frame::{Encoding, SentImage};
use png::{BitDepth, ColorType, Compression, Encoder, Filter};
use slam::MapUpdate;
use slam::map::{CameraId, FrameState, KeyframeId};
use std::collections::VecDeque;
use store::{KeyframeImage, StoredImage};
use vision::decode::{DecodeLimits, FileFormat, PixelFormat, decode_gray};

/// Candidates held at most: over two seconds of video, more than the engine looks back for a first view.
const MAX_CANDIDATES: usize = 96;
/// Bytes of candidates held at most.
const MAX_CANDIDATE_BYTES: usize = 64 << 20;

/// Holds the images of candidates of all of a map's cameras.
#[derive(Debug, Default)]
pub struct CandidateImages {
    /// By camera and number of the frame.
    candidates: VecDeque<((CameraId, u64), SentImage)>,
    n_bytes: usize,
}

impl CandidateImages {
    /// Holds a frame's image if the frame is or may yet become a keyframe; the oldest go when there are too
    /// many.
    pub fn offer(&mut self, frame: (CameraId, u64), image: SentImage, state: FrameState, is_keyframe: bool) {
        if state == FrameState::Tracked && !is_keyframe {
            return;
        }
        self.n_bytes += image.data.len();
        self.candidates.push_back((frame, image));
        while self.candidates.len() > MAX_CANDIDATES || self.n_bytes > MAX_CANDIDATE_BYTES {
            let Some((_, oldest)) = self.candidates.pop_front() else { break };
            self.n_bytes -= oldest.data.len();
        }
    }

    /// The images of the keyframes that are new in an update.
    pub fn take_for(&mut self, update: &MapUpdate) -> Vec<(KeyframeId, SentImage)> {
        let changed = update.changes.keyframes.iter().filter_map(|id| update.map.keyframe(*id));
        changed
            .filter_map(|keyframe| Some((keyframe.id, self.take((keyframe.camera.id, keyframe.sequence))?)))
            .collect()
    }

    fn take(&mut self, frame: (CameraId, u64)) -> Option<SentImage> {
        let position = self.candidates.iter().position(|(candidate, _)| *candidate == frame)?;
        let (_, image) = self.candidates.remove(position)?;
        self.n_bytes -= image.data.len();
        Some(image)
    }
}

/// The image of a keyframe as a file to be stored: what browsers show as it was sent, the rest as PNG.
///
/// `None` if the pixels do not fit the size, which the decoder would have refused before.
pub fn to_file(keyframe: KeyframeId, image: &SentImage) -> Option<KeyframeImage> {
    let StoredImage { media_type, bytes } = as_file(image)?;
    Some(KeyframeImage { keyframe, media_type, bytes })
}

/// An image as a file: what browsers show as it was sent, TIFF and PNM as gray PNG, pixels as PNG; `None` as
/// for `to_file`.
pub fn as_file(image: &SentImage) -> Option<StoredImage> {
    let file = |media_type: &str, bytes| Some(StoredImage { media_type: media_type.to_owned(), bytes });
    let format = match image.encoding {
        Encoding::Raw(format) => format,
        Encoding::Png | Encoding::Jpeg | Encoding::Auto => {
            let format = FileFormat::of(&image.data)?;
            if format.is_shown_by_browsers() {
                return file(format.media_type(), image.data.to_vec());
            }
            // No size is too large that was not refused when the frame was decoded.
            let limits =
                DecodeLimits { max_bytes: usize::MAX, max_pixels: u64::MAX, min_width: 1, min_height: 1 };
            let gray = decode_gray(&image.as_encoded(), &limits).ok()?;
            let size = (gray.width(), gray.height());
            return file("image/png", png(gray.as_raw(), size, ColorType::Grayscale, BitDepth::Eight)?);
        }
    };
    let (pixels, color, depth) = packed_pixels(image, format)?;
    file("image/png", png(&pixels, (image.width, image.height), color, depth)?)
}

fn png(pixels: &[u8], (width, height): (u32, u32), color: ColorType, depth: BitDepth) -> Option<Vec<u8>> {
    let mut data = Vec::new();
    let mut encoder = Encoder::new(&mut data, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(pixels).ok()?;
    writer.finish().ok()?;
    Some(data)
}

/// The rows without padding, in an order of channels PNG knows; 16-bit samples big-endian.
fn packed_pixels(image: &SentImage, format: PixelFormat) -> Option<(Vec<u8>, ColorType, BitDepth)> {
    let row_bytes = image.width as usize * format.bytes_per_pixel();
    let stride = if image.row_stride == 0 { row_bytes } else { image.row_stride as usize };
    let mut pixels = Vec::with_capacity(row_bytes * image.height as usize);
    for y in 0..image.height as usize {
        let start = y.checked_mul(stride)?;
        pixels.extend_from_slice(image.data.get(start..start.checked_add(row_bytes)?)?);
    }
    let (color, depth) = match format {
        PixelFormat::Gray8 => (ColorType::Grayscale, BitDepth::Eight),
        PixelFormat::Gray16 => {
            pixels.chunks_exact_mut(2).for_each(|sample| sample.swap(0, 1));
            (ColorType::Grayscale, BitDepth::Sixteen)
        }
        PixelFormat::Rgb8 => (ColorType::Rgb, BitDepth::Eight),
        PixelFormat::Rgba8 => (ColorType::Rgba, BitDepth::Eight),
        PixelFormat::Bgr8 => {
            pixels.chunks_exact_mut(3).for_each(|pixel| pixel.swap(0, 2));
            (ColorType::Rgb, BitDepth::Eight)
        }
        PixelFormat::Bgra8 => {
            pixels.chunks_exact_mut(4).for_each(|pixel| pixel.swap(0, 2));
            (ColorType::Rgba, BitDepth::Eight)
        }
    };
    Some((pixels, color, depth))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(format: PixelFormat, width: u32, height: u32, row_stride: u32, data: &[u8]) -> SentImage {
        let data = bytes::Bytes::copy_from_slice(data);
        SentImage { encoding: Encoding::Raw(format), width, height, row_stride, data }
    }

    fn file_of(image: &SentImage) -> Option<KeyframeImage> {
        to_file(KeyframeId::new(3).unwrap(), image)
    }

    #[test]
    fn raw_pixels_come_back_from_their_png() {
        let image = raw(PixelFormat::Bgr8, 2, 2, 8, &[1, 2, 3, 4, 5, 6, 0, 0, 7, 8, 9, 10, 11, 12]);
        let file = file_of(&image).unwrap();
        assert_eq!((file.keyframe.get(), file.media_type.as_str()), (3, "image/png"));
        let decoded = image::load_from_memory(&file.bytes).unwrap().into_rgb8();
        assert_eq!(decoded.into_raw(), [3, 2, 1, 6, 5, 4, 9, 8, 7, 12, 11, 10]);
    }

    #[test]
    fn sixteen_bit_pixels_keep_all_their_bits() {
        let file = file_of(&raw(PixelFormat::Gray16, 2, 1, 0, &[0x34, 0x12, 0xCD, 0xAB])).unwrap();
        let decoded = image::load_from_memory(&file.bytes).unwrap().into_luma16();
        assert_eq!(decoded.into_raw(), [0x1234, 0xABCD]);
    }

    #[test]
    fn pixels_that_do_not_fit_the_size_give_no_file() {
        assert_eq!(file_of(&raw(PixelFormat::Gray8, 4, 4, 0, &[0; 15])), None);
    }

    #[test]
    fn candidates_stay_within_their_bounds() {
        let mut candidates = CandidateImages::default();
        for sequence in 0..10_000 {
            let image = raw(PixelFormat::Gray8, 1, 1, 0, &[0; 1 << 10]);
            candidates.offer((CameraId::default(), sequence), image, FrameState::Initialising, false);
        }
        assert_eq!(candidates.candidates.len(), MAX_CANDIDATES);
        assert_eq!(candidates.n_bytes, MAX_CANDIDATES << 10);
        assert!(candidates.take((CameraId::default(), 9_999)).is_some());
        assert!(candidates.take((CameraId::default(), 0)).is_none());
    }
}
