//! What a session is given, and why it may refuse it.

use crate::config::ConfigError;
use crate::map::{MapError, MapParts};
use geometry::Camera;
use std::sync::Arc;
use vision::GrayImage;
use vision::mask::Mask;

/// One image of the stream.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// The image, of the session's camera's size.
    pub image: GrayImage,
}

/// Why a frame cannot be used; nothing of it is kept.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The image is not of the camera's size.
    #[error(
        "the image is {width}x{height} pixels but the session's camera is {expected_width}x{expected_height}"
    )]
    WrongImageSize {
        /// Width of the image.
        width: u32,
        /// Height of the image.
        height: u32,
        /// Width of the camera.
        expected_width: u32,
        /// Height of the camera.
        expected_height: u32,
    },
    /// Time does not go on.
    #[error("timestamp_ns {timestamp_ns} is not after the last frame's {last_timestamp_ns}")]
    TimestampNotIncreasing {
        /// The frame's time.
        timestamp_ns: i64,
        /// The time of the frame before.
        last_timestamp_ns: i64,
    },
    /// The number does not go up.
    #[error("sequence {sequence} is not after the last frame's {last_sequence}")]
    SequenceNotIncreasing {
        /// The frame's number.
        sequence: u64,
        /// The number of the frame before.
        last_sequence: u64,
    },
}

impl Frame {
    /// Whether the frame can follow the last one, given as its number and time, in a stream of the camera's
    /// images.
    pub(crate) fn check(&self, camera: &Camera, last_frame: Option<(u64, i64)>) -> Result<(), FrameError> {
        let (width, height) = (self.image.width(), self.image.height());
        let (expected_width, expected_height) = (camera.width(), camera.height());
        if (width, height) != (expected_width, expected_height) {
            return Err(FrameError::WrongImageSize { width, height, expected_width, expected_height });
        }
        let Some((last_sequence, last_timestamp_ns)) = last_frame else { return Ok(()) };
        let (sequence, timestamp_ns) = (self.sequence, self.timestamp_ns);
        if sequence <= last_sequence {
            return Err(FrameError::SequenceNotIncreasing { sequence, last_sequence });
        }
        if timestamp_ns <= last_timestamp_ns {
            return Err(FrameError::TimestampNotIncreasing { timestamp_ns, last_timestamp_ns });
        }
        Ok(())
    }
}

/// What of a camera's images is not the scene, and how that is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneMask {
    /// What is left out, for images of any size and the camera's proportions.
    pub mask: Arc<Mask>,
    /// Whether it was given with the session; else it was found.
    pub is_given: bool,
}

/// What a stored session is taken up with.
#[derive(Clone, Debug, Default)]
pub struct ResumeState {
    /// The stored map; empty if there was none yet.
    pub map: MapParts,
    /// Number and time of the last stored frame.
    pub last_frame: Option<(u64, i64)>,
    /// What of the images is known not to be the scene.
    pub mask: Option<SceneMask>,
}

/// Why a stored session cannot be taken up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ResumeError {
    /// The configuration cannot be used.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The stored map is inconsistent.
    #[error(transparent)]
    Map(#[from] MapError),
}
