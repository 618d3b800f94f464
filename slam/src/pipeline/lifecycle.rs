//! Opening, resuming and ending a session, and what it is asked for between frames.

use super::repeated::LastImage;
use super::{JoinState, Pipeline, SharedMap};
use crate::backfill::Backfill;
use crate::clock::Clock;
use crate::config::SlamConfig;
use crate::cores;
use crate::front_end::{CameraState, FrontEnd};
use crate::initialization::Initializer;
use crate::input::{ResumeError, ResumeState, SceneMask};
use crate::map::{CameraId, Map, MapCamera, MapUpdate};
use crate::mapping::Mapper;
use crate::report::{LineJudgement, ObservedFrame};
use crate::rolling_shutter::RollingShutter;
use crate::submaps::SubmapPolicy;
use crate::tracking::Tracker;
use crate::trajectory::TrajectoryLog;
use geometry::Camera;
use std::sync::Arc;
use vision::GrayImage;
use vision::mask::{Mask, black_border};

/// Bits of a track's number below its camera's: at a thousand new tracks a frame they last for a year.
const TRACK_BITS: u32 = 40;

impl Pipeline {
    /// A session without a map.
    ///
    /// # Errors
    /// If the configuration cannot be used; the error names the field.
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
        let ResumeState { map, last_frame, mask } = state;
        let map = SharedMap::resume(config.clone(), &camera, map)?;
        Self::join(&map, MapCamera::default(), (config, camera), clock, JoinState { last_frame, mask })
    }

    /// A session whose camera extends a map, beside others that may do so too. One that was added, and has
    /// not been placed yet, is looked for in the map, and after a while begins a submap of its own beside it;
    /// the two become one where they meet.
    ///
    /// An added camera works with images as they are, also where a border leaves little of them
    /// ([`SlamConfig::enlarge_for_border`]).
    ///
    /// # Errors
    /// If the configuration cannot be used.
    pub fn join(
        map: &SharedMap,
        map_camera: MapCamera,
        (config, camera): (SlamConfig, Camera),
        clock: Arc<dyn Clock>,
        state: JoinState,
    ) -> Result<Self, ResumeError> {
        let is_added = map_camera.id != CameraId::default();
        let config = if is_added { config.of_added_camera() } else { config };
        config.validate()?;
        let mapping = map.core.stage_of(map_camera.id);
        let map = mapping.newest_map();
        let mut front_end = FrontEnd::new(&config, &camera, first_track(&map, map_camera.id), state.mask)?;
        front_end.correct_camera(map.correction_of(map_camera));
        let working_camera = config.working_camera(&camera);
        let rolling_shutter = RollingShutter::of(&working_camera, readout_ns(&config, &map, map_camera));
        let mut tracker = Tracker::new(config.clone(), map_camera, working_camera, rolling_shutter.clone())?;
        tracker.sync_map(&map);
        let is_empty = map.n_keyframes() == 0;
        let submaps = if is_added {
            SubmapPolicy::beside(config.submaps.clone(), mapping.core().submap_numbers())
        } else {
            SubmapPolicy::resume(config.submaps.clone(), &map)
        };
        let mut pipeline = Self {
            camera,
            map_camera,
            clock,
            front_end,
            mapping,
            tracker,
            initializer: is_empty.then(|| Initializer::new(&config, !is_added, rolling_shutter.clone())),
            backfill: Backfill::new(config.clone(), map_camera, rolling_shutter.clone()),
            submaps,
            trajectory: TrajectoryLog::default(),
            is_camera_wrong: map.is_contradicted() && map_camera.is_refined,
            map,
            last_frame: state.last_frame,
            last_view: None,
            last_image: LastImage::default(),
            mapping_enabled: true,
            lossless: true,
            has_resolution: is_added || !is_empty,
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
        match self.enlarged() {
            Ok(Some(anew)) => {
                let (mapping_enabled, lossless) = (self.mapping_enabled, self.lossless);
                *self = Self { mapping_enabled, lossless, has_resolution: true, ..anew };
            }
            // Another camera has begun the map meanwhile.
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, "images are worked on as they are"),
        }
    }

    /// The same session of images that are enlarged for their border; `None` if there is a map already.
    fn enlarged(&mut self) -> Result<Option<Self>, ResumeError> {
        let config = SlamConfig { enlarge_for_border: true, ..self.config.clone() };
        config.validate()?;
        let mapper = Mapper::new(config.clone(), &config.working_camera(&self.camera), Map::default())?;
        let state = JoinState { last_frame: self.last_frame, mask: self.mask().cloned() };
        let map = SharedMap { core: self.mapping.core().clone(), share: None };
        let camera = (config, self.camera.clone());
        let anew = Self::join(&map, self.map_camera, camera, self.clock.clone(), state)?;
        Ok(self.mapping.replace(mapper).then_some(anew))
    }

    /// The map updates that are ready to be stored, oldest first. Call after each frame. Where several
    /// cameras extend the map they are those of all, in one order: whoever takes them hands them on before
    /// another takes the next.
    pub fn take_updates(&mut self) -> Vec<MapUpdate> {
        self.mapping.take_updates()
    }

    /// What mapping made of candidate lines since this was last called, oldest first; if that was long ago,
    /// the newest.
    pub fn take_line_judgements(&mut self) -> Vec<LineJudgement> {
        self.mapping.take_line_judgements()
    }

    /// Lets mapping finish what it has begun and hands out every frame not yet in an update. While other
    /// cameras of the map go on, what a recording's end brings about waits for the end of theirs.
    pub fn finish(&mut self) -> Vec<MapUpdate> {
        self.settle();
        self.take_updates()
    }

    /// As [`Self::finish`]; what there is to store is to be [taken](Self::take_updates) yet.
    pub fn settle(&mut self) {
        self.mapping.settle();
        self.sync_map();
        while !self.backfill.is_done(&self.map) {
            let placed = cores::with_turn(|| self.backfill.step(&self.map, true));
            self.trajectory.backfill(placed);
        }
        self.flush_records();
        self.mapping.wait();
        self.sync_map();
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
        let shutter =
            RollingShutter::of(&working_camera, readout_ns(&self.config, &self.map, self.map_camera));
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
fn readout_ns(config: &SlamConfig, map: &Map, camera: MapCamera) -> i64 {
    let found = map.readout().filter(|_| camera.is_refined).map_or(0, |readout| readout.readout_ns);
    config.rolling_shutter.readout_ns.unwrap_or(found)
}

/// Where a camera's tracks of lines begin. Numbers of tracks begin anew with each run and must not meet those
/// of stored keyframes; those of different cameras are ranges of their own.
fn first_track(map: &Map, camera: CameraId) -> u64 {
    let own = map.keyframes().filter(|keyframe| keyframe.camera.id == camera);
    let tracks = own.flat_map(|keyframe| &keyframe.features.lines).map(|segment| segment.track + 1);
    tracks.max().unwrap_or(0).max(u64::from(camera.0) << TRACK_BITS)
}
