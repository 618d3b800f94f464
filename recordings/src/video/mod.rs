//! Videos and cameras, through an installed `ffmpeg`, and streams of images on a pipe.
//!
//! A video's frames are turned as its rotation tag says, come at the times of the container (a frame rate is
//! not assumed to be constant), and are gray.

mod ffmpeg;
mod log;
mod pipe;

pub use ffmpeg::{Ffmpeg, VideoInput, VideoReader};
pub use pipe::{FrameTimes, GrayReader, MjpegReader, read_pipe};

/// Largest image that is read, pixels: what no camera has is a mistake or an attack.
const MAX_PIXELS: u64 = 1 << 27;
