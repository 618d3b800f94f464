//! Start here: one frame in, one report out.

use crate::backfill::Backfill;
use crate::clock::{Clock, Stopwatch};
use crate::config::{ConfigError, SlamConfig, Threading};
use crate::features::View;
use crate::front_end::FrontEnd;
use crate::initialisation::{InitialPair, Initialiser};
use crate::input::{Frame, FrameError, ResumeError, ResumeState};
use crate::map::{FramePose, FrameRecord, FrameState, KeyframeId, Map, MapUpdate, SubmapId};
use crate::mapping::stage::MappingStage;
use crate::mapping::{InitialMap, Mapper, NewKeyframe};
use crate::report::{FrameReport, InitialisationWait, LineJudgement, LostReason, TrackingOutcome};
use crate::tracking::frame::{Inliers, TrackedFrame};
use crate::tracking::{Tracked, Tracker};
use geometry::{Camera, Pose};
use std::sync::Arc;
use vision::lines::LineTrackingStatistics;

/// Frames without a key frame after which the trajectory so far is handed out to be stored.
const MAX_UNRECORDED_FRAMES: usize = 30;

/// A monocular SLAM session: frames in, reports and map updates out.
///
/// One frame passes through `extract`, then `track` or, while there is no map to follow, `initialise`, then `extend` (a
/// frame that shows something new becomes a key frame, and mapping takes it from there). A camera that is lost for long
/// begins a new submap, while it is still looked for in the others; mapping joins the submaps where they meet.
pub struct Pipeline {
    config: SlamConfig,
    camera: Camera,
    clock: Arc<dyn Clock>,
    front_end: FrontEnd,
    mapping: MappingStage,
    /// The map as tracking sees it at present.
    map: Arc<Map>,
    tracker: Tracker,
    /// Present while there is no map to follow.
    initialiser: Option<Initialiser>,
    backfill: Backfill,
    /// The submap the camera is followed in, or is to begin.
    submap: SubmapId,
    /// The highest submap so far; its number is not given to another.
    last_submap: SubmapId,
    /// Time of the first frame of those without a pose until now.
    lost_since_ns: Option<i64>,
    /// Frames followed in a young submap since the others were last searched.
    n_since_search: u64,
    next_keyframe_idx: u64,
    /// Frames not yet handed to mapping to be stored with the next key frame.
    unrecorded: Vec<FrameRecord>,
    /// Frames of a map so young that it may yet be discarded.
    at_risk: Vec<FrameRecord>,
    last_frame: Option<(u64, i64)>,
    mapping_enabled: bool,
    lossless: bool,
}

/// What a frame came to, before it is put into words.
struct Verdict {
    outcome: TrackingOutcome,
    frame: Option<TrackedFrame>,
    inliers: Inliers,
    relocalised: bool,
    n_candidates: Option<usize>,
    is_keyframe: bool,
}

impl Pipeline {
    /// A session without a map.
    ///
    /// # Errors
    /// [`ConfigError`] names the field of the configuration that cannot be used.
    pub fn new(config: SlamConfig, camera: Camera, clock: Arc<dyn Clock>) -> Result<Self, ResumeError> {
        Self::resume(config, camera, clock, ResumeState::default())
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
        let map = Map::from_parts(state.map)?;
        // Numbers of tracks begin anew with each run and must not meet those of stored key frames.
        let segments = map.keyframes().flat_map(|keyframe| &keyframe.features.lines);
        let first_track = segments.map(|segment| segment.track + 1).max().unwrap_or(0);
        let mut front_end = FrontEnd::new(&config, &camera, first_track)?;
        front_end.correct_camera(map.correction());
        let mapper = Mapper::new(config.clone(), map.clone())?;
        let mapping = match config.threading {
            Threading::Inline => MappingStage::inline(mapper),
            Threading::Background => MappingStage::background(mapper).map_err(|error| ConfigError {
                field: "threading",
                reason: format!("the mapping thread cannot be started: {error}"),
            })?,
        };
        let mut tracker = Tracker::new(config.clone(), config.working_camera(&camera))?;
        tracker.adopt(&map);
        let is_empty = map.n_keyframes() == 0;
        let mut pipeline = Self {
            camera,
            clock,
            front_end,
            mapping,
            tracker,
            initialiser: is_empty.then(|| Initialiser::new(&config)),
            backfill: Backfill::new(config.clone()),
            submap: map.submaps().last().copied().unwrap_or_default(),
            last_submap: map.submaps().last().copied().unwrap_or_default(),
            lost_since_ns: None,
            n_since_search: 0,
            next_keyframe_idx: map.last_ids().keyframe,
            map: Arc::new(map),
            unrecorded: Vec::new(),
            at_risk: Vec::new(),
            last_frame: state.last_frame,
            mapping_enabled: true,
            lossless: true,
            config,
        };
        pipeline.choose_n_features();
        Ok(pipeline)
    }

