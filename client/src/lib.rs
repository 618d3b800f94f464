//! Client library of the SLAM service: readers for the usual recordings and the measures of a trajectory.
//!
//! * [`dataset::Recording`]: a folder of images with its calibration, whatever its layout.
//! * [`Trajectory`]: stamped camera poses, read from TUM, EuRoC and KITTI files.
//! * [`evaluation::evaluate`]: how far an estimated trajectory is from the true one.
//!
//! ```
//! use client::{Trajectory, evaluation::{evaluate, EvaluationOptions}};
//!
//! let truth = Trajectory::parse_tum("0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n0.2 1 1 0 0 0 0 1\n")?;
//! let twice = Trajectory::parse_tum("0.0 5 0 0 0 0 0 1\n0.1 7 0 0 0 0 0 1\n0.2 7 2 0 0 0 0 1\n")?;
//! let evaluation = evaluate(&truth, &twice, &EvaluationOptions::default())?;
//! assert!(evaluation.ate_rmse < 1e-12);
//! assert!((evaluation.scale - 0.5).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod dataset;
pub mod evaluation;

mod files;
mod time;
mod trajectory;

pub use files::FileError;
pub use time::{format_seconds, parse_seconds_ns};
pub use trajectory::{StampedPose, Trajectory};
