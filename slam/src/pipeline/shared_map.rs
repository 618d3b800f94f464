//! A map that several cameras extend at the same time, each with a [`Pipeline`](super::Pipeline) on a thread
//! of its own.
//!
//! What belongs to a camera is in its pipeline: front end, tracking, what is known of a lost camera,
//! trajectory. What belongs to the map is here: the map itself, which mapping owns as it always does, and the
//! numbers of keyframes and submaps. Pipelines read snapshots and send requests; they never wait for each
//! other but where mapping has one keyframe to take in before the next.

use crate::config::{ConfigError, SlamConfig, Threading};
use crate::cores::{Joined, Share};
use crate::input::{ResumeError, SceneMask};
use crate::map::{Map, MapParts};
use crate::mapping::Mapper;
use crate::mapping::stage::MappingCore;
use geometry::Camera;
use std::sync::Arc;

/// See the module's documentation. Clones are of the same map; it lives while one of them or a pipeline does.
#[derive(Clone)]
pub struct SharedMap {
    pub(super) core: MappingCore,
    /// That of the thread that took it up.
    pub(super) share: Option<Share>,
}

/// What one camera of a map is taken up with.
#[derive(Clone, Debug, Default)]
pub struct JoinState {
    /// Number and time of its last stored frame.
    pub last_frame: Option<(u64, i64)>,
    /// What of its images is known not to be the scene.
    pub mask: Option<SceneMask>,
}

impl SharedMap {
    /// Takes a stored map up, or begins one. `camera` is the map's own, whose calibration may be refined, and
    /// `config` that of its session: mapping runs by it.
    ///
    /// # Errors
    /// If the configuration cannot be used or the stored map is inconsistent.
    pub fn resume(config: SlamConfig, camera: &Camera, stored: MapParts) -> Result<Self, ResumeError> {
        config.validate()?;
        let map = Map::from_parts(stored)?;
        let (threading, working_camera) = (config.threading, config.working_camera(camera));
        let mapper = Mapper::new(config, &working_camera, map)?;
        let core = match threading {
            Threading::Inline => MappingCore::inline(mapper),
            Threading::Background => MappingCore::background(mapper).map_err(|error| ConfigError {
                field: "threading",
                reason: format!("the mapping thread cannot be started: {error}"),
            })?,
        };
        Ok(Self { core, share: Share::of_this_thread() })
    }

    /// Has this thread work for the map, whose cameras have one share of the [cores](crate::Cores) together:
    /// that of the thread which took the map up.
    pub fn enter(&self) -> Option<Joined> {
        self.share.clone().map(Share::enter)
    }

    /// The newest consistent state of the map.
    pub fn map(&self) -> Arc<Map> {
        self.core.newest_map()
    }
}