    /// Tracks one frame and, where it is worth it, extends the map.
    ///
    /// # Errors
    /// If the frame cannot be used; the session is as it was before.
    pub fn process_frame(&mut self, frame: Frame) -> Result<FrameReport, FrameError> {
        self.check(&frame)?;
        self.last_frame = Some((frame.sequence, frame.timestamp_ns));
        let mut stopwatch = Stopwatch::start(self.clock.clone());

        let (mut view, line_statistics) = self.extract(frame, &mut stopwatch);
        // A stream that comes as fast as it is taken would run ahead of the map, further than any camera does: where new texture
        // is all there is, what the newest key frames add decides the scale.
        if self.lossless {
            self.mapping.wait();
        }
        self.adopt_map();
        view.adopt(&self.map.correction());
        stopwatch.lap("adopt");
        let mut verdict = self.track(&view);
        stopwatch.lap(if verdict.n_candidates.is_some() { "relocalise" } else { "track" });
        if verdict.frame.is_none() && self.initialiser.is_some() {
            verdict = self.initialise(&view, verdict.n_candidates);
            stopwatch.lap("initialise");
        }
        self.record(&view, &verdict);
        verdict.is_keyframe |= self.extend(&verdict);
        stopwatch.lap("extend");
        self.step_backfill(&view, &verdict);
        stopwatch.lap("backfill");

        Ok(self.report(&view, verdict, line_statistics, stopwatch))
    }

    /// The map updates that are ready to be stored, oldest first. Call after each frame.
    pub fn take_updates(&mut self) -> Vec<MapUpdate> {
        self.mapping.take_updates()
    }

    /// What mapping made of candidate lines since this was last called, oldest first; if that was long ago, the newest.
    pub fn take_line_judgements(&mut self) -> Vec<LineJudgement> {
        self.mapping.take_line_judgements()
    }

    /// Lets mapping finish what it has begun and hands out every frame not yet in an update.
    pub fn finish(&mut self) -> Vec<MapUpdate> {
        self.mapping.settle();
        self.adopt_map();
        while !self.backfill.is_done(&self.map) {
            self.unrecorded.extend(self.backfill.step(&self.map, true));
        }
        self.flush_records();
        self.mapping.wait();
        self.adopt_map();
        self.take_updates()
    }

    /// Whether frames may change the map (the default) or only be located in it.
    pub fn set_mapping(&mut self, enabled: bool) {
        self.mapping_enabled = enabled;
    }

    /// How tracking waits for mapping: `true` (the default) lets it finish before each frame, while the frame's features are
    /// looked for, and leaves no key frame out; `false` never waits.
    pub fn set_lossless(&mut self, lossless: bool) {
        self.lossless = lossless;
    }

    /// The newest consistent state of the map.
    pub fn map(&self) -> Arc<Map> {
        self.mapping.newest_map()
    }

