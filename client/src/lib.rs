//! Client library of the SLAM service: streams recordings into sessions, fetches trajectories, and measures them.
//!
//! * [`SlamClient`]: the typed client of the gRPC service; [`HttpClient`] fetches trajectories.
//! * [`stream_frames`]: streams a [`FrameSource`], such as a [`dataset::Recording`], until every frame is
//!   answered and saved, across broken connections.
//! * [`Trajectory`] and [`evaluation::evaluate`]: how far an estimated trajectory is from the true one.
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

mod convert;
mod error;
mod files;
mod grpc;
mod http;
mod pacing;
mod placement;
mod source;
mod streaming;
mod summary;
mod time;
mod trajectory;

pub use convert::camera_message;
pub use error::ClientError;
pub use files::{FileError, count_data_lines};
pub use grpc::{Answers, FrameSender, FrameStream, HTTP_PORT_HEADER, SlamClient};
pub use http::{HttpClient, TrajectoryFormat, TrajectoryKind};
pub use pacing::Pacing;
pub use placement::{Placement, SessionEnd};
pub use source::{FrameSource, ReadyFrame, read_ahead};
pub use streaming::{StreamEvent, StreamPlan, stream_frames};
pub use summary::{CameraFinding, Distribution, FrameAnswer, StageSummary, StreamSummary};
pub use time::{format_seconds, parse_seconds_ns};
pub use trajectory::{StampedPose, Trajectory};
