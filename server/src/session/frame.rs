//! What goes into a session's stream and what comes out.

use super::view::SessionView;
use crate::budget::Charge;
use bytes::Bytes;
use slam::FrameReport;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Instant;
use vision::decode::{EncodedImage, PixelFormat};

/// An image as the client sent it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SentImage {
    /// What the bytes are.
    pub encoding: Encoding,
    /// Width of a raw image, pixels.
    pub width: u32,
    /// Height of a raw image, pixels.
    pub height: u32,
    /// Bytes from one row of a raw image to the next; 0 means the rows are packed.
    pub row_stride: u32,
    /// The bytes.
    pub data: Bytes,
}

/// What the bytes of an image are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// A file, its format told by the first bytes.
    Auto,
    /// A PNG file.
    Png,
    /// A JPEG file.
    Jpeg,
    /// Pixels.
    Raw(PixelFormat),
}

impl SentImage {
    /// The image in the decoder's terms.
    pub fn as_encoded(&self) -> EncodedImage<'_> {
        let data = &self.data[..];
        match self.encoding {
            Encoding::Auto => EncodedImage::Auto(data),
            Encoding::Png => EncodedImage::Png(data),
            Encoding::Jpeg => EncodedImage::Jpeg(data),
            Encoding::Raw(format) => EncodedImage::Raw {
                width: self.width,
                height: self.height,
                stride: self.row_stride,
                format,
                data,
            },
        }
    }
}

/// A frame as it arrived.
#[derive(Clone, Debug)]
pub struct SentFrame {
    /// The client's number.
    pub sequence: u64,
    /// The client's time, nanoseconds.
    pub timestamp_ns: i64,
    /// The image.
    pub image: SentImage,
    /// When it arrived.
    pub arrived: Instant,
    /// Room it takes until it is decoded, where that is counted.
    pub charge: Option<Arc<Charge>>,
}

/// Why a frame was not used; nothing of it is kept and the stream goes on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rejection {
    /// The client's number.
    pub sequence: u64,
    /// Which part of the frame is wrong, such as `image.data`.
    pub field: &'static str,
    /// What is wrong with it, in a plain sentence.
    pub reason: String,
    /// Stable name of the kind of error.
    pub code: &'static str,
}

/// An image whose brightest pixel is no brighter than this shows nothing, gray levels of 255.
const NEARLY_BLACK: u8 = 12;

/// What came of a frame: what the engine reports, and what the picture itself explains.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameOutcome {
    /// What the engine reports.
    pub report: FrameReport,
    /// The gray of the picture's brightest pixel.
    pub brightest: u8,
}

impl FrameOutcome {
    /// Why there is no good pose, in a plain sentence; empty if there is one.
    pub fn reason(&self) -> String {
        let reason = self.report.outcome.reason();
        match self.brightest {
            _ if reason.is_empty() => reason,
            0 => format!("the picture is black; {reason}"),
            gray @ 1..=NEARLY_BLACK => {
                format!("the picture is nearly black, its brightest value is {gray} of 255; {reason}")
            }
            _ => reason,
        }
    }
}

impl Deref for FrameOutcome {
    type Target = FrameReport;

    fn deref(&self) -> &FrameReport {
        &self.report
    }
}

/// The answer to a frame that was tracked.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// What came of it.
    pub report: FrameOutcome,
    /// Every frame up to this one is in the database.
    pub durable_sequence: Option<u64>,
    /// Nanoseconds between the frame's arrival and its tracking.
    pub queued_ns: u64,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
}

/// What came of a frame when it was tracked.
#[derive(Clone, Debug)]
pub enum Before {
    /// A frame of a moment ago.
    Recent(Box<FrameOutcome>),
    /// A frame in the database.
    Stored(store::StoredFrame),
}

/// One message to the client of a stream.
#[derive(Clone, Debug)]
pub enum Reply {
    /// The stream is open.
    Opened(Box<SessionView>),
    /// A frame was tracked.
    Answered(Box<Answer>),
    /// A frame that was answered before was not tracked again.
    Repeated {
        /// The client's number.
        sequence: u64,
        /// The client's time of the repetition, nanoseconds.
        timestamp_ns: i64,
        /// What came of it the first time, where that is known.
        before: Option<Before>,
        /// Every frame up to this one is in the database.
        durable_sequence: Option<u64>,
        /// Metres per map unit; `None` while the scale is free.
        metres_per_unit: Option<f64>,
    },
    /// A newer frame came before this one's turn.
    Dropped(u64),
    /// A frame cannot be used.
    Rejected(Rejection),
}