    fn check(&self, frame: &Frame) -> Result<(), FrameError> {
        let (width, height) = (frame.image.width(), frame.image.height());
        let (expected_width, expected_height) = (self.camera.width(), self.camera.height());
        if (width, height) != (expected_width, expected_height) {
            return Err(FrameError::WrongImageSize { width, height, expected_width, expected_height });
        }
        let Some((last_sequence, last_timestamp_ns)) = self.last_frame else { return Ok(()) };
        if frame.sequence <= last_sequence {
            return Err(FrameError::SequenceNotIncreasing { sequence: frame.sequence, last_sequence });
        }
        if frame.timestamp_ns <= last_timestamp_ns {
            return Err(FrameError::TimestampNotIncreasing {
                timestamp_ns: frame.timestamp_ns,
                last_timestamp_ns,
            });
        }
        Ok(())
    }

    fn extract(&mut self, frame: Frame, stopwatch: &mut Stopwatch) -> (View, LineTrackingStatistics) {
        let image = Arc::new(self.front_end.working_image(frame.image));
        let rotation = self.tracker.expected_rotation(frame.timestamp_ns);
        let (features, statistics) = self.front_end.extract(&image, rotation, stopwatch);
        self.tracker.see(image);
        let (sequence, timestamp_ns) = (frame.sequence, frame.timestamp_ns);
        (View { sequence, timestamp_ns, features: Arc::new(features) }, statistics)
    }

    fn adopt_map(&mut self) {
        let newest = self.mapping.newest_map();
        if !Arc::ptr_eq(&newest, &self.map) {
            if newest.correction() != self.map.correction() {
                self.front_end.correct_camera(newest.correction());
            }
            self.map = newest;
            self.tracker.adopt(&self.map);
            self.submap = self.tracker.last_frame().map_or(self.submap, |last| last.submap);
        }
    }

    /// Tries to begin a map, or a further submap, with this view.
    fn initialise(&mut self, view: &View, n_candidates: Option<usize>) -> Verdict {
        let attempt = match &mut self.initialiser {
            Some(initialiser) if self.mapping_enabled => initialiser.try_start(view.clone()),
            _ => Err(InitialisationWait::MappingDisabled),
        };
        let verdict = match attempt {
            Err(wait) => Verdict::nowhere(TrackingOutcome::Initialising(wait)),
            Ok(pair) => self.begin_map(pair),
        };
        Verdict { n_candidates, ..verdict }
    }

    fn begin_map(&mut self, pair: InitialPair) -> Verdict {
        let inliers = Inliers { n_points: pair.points.len(), n_lines: 0 };
        let (first_id, second_id) = (self.next_keyframe_id(), self.next_keyframe_id());
        let frame_of = |view: &View, camera_from_world, reference| {
            TrackedFrame::blank(view, camera_from_world, reference, self.submap)
        };
        let first = frame_of(&pair.first, Pose::identity(), first_id);
        let mut second = frame_of(&pair.second, pair.second_from_first, second_id);
        let first_record = FrameRecord {
            sequence: first.sequence,
            timestamp_ns: first.timestamp_ns,
            state: FrameState::Tracked,
            pose: Some(FramePose {
                submap: self.submap,
                reference: first_id,
                camera_from_reference: Pose::identity(),
            }),
            backfilled: true,
        };
        let mut frames = std::mem::take(&mut self.unrecorded);
        frames.push(first_record);
        self.at_risk = vec![first_record];
        self.mapping.begin(InitialMap {
            first: first.to_keyframe(first_id, None),
            second: second.to_keyframe(second_id, Some(first_id)),
            points: pair.points,
            frames,
        });
        self.map = self.mapping.newest_map();
        if let Some(keyframe) = self.map.keyframe(second_id) {
            second.points.clone_from(&keyframe.points);
        }
        self.follow_map();
        self.tracker.adopt(&self.map);
        self.tracker.start(second.clone(), &self.map);
        Verdict {
            outcome: TrackingOutcome::Tracked,
            frame: Some(second),
            inliers,
            relocalised: false,
            n_candidates: None,
            is_keyframe: true,
        }
    }

