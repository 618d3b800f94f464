//! Frames that are read one after the other, because what holds them has no list of them: videos, cameras,
//! pipes, bags.

use crate::files::FileError;

/// An image as it was recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FrameImage {
    /// An image file.
    Encoded(Vec<u8>),
    /// Pixels.
    Raw(RawImage),
}

/// Pixels, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawImage {
    /// What a pixel is.
    pub format: PixelFormat,
    /// Pixels in a row, at least one.
    pub width: u32,
    /// Rows, at least one.
    pub height: u32,
    /// Bytes from one row to the next.
    pub row_stride: u32,
    /// At least `height` rows, of which the last may lack what is behind its pixels.
    pub data: Vec<u8>,
}

/// What a pixel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// A byte.
    Gray8,
    /// Two bytes, the lower first.
    Gray16,
    /// Red, green, blue, a byte each.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, opacity.
    Rgba8,
    /// Blue, green, red, opacity.
    Bgra8,
}

impl PixelFormat {
    /// Bytes of a pixel.
    pub fn n_bytes(self) -> usize {
        match self {
            Self::Gray8 => 1,
            Self::Gray16 => 2,
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Rgba8 | Self::Bgra8 => 4,
        }
    }
}

impl FrameImage {
    /// Width and height, pixels; `None` if it is of no format that is known.
    pub fn size(&self) -> Option<(u32, u32)> {
        match self {
            Self::Raw(image) => Some((image.width, image.height)),
            Self::Encoded(data) => {
                let size = imagesize::blob_size(data).ok()?;
                Some((u32::try_from(size.width).ok()?, u32::try_from(size.height).ok()?))
            }
        }
    }

    /// Bytes it takes.
    pub fn n_bytes(&self) -> usize {
        match self {
            Self::Raw(image) => image.data.len(),
            Self::Encoded(data) => data.len(),
        }
    }
}

/// An image with its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedFrame {
    /// When it was taken, nanoseconds.
    pub timestamp_ns: i64,
    /// The image.
    pub image: FrameImage,
}

/// Gives frames one after the other.
pub trait FrameReader: Send {
    /// The next frame, or `None` behind the last one. Waits for a frame that is still to be taken.
    ///
    /// # Errors
    /// A [`FileError`] if there should be one and it cannot be read.
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError>;

    /// What was wrong without keeping frames from being read, a sentence for the user.
    fn remark(&self) -> Option<String> {
        None
    }
}
