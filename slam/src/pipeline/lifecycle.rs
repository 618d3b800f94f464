//! Opening, resuming and ending a session, and what it is asked for between frames.

use super::Pipeline;
use crate::backfill::Backfill;
use crate::clock::Clock;
use crate::config::{ConfigError, SlamConfig, Threading};
use crate::cores;
use crate::front_end::{CameraState, FrontEnd};
use crate::initialization::Initializer;
use crate::input::{ResumeError, ResumeState, SceneMask};
use crate::map::{Map, MapUpdate};
use crate::mapping::Mapper;
use crate::mapping::stage::MappingStage;
use crate::report::{LineJudgement, ObservedFrame};
use crate::rolling_shutter::RollingShutter;
use crate::submaps::SubmapPolicy;
use crate::tracking::Tracker;
use crate::trajectory::TrajectoryLog;
use geometry::Camera;
use std::sync::Arc;
use vision::GrayImage;
use vision::mask::{Mask, black_border};

impl Pipeline {
    /// A session without a map.
    ///
    /// # Errors
    /// [`ConfigError`] names the field of the configuration that cannot be used.
    pub fn new(config: SlamConfig, camera: Camera, clock: Arc<dyn Clock>) -> Result<Self, ResumeError> {
        Self::resume(config, camera, clock, ResumeState::default())
    }

