//! The SLAM system: images of one camera in, poses and a map out.
//!
//! Start reading at [`Pipeline`]. It does no I/O and reads no clock; time and seeds come in as arguments.

mod backfill;
pub mod bundle;
pub mod clock;
pub mod config;
mod continuity;
pub mod features;
mod frame_result;
mod front_end;
mod initialisation;
mod input;
mod landmarks;
mod loops;
pub mod map;
mod mapping;
mod matching;
mod parallel;
pub mod pipeline;
mod places;
pub mod report;
mod submaps;
#[cfg(test)]
mod test_fixtures;
mod tracking;
mod trajectory;
mod vanishing;

pub use clock::{Clock, NoClock};
pub use config::{
    AlignmentConfig, ConfigError, ContinuityConfig, FeatureSwitches, InitialisationConfig, KeyframeConfig,
    LineConfig, LoopConfig, MappingConfig, PrimitiveConfig, RelocalisationConfig, SlamConfig, SubmapConfig,
    Threading, TrackingConfig,
};
pub use input::{Frame, FrameError, ResumeError, ResumeState};
pub use loops::{KeyframeTies, essential_edges};
pub use map::{Keyframe, Map, MapUpdate};
pub use pipeline::Pipeline;
pub use report::{
    FrameReport, InitialisationWait, LineJudgement, LineVerdict, LostReason, MapEvent, PoseUncertainty,
    TrackingOutcome,
};
