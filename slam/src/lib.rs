//! The engine: monocular SLAM with points, lines and vanishing directions. Images of one camera in, poses and
//! a map out.
//!
//! * [`Pipeline`]: one frame in, one [`FrameReport`] out. Start reading at [`Pipeline::process_frame`].
//! * [`Map`]: keyframes, map points, map lines and global primitives; a value, of which readers get
//!   snapshots.
//! * [`SlamConfig`]: every threshold, with its default, unit and reason.
//!
//! The stages: feature extraction, initialization, tracking, local mapping, bundle adjustment,
//! self-calibration, loop closing, relocalization. What they compute is in `docs/method.md`, which comments
//! cite by heading.
//!
//! The engine does no I/O, reads no clock and owns no random numbers: time and seeds come in as arguments.
//! With [`Threading::Inline`] the same frames give the same bytes.
//!
//! # The engine without the server
//!
//! ```
//! use slam::{Frame, NoClock, Pipeline, SlamConfig, Threading};
//! use std::sync::Arc;
//! use synthetic::{Preset, Sequence};
//! use vision::GrayImage;
//!
//! // A rendered room stands for a camera: its calibration, and an image for every time.
//! let room = Sequence::preset(Preset::RoomRich, 1);
//! let config = SlamConfig { threading: Threading::Inline, ..SlamConfig::default() };
//! let mut pipeline = Pipeline::new(config, room.camera().clone(), Arc::new(NoClock))?;
//! let mut n_placed = 0;
//! for index in (0..60).step_by(2) {
//!     let rendered = room.frame(index).image;
//!     let image = GrayImage::from_raw(rendered.width(), rendered.height(), rendered.into_pixels())?;
//!     let frame = Frame { sequence: index as u64, timestamp_ns: room.timestamp_ns(index), image };
//!     let report = pipeline.process_frame(frame)?;
//!     match report.world_from_camera {
//!         Some(pose) => println!("frame {index} at {:.3?}", pose.translation.as_slice()),
//!         None => println!("frame {index}: {}", report.outcome.reason()),
//!     }
//!     n_placed += usize::from(report.world_from_camera.is_some());
//! }
//! // What is to be stored, in order: each update names the rows that changed.
//! let updates = pipeline.finish();
//! let map = pipeline.map();
//! assert!(n_placed > 0 && !updates.is_empty() && map.n_keyframes() >= 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backfill;
pub mod bundle;
pub mod clock;
pub mod config;
mod continuity;
mod cores;
pub mod features;
mod frame_result;
mod front_end;
mod initialization;
mod input;
mod keyframe_index;
mod landmarks;
mod localization;
mod loops;
mod maintenance;
pub mod map;
mod mapping;
mod matching;
mod parallel;
pub mod pipeline;
pub mod report;
mod rolling_shutter;
mod submaps;
#[cfg(test)]
mod test_fixtures;
mod tracking;
mod trajectory;
mod vanishing;
mod work;

pub use clock::{Clock, NoClock};
pub use config::{
    AlignmentConfig, CalibrationConfig, CalibrationTrust, ConfigError, ContinuityConfig, FeatureSwitches,
    InitializationConfig, KeyframeConfig, LineConfig, LoopConfig, MappingConfig, PrimitiveConfig,
    RelocalizationConfig, RollingShutterConfig, SlamConfig, SubmapConfig, Threading, TrackingConfig,
};
pub use cores::{Cores, Joined as CoresJoined};
pub use input::{Frame, FrameError, ResumeError, ResumeState, SceneMask};
pub use localization::{Found, LocalizeCamera, Localizer, Near};
pub use loops::{KeyframeTies, essential_edges};
pub use maintenance::{Joined, Merged, Optimized, PlacedFrame, Recordings, merge, optimize};
pub use map::{Keyframe, Map, MapUpdate};
pub use pipeline::{JoinState, Pipeline, SharedMap};
pub use report::{
    FrameReport, InitializationWait, LineJudgement, LineVerdict, LostReason, MapEvent, ObservedFrame,
    PoseUncertainty, TrackingOutcome,
};
pub use work::Work;