    /// A session that goes on with a stored map: it relocalizes in it and continues.
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
        let map = Map::from_parts(state.map)?;
        // Numbers of tracks begin anew with each run and must not meet those of stored keyframes.
        let segments = map.keyframes().flat_map(|keyframe| &keyframe.features.lines);
        let first_track = segments.map(|segment| segment.track + 1).max().unwrap_or(0);
        let mut front_end = FrontEnd::new(&config, &camera, first_track, state.mask)?;
        front_end.correct_camera(map.correction());
        let working_camera = config.working_camera(&camera);
        let mapper = Mapper::new(config.clone(), &working_camera, map.clone())?;
        let mapping = match config.threading {
            Threading::Inline => MappingStage::inline(mapper),
            Threading::Background => MappingStage::background(mapper).map_err(|error| ConfigError {
                field: "threading",
                reason: format!("the mapping thread cannot be started: {error}"),
            })?,
        };
        let rolling_shutter = RollingShutter::of(&working_camera, readout_ns(&config, &map));
        let mut tracker = Tracker::new(config.clone(), working_camera, rolling_shutter.clone())?;
        tracker.sync_map(&map);
        let is_empty = map.n_keyframes() == 0;
        let is_camera_wrong = map.is_contradicted();
        let mut pipeline = Self {
            camera,
            clock,
            front_end,
            mapping,
            tracker,
            initializer: is_empty.then(|| Initializer::new(&config, true, rolling_shutter.clone())),
            backfill: Backfill::new(config.clone(), rolling_shutter.clone()),
            submaps: SubmapPolicy::resume(config.submaps.clone(), &map),
            trajectory: TrajectoryLog::default(),
            next_keyframe_idx: map.last_ids().keyframe,
            map: Arc::new(map),
            last_frame: state.last_frame,
            last_view: None,
            is_camera_wrong,
            mapping_enabled: true,
            lossless: true,
            has_resolution: !is_empty,
            rolling_shutter,
            config,
        };
        pipeline.choose_n_features();
        Ok(pipeline)
    }

    /// With the first image that shows something, before there is a map: decides whether a border leaves so
    /// little of the images that they are worked on enlarged, as small ones are.
    pub(super) fn choose_resolution(&mut self, image: &GrayImage) {
        if self.has_resolution {
            return;
        }
        let border = black_border(image);
        let given = self.mask().map(|known| known.mask.resized(image.width(), image.height()));
        let used = Mask::from_fn(image.width(), image.height(), |x, y| {
            border.leaves_out(x, y) || given.as_ref().is_some_and(|given| given.leaves_out(x, y))
        });
        let Some([(left, top), (right, bottom)]) = used.used_box() else { return };
        self.has_resolution = true;
        let is_enlarged = self.config.is_enlarged_for(&self.camera, (right - left) * (bottom - top));
        if !is_enlarged || self.config.enlarge_for_border || self.map.n_keyframes() > 0 {
            return;
        }
        let config = SlamConfig { enlarge_for_border: true, ..self.config.clone() };
        let (last_frame, mask) = (self.last_frame, self.mask().cloned());
        let state = ResumeState { last_frame, mask, ..ResumeState::default() };
        match Self::resume(config, self.camera.clone(), self.clock.clone(), state) {
            Ok(anew) => {
                let (mapping_enabled, lossless) = (self.mapping_enabled, self.lossless);
                *self = Self { mapping_enabled, lossless, has_resolution: true, ..anew };
            }
            Err(error) => tracing::warn!(%error, "images are worked on as they are"),
        }
    }

    /// The map updates that are ready to be stored, oldest first. Call after each frame.
    pub fn take_updates(&mut self) -> Vec<MapUpdate> {
        self.mapping.take_updates()
    }

    /// What mapping made of candidate lines since this was last called, oldest first; if that was long ago,
    /// the newest.
    pub fn take_line_judgements(&mut self) -> Vec<LineJudgement> {
        self.mapping.take_line_judgements()
    }

    /// Lets mapping finish what it has begun and hands out every frame not yet in an update.
    pub fn finish(&mut self) -> Vec<MapUpdate> {
        self.mapping.settle();
        self.sync_map();
        while !self.backfill.is_done(&self.map) {
            let placed = cores::with_turn(|| self.backfill.step(&self.map, true));
            self.trajectory.backfill(placed);
        }
        self.flush_records();
        self.mapping.wait();
        self.sync_map();
        self.take_updates()
    }

    /// Whether frames may change the map (the default) or only be located in it.
    pub fn set_mapping(&mut self, enabled: bool) {
        self.mapping_enabled = enabled;
    }

    /// How tracking waits for mapping: `true` (the default) lets it finish before each frame, while the
    /// frame's features are looked for, and leaves no keyframe out; `false` never waits.
    pub fn set_lossless(&mut self, lossless: bool) {
        self.lossless = lossless;
    }

    /// The newest consistent state of the map.
    pub fn map(&self) -> Arc<Map> {
        self.mapping.newest_map()
    }

    /// What of the camera's images is left out because it is not the scene.
    pub fn mask(&self) -> Option<&SceneMask> {
        self.front_end.mask()
    }

    /// What the last frame measured and what of it was recognized; `None` before the first.
    pub fn observed(&self) -> Option<ObservedFrame> {
        let view = self.last_view.as_ref()?;
        let (sequence, features) = (view.sequence, view.features.clone());
        let recognized = self.tracker.last_frame().filter(|frame| frame.sequence == sequence);
        let (n_points, n_segments) = (features.len(), features.lines.len());
        Some(match recognized {
            Some(frame) => ObservedFrame {
                sequence,
                features,
                points: frame.points.clone(),
                lines: frame.lines.clone(),
                primitives: frame.primitives.clone(),
            },
            None => ObservedFrame {
                sequence,
                features,
                points: vec![None; n_points],
                lines: vec![None; n_segments],
                primitives: vec![None; n_segments],
            },
        })
    }

    /// Has what was found of the camera's shutter be taken out of what follows.
    pub(super) fn sync_rolling_shutter(&mut self) {
        let working_camera = self.config.working_camera(&self.camera);
        let shutter = RollingShutter::of(&working_camera, readout_ns(&self.config, &self.map));
        self.tracker.set_rolling_shutter(shutter.clone());
        self.backfill.set_rolling_shutter(shutter.clone());
        if let Some(initializer) = &mut self.initializer {
            initializer.set_rolling_shutter(shutter.clone());
        }
        self.rolling_shutter = shutter;
    }

    /// Matches are scarce before there is a map, so more features are asked for.
    pub(super) fn choose_n_features(&mut self) {
        let n_features = match &self.initializer {
            Some(_) => self.config.initialization.n_features.max(self.config.orb.n_features),
            None => self.config.orb.n_features,
        };
        self.front_end.set_n_features(n_features);
    }

    pub(super) fn camera_state(&self) -> CameraState {
        if self.tracker.last_frame().is_some() {
            CameraState::Followed
        } else if self.initializer.is_some() {
            CameraState::Beginning
        } else {
            CameraState::Lost
        }
    }
}

/// The readout as it was told, or as it was found; 0 until then.
fn readout_ns(config: &SlamConfig, map: &Map) -> i64 {
    let found = map.readout().map_or(0, |readout| readout.readout_ns);
    config.rolling_shutter.readout_ns.unwrap_or(found)
}
