//! Start here: one frame in, one report out.

use crate::clock::Clock;
use crate::config::{ConfigError, SlamConfig};
use crate::map::{Map, MapError, MapParts, MapUpdate};
use crate::report::FrameReport;
use geometry::Camera;
use std::sync::Arc;
use vision::GrayImage;

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
    #[error("the image is {width}x{height} pixels but the session's camera is {expected_width}x{expected_height}")]
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

/// What a stored session is taken up with.
#[derive(Clone, Debug, Default)]
pub struct ResumeState {
    /// The stored map; empty if there was none yet.
    pub map: MapParts,
    /// Number and time of the last stored frame.
    pub last_frame: Option<(u64, i64)>,
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

/// A monocular SLAM session: frames in, reports and map updates out.
pub struct Pipeline {
    config: SlamConfig,
    camera: Camera,
    clock: Arc<dyn Clock>,
    map: Arc<Map>,
}

impl Pipeline {
    /// A session without a map.
    ///
    /// # Errors
    /// [`ConfigError`] names the field of the configuration that cannot be used.
    pub fn new(config: SlamConfig, camera: Camera, clock: Arc<dyn Clock>) -> Result<Self, ConfigError> {
        Self::resume(config, camera, clock, ResumeState::default()).map_err(|error| match error {
            ResumeError::Config(error) => error,
            ResumeError::Map(_) => unreachable!("an empty map is consistent"),
        })
    }

    /// A session that goes on with a stored map: it relocalises in it and continues.
    ///
    /// # Errors
    /// If the configuration cannot be used or the stored map is inconsistent.
    pub fn resume(
        config: SlamConfig,
        camera: Camera,
        clock: Arc<dyn Clock>,
        state: ResumeState,
    ) -> Result<Self, ResumeError> {
        config.validate()?;
        let map = Arc::new(Map::from_parts(state.map)?);
        Ok(Self { config, camera, clock, map })
    }

    /// Tracks one frame and, where it is worth it, extends the map.
    ///
    /// # Errors
    /// If the frame cannot be used; the session is as it was before.
    pub fn process_frame(&mut self, frame: Frame) -> Result<FrameReport, FrameError> {
        let _ = (&self.config, &self.camera, &self.clock, frame);
        todo!()
    }

    /// The map updates that are ready to be stored, oldest first. Call after each frame.
    pub fn take_updates(&mut self) -> Vec<MapUpdate> {
        Vec::new()
    }

    /// Lets mapping finish what it has begun and hands out every frame not yet in an update.
    pub fn finish(&mut self) -> Vec<MapUpdate> {
        Vec::new()
    }

    /// Whether frames may change the map (the default) or only be located in it.
    pub fn set_mapping(&mut self, enabled: bool) {
        let _ = enabled;
    }

    /// How tracking waits for mapping: `true` (the default) waits rather than leave a needed key frame out,
    /// `false` never waits.
    pub fn set_lossless(&mut self, lossless: bool) {
        let _ = lossless;
    }

    /// The newest consistent state of the map.
    pub fn map(&self) -> Arc<Map> {
        self.map.clone()
    }
}
