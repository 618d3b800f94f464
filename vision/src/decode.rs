//! From the bytes of a client to a gray image. The bytes are not trusted: sizes are checked before anything
//! is decoded or allocated, and whatever is wrong comes back as a [`DecodeError`].

mod alpha;
mod convert;
mod depth;
mod format;
#[cfg(test)]
mod format_tests;
mod jpeg;
mod others;
mod png;
#[cfg(test)]
mod tests;

pub use alpha::decode_alpha;
pub use depth::SampleDepth;
pub use format::FileFormat;

use crate::GrayImage;

/// Layout of raw pixels. 16-bit samples are little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// One byte a pixel.
    Gray8,
    /// Two bytes a pixel, little-endian, of which a camera may use fewer than all bits: see [`SampleDepth`].
    Gray16,
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, alpha; alpha is ignored.
    Rgba8,
    /// Blue, green, red, alpha; alpha is ignored.
    Bgra8,
}

impl PixelFormat {
    /// Bytes of one pixel.
    pub fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Gray8 => 1,
            Self::Gray16 => 2,
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Rgba8 | Self::Bgra8 => 4,
        }
    }
}

/// An image as a client sends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodedImage<'a> {
    /// Raw pixels, row by row.
    Raw {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Bytes from the start of one row to the next; 0 stands for tight rows.
        stride: u32,
        /// What a pixel is.
        format: PixelFormat,
        /// `(height - 1) * stride + width * bytes_per_pixel` to `height * stride` bytes.
        data: &'a [u8],
    },
    /// A PNG file: gray, color or palette, up to 16 bits.
    Png(&'a [u8]),
    /// A baseline or progressive JPEG file.
    Jpeg(&'a [u8]),
    /// A file of any [`FileFormat`], told by its first bytes.
    Auto(&'a [u8]),
}

/// What is accepted. An image outside is refused before it is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecodeLimits {
    /// Largest input, bytes. Default 64 MiB: the largest raw color image with room to spare.
    pub max_bytes: usize,
    /// Largest image, pixels. Default 4096 * 3072.
    pub max_pixels: u64,
    /// Smallest width, pixels. Default 160: below it there is too little to track.
    pub min_width: u32,
    /// Smallest height, pixels. Default 120.
    pub min_height: u32,
}

impl Default for DecodeLimits {
    fn default() -> Self {
        Self { max_bytes: 64 << 20, max_pixels: 4096 * 3072, min_width: 160, min_height: 120 }
    }
}

/// Why an image was refused. Each message is a sentence fit for the client.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// More bytes than allowed.
    #[error("the image has {actual} bytes, more than the {max} allowed")]
    TooManyBytes {
        /// Bytes given.
        actual: usize,
        /// Bytes allowed.
        max: usize,
    },
    /// A width or height of 0.
    #[error("the image has no pixels ({width}x{height})")]
    Empty {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
    /// Smaller than allowed.
    #[error("the image is {width}x{height}, smaller than the {min_width}x{min_height} required")]
    TooSmall {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Smallest width allowed, pixels.
        min_width: u32,
        /// Smallest height allowed, pixels.
        min_height: u32,
    },
    /// Larger than allowed.
    #[error("the image is {width}x{height}, more than the {max_pixels} pixels allowed")]
    TooLarge {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Pixels allowed.
        max_pixels: u64,
    },
    /// The row stride of raw pixels is shorter than a row.
    #[error("the row stride is {stride} bytes, but a row has {row_bytes}")]
    StrideTooShort {
        /// Stride given, bytes.
        stride: u32,
        /// Bytes of a row.
        row_bytes: u64,
    },
    /// Raw pixels of another length than width, height, stride and format say.
    #[error("the raw image has {actual} bytes, but its size needs {expected}")]
    WrongLength {
        /// Bytes needed.
        expected: u64,
        /// Bytes given.
        actual: u64,
    },
    /// The bytes are of no image format known here.
    #[error("the bytes are no image that is read: PNG, JPEG, BMP, WebP, TIFF, PGM and PPM are")]
    UnknownFormat,
    /// The bytes are of a format that is known and not read.
    #[error("the bytes are {format}, which is not read; convert it to JPEG or PNG")]
    OtherFormat {
        /// The format.
        format: &'static str,
    },
    /// The bytes are not of the format they were said to be.
    #[error("the bytes are not a {format} image")]
    WrongFormat {
        /// The format announced.
        format: &'static str,
    },
    /// The file ends before the image does.
    #[error("the {format} image is cut off")]
    Truncated {
        /// The format.
        format: &'static str,
    },
    /// The file is damaged, or of a kind that is not supported.
    #[error("the {format} image cannot be decoded: {reason}")]
    Malformed {
        /// The format.
        format: &'static str,
        /// What the decoder says.
        reason: String,
    },
}

/// Decodes `image` to gray (ITU-R BT.601 luma), refusing what is outside `limits` before decoding it. Samples
/// of 16 bits are scaled by what is there.
///
/// # Errors
/// Why it cannot be decoded, a sentence for the client.
pub fn decode_gray(image: &EncodedImage<'_>, limits: &DecodeLimits) -> Result<GrayImage, DecodeError> {
    decode_gray_alike(image, limits, &mut SampleDepth::default())
}

/// As [`decode_gray`], the samples of 16 bits scaled as in the images of the same camera before.
///
/// # Errors
/// Why it cannot be decoded, a sentence for the client.
pub fn decode_gray_alike(
    image: &EncodedImage<'_>,
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    let data = match *image {
        EncodedImage::Raw { data, .. } | EncodedImage::Png(data) | EncodedImage::Jpeg(data) => data,
        EncodedImage::Auto(data) => data,
    };
    if data.len() > limits.max_bytes {
        return Err(DecodeError::TooManyBytes { actual: data.len(), max: limits.max_bytes });
    }
    match *image {
        EncodedImage::Raw { width, height, stride, format, data } => {
            decode_raw(width, height, stride, format, data, limits, depth)
        }
        EncodedImage::Png(data) => png::decode(data, limits, depth),
        EncodedImage::Jpeg(data) => jpeg::decode(data, limits),
        EncodedImage::Auto(data) => match FileFormat::of(data) {
            Some(FileFormat::Png) => png::decode(data, limits, depth),
            Some(FileFormat::Jpeg) => jpeg::decode(data, limits),
            Some(other) => others::decode(other, data, limits, depth),
            None => Err(format::other(data)
                .map_or(DecodeError::UnknownFormat, |format| DecodeError::OtherFormat { format })),
        },
    }
}

impl DecodeLimits {
    /// Checks a size read from a header.
    fn check_size(&self, width: u32, height: u32) -> Result<(), DecodeError> {
        if width == 0 || height == 0 {
            return Err(DecodeError::Empty { width, height });
        }
        if u64::from(width) * u64::from(height) > self.max_pixels {
            return Err(DecodeError::TooLarge { width, height, max_pixels: self.max_pixels });
        }
        if width < self.min_width || height < self.min_height {
            let (min_width, min_height) = (self.min_width, self.min_height);
            return Err(DecodeError::TooSmall { width, height, min_width, min_height });
        }
        Ok(())
    }
}

fn decode_raw(
    width: u32,
    height: u32,
    stride: u32,
    format: PixelFormat,
    data: &[u8],
    limits: &DecodeLimits,
    depth: &mut SampleDepth,
) -> Result<GrayImage, DecodeError> {
    limits.check_size(width, height)?;
    let row_bytes = u64::from(width) * format.bytes_per_pixel() as u64;
    if stride != 0 && u64::from(stride) < row_bytes {
        return Err(DecodeError::StrideTooShort { stride, row_bytes });
    }
    let stride = if stride == 0 { row_bytes } else { u64::from(stride) };
    // The padding after the last row may be missing.
    let (least, most) = (stride * u64::from(height - 1) + row_bytes, stride * u64::from(height));
    let actual = data.len() as u64;
    if !(least..=most).contains(&actual) {
        return Err(DecodeError::WrongLength { expected: least, actual });
    }
    let mut out = GrayImage::new(width, height);
    if format == PixelFormat::Gray16 {
        let rows = data.chunks(stride as usize).take(height as usize);
        let rows = rows.flat_map(|row| row[..row_bytes as usize].as_chunks::<2>().0);
        let samples: Vec<u16> = rows.map(|bytes| u16::from_le_bytes(*bytes)).collect();
        depth.gray_of(&samples, 1, out.as_raw_mut());
        return Ok(out);
    }
    for (y, row) in data.chunks(stride as usize).take(height as usize).enumerate() {
        convert::raw_row_to_gray(&row[..row_bytes as usize], format, out.row_mut(y as u32));
    }
    Ok(out)
}