    /// Follows the camera in the map, or looks for it there.
    fn track(&mut self, view: &View) -> Verdict {
        if self.map.n_keyframes() == 0 {
            return Verdict::nowhere(TrackingOutcome::Lost(LostReason::NotRelocalised { n_candidates: 0 }));
        }
        let was_followed = self.tracker.last_frame().is_some();
        let mut tracked = self.tracker.track(view, &self.map);
        match &tracked.frame {
            None => self.lose(view, was_followed),
            Some(frame) => {
                self.submap = frame.submap;
                self.follow_map();
                if let Some(elsewhere) = self.find_elsewhere(view) {
                    tracked = elsewhere;
                }
            }
        }
        let Tracked { outcome, frame, inliers, relocalised, n_candidates } = tracked;
        Verdict { outcome, frame, inliers, relocalised, n_candidates, is_keyframe: false }
    }

    /// Notes that there is a map to follow.
    fn follow_map(&mut self) {
        self.lost_since_ns = None;
        if self.initialiser.take().is_some() {
            self.n_since_search = 0;
            self.choose_n_features();
        }
    }

    /// While a further submap is young, looks for its frames in the others, and goes on there if one is found.
    fn find_elsewhere(&mut self, view: &View) -> Option<Tracked> {
        let has_others = self.map.keyframes().any(|keyframe| keyframe.submap != self.submap);
        if !has_others || !self.mapping_enabled || !self.is_young(self.submap) {
            return None;
        }
        self.n_since_search += 1;
        if !self.n_since_search.is_multiple_of(self.config.submaps.search_interval) {
            return None;
        }
        let found = self.tracker.find_elsewhere(view, &self.map, self.submap)?;
        self.discard_submap();
        self.submap = found.frame.as_ref().map_or(self.submap, |frame| frame.submap);
        Some(found)
    }

    /// A frame has no pose: a map that was lost before it was of any use goes at once, another is kept and in time followed
    /// by a new one.
    fn lose(&mut self, view: &View, was_followed: bool) {
        if !self.mapping_enabled || self.initialiser.is_some() {
            return;
        }
        let since = *self.lost_since_ns.get_or_insert(view.timestamp_ns);
        let is_young = self.is_young(self.submap);
        if was_followed && is_young || view.timestamp_ns - since >= self.config.submaps.max_lost_ns {
            self.begin_anew(is_young);
        }
    }

    /// Whether a submap is too small to be of use.
    fn is_young(&self, submap: SubmapId) -> bool {
        let min_keyframes = self.config.submaps.min_keyframes;
        self.map.keyframes_of(submap).take(min_keyframes).count() < min_keyframes
    }

    /// Begins a new submap in place of or beside the one that was lost.
    fn begin_anew(&mut self, discard: bool) {
        if discard {
            self.discard_submap();
        } else {
            self.at_risk.clear();
            self.backfill.begin_submap();
        }
        self.tracker.forget();
        self.last_submap = SubmapId(self.last_submap.max(self.submap).0 + 1);
        self.submap = self.last_submap;
        self.initialiser = Some(Initialiser::new(&self.config));
        self.choose_n_features();
    }

    /// Drops the submap that was begun last. Its frames may yet be placed in another.
    fn discard_submap(&mut self) {
        self.mapping.discard(self.submap);
        self.map = self.mapping.newest_map();
        self.tracker.adopt(&self.map);
        self.backfill.forget_poses();
        for record in self.at_risk.drain(..) {
            self.unrecorded.push(FrameRecord { pose: None, state: FrameState::Initialising, ..record });
        }
    }

    /// Notes the frame in the trajectory.
    fn record(&mut self, view: &View, verdict: &Verdict) {
        let pose = verdict.frame.as_ref().and_then(|frame| frame.pose_in(&self.map));
        let record = FrameRecord {
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            state: verdict.outcome.state(),
            pose,
            backfilled: false,
        };
        self.unrecorded.push(record);
        if !self.is_young(self.submap) {
            self.at_risk.clear();
        } else if pose.is_some() {
            self.at_risk.push(record);
        }
        if self.unrecorded.len() >= MAX_UNRECORDED_FRAMES {
            self.flush_records();
        }
    }

