//! The SLAM system: images of one camera in, poses and a map out.
//!
//! Start reading at [`Pipeline`]. It does no I/O and reads no clock; time and seeds come in as arguments.

pub mod clock;
pub mod config;
pub mod features;
pub mod map;
pub mod pipeline;
pub mod report;

pub use clock::{Clock, NoClock};
pub use config::{ConfigError, SlamConfig, Threading};
pub use map::{Keyframe, Map, MapUpdate};
pub use pipeline::{Frame, FrameError, Pipeline, ResumeError, ResumeState};
pub use report::{FrameReport, InitialisationWait, LostReason, TrackingOutcome};
