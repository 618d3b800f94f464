//! Recordings and trajectories on disk, and how far an estimated trajectory is from the true one.
//!
//! * [`Recording`]: a folder of images with their times, calibration and ground truth, in the [`Layout`]s in
//!   use; [`find_folder`] also looks where `MONOSLAM_DATA` says that recordings are kept.
//! * [`FrameReader`]: images one after the other, from videos and cameras ([`Ffmpeg`]) and from pipes
//!   ([`read_pipe`]), MCAP files and bags (`Bag`, by
//!   the feature `bags`).
//! * [`Trajectory`]: stamped camera poses, read from and written to the usual text files.
//! * [`evaluate`]: absolute and relative errors after alignment, the figures of `evo_ape` and `evo_rpe`;
//!   [`pose_errors`]: those of each pose.
//!
//! ```
//! use recordings::{EvaluationOptions, Trajectory, evaluate};
//!
//! let truth = Trajectory::parse_tum("0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n0.2 1 1 0 0 0 0 1\n")?;
//! let twice = Trajectory::parse_tum("0.0 5 0 0 0 0 0 1\n0.1 7 0 0 0 0 0 1\n0.2 7 2 0 0 0 0 1\n")?;
//! let evaluation = evaluate(&truth, &twice, &EvaluationOptions::default())?;
//! assert!(evaluation.ate_rmse < 1e-12);
//! assert!((evaluation.scale - 0.5).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "bags")]
mod bag;
mod calibration;
mod data;
mod dataset;
mod evaluation;
mod files;
mod frames;
mod text;
mod time;
mod trajectory;
mod units;
mod video;
mod yaml;

#[cfg(feature = "bags")]
pub use bag::{Bag, BagReader};
pub use calibration::read_calibration;
pub use data::{DATA_VARIABLE, find_folder};
pub use dataset::{CameraOfSize, FrameFile, Layout, OpenOptions, Playback, Recording};
pub use evaluation::{
    Alignment, Evaluation, EvaluationError, EvaluationOptions, Match, PoseError, SegmentErrors, TimeOffset,
    associate, evaluate, find_offset, hints, pose_errors,
};
pub use files::{FileError, read_times};
pub use frames::{FrameImage, FrameReader, PixelFormat, RawImage, TimedFrame};
pub use time::{format_seconds, parse_seconds_ns};
pub use trajectory::{ReadTrajectory, StampedPose, Trajectory};
pub use units::TimeUnit;
pub use video::{Ffmpeg, FrameTimes, GrayReader, MjpegReader, VideoInput, VideoReader, read_pipe};