    fn flush_records(&mut self) {
        if !self.unrecorded.is_empty() {
            self.mapping.record(std::mem::take(&mut self.unrecorded));
        }
    }

    /// Makes the frame a key frame if it is worth it. Returns whether it did.
    fn extend(&mut self, verdict: &Verdict) -> bool {
        let Some(frame) = verdict.frame.as_ref().filter(|_| self.mapping_enabled && !verdict.is_keyframe)
        else {
            return false;
        };
        let is_certain = match &verdict.outcome {
            TrackingOutcome::Tracked => true,
            TrackingOutcome::Weak { uncertainty, .. } => self.config.tracking.is_certain_enough(uncertainty),
            _ => false,
        };
        if !is_certain || !self.tracker.wants_keyframe(frame, verdict.inliers, &self.map) {
            return false;
        }
        if !self.lossless && !self.mapping.is_idle() {
            return false;
        }
        let Some(place) = frame.pose_in(&self.map) else { return false };
        let id = self.next_keyframe_id();
        let new = NewKeyframe {
            place,
            keyframe: frame.to_keyframe(id, Some(frame.reference)),
            sightings: self.tracker.take_sightings(),
            frames: std::mem::take(&mut self.unrecorded),
        };
        self.mapping.add_keyframe(new, !self.lossless);
        self.tracker.became_keyframe(frame);
        true
    }

    /// Keeps a frame that has no pose for later, and places one of those kept before.
    fn step_backfill(&mut self, view: &View, verdict: &Verdict) {
        match &verdict.frame {
            None => self.backfill.keep(view, None),
            Some(frame) => {
                self.backfill.keep(view, Some(verdict.inliers.total()));
                self.backfill.placed(frame, &self.map);
                if let Some(record) = self.backfill.step(&self.map, false) {
                    self.unrecorded.push(record);
                }
            }
        }
    }

    fn report(
        &self,
        view: &View,
        verdict: Verdict,
        line_tracking: LineTrackingStatistics,
        stopwatch: Stopwatch,
    ) -> FrameReport {
        let times = stopwatch.finish();
        FrameReport {
            sequence: view.sequence,
            timestamp_ns: view.timestamp_ns,
            world_from_camera: verdict.frame.as_ref().map(|frame| frame.camera_from_world.inverse()),
            submap: verdict.frame.as_ref().map_or(self.submap, |frame| frame.submap),
            outcome: verdict.outcome,
            n_keypoints: view.features.len(),
            n_segments: view.features.lines.len(),
            line_tracking,
            n_inlier_points: verdict.inliers.n_points,
            n_inlier_lines: verdict.inliers.n_lines,
            is_keyframe: verdict.is_keyframe,
            relocalised: verdict.relocalised,
            n_relocalisation_candidates: verdict.n_candidates,
            map_events: self.mapping.take_events(),
            stages: times.stages,
            wall_ns: times.wall_ns,
            cpu_ns: times.cpu_ns,
        }
    }

    fn next_keyframe_id(&mut self) -> KeyframeId {
        self.next_keyframe_idx += 1;
        KeyframeId::from_index(self.next_keyframe_idx as usize - 1)
    }

    /// Matches are scarce before there is a map, so more features are asked for.
    fn choose_n_features(&mut self) {
        let n_features = match &self.initialiser {
            Some(_) => self.config.initialisation.n_features.max(self.config.orb.n_features),
            None => self.config.orb.n_features,
        };
        self.front_end.set_n_features(n_features);
    }
}

impl Verdict {
    fn nowhere(outcome: TrackingOutcome) -> Self {
        Self {
            outcome,
            frame: None,
            inliers: Inliers::default(),
            relocalised: false,
            n_candidates: None,
            is_keyframe: false,
        }
    }
}
