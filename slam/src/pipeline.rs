//! Start here: one frame in, one report out. How a session is opened and ended stands in `lifecycle`, how
//! several cameras extend one map in `shared_map`.

mod lifecycle;
mod repeated;
mod shared_map;

pub use shared_map::{JoinState, SharedMap};

use crate::backfill::Backfill;
use crate::clock::{Clock, Stopwatch};
use crate::config::SlamConfig;
use crate::cores;
use crate::features::View;
use crate::frame_result::FrameResult;
use crate::front_end::FrontEnd;
use crate::initialization::{InitialPair, Initializer};
use crate::input::{Frame, FrameError};
use crate::map::{CameraId, FramePose, FrameRecord, Map, MapCamera, SubmapId};
use crate::mapping::stage::MappingStage;
use crate::mapping::{InitialMap, NewKeyframe};
use crate::report::{FrameReport, InitializationWait, LostReason, MapEvent, TrackingOutcome};
use crate::rolling_shutter::RollingShutter;
use crate::submaps::{Abandoned, SubmapPolicy};
use crate::tracking::frame::TrackedFrame;
use crate::tracking::judgement::is_certain_enough;
use crate::tracking::{Tracked, Tracker};
use crate::trajectory::{TrajectoryLog, first_record};
use geometry::{Camera, Pose};
use repeated::LastImage;
use std::sync::Arc;
use vision::GrayImage;
use vision::lines::LineTrackingStatistics;

/// A monocular SLAM session: frames of one camera in, reports and map updates out.
///
/// One frame passes through `extract`, then `track` or, while there is no map to follow, `initialize`, then
/// `extend` (a frame that shows something new becomes a keyframe, and mapping takes it from there). A camera
/// that is lost for long begins a new submap, while it is still looked for in the others; mapping joins the
/// submaps where they meet.
pub struct Pipeline {
    config: SlamConfig,
    camera: Camera,
    /// Which of the map's cameras it is.
    map_camera: MapCamera,
    clock: Arc<dyn Clock>,
    front_end: FrontEnd,
    mapping: MappingStage,
    /// The map as tracking sees it at present.
    map: Arc<Map>,
    tracker: Tracker,
    /// Present while there is no map to follow.
    initializer: Option<Initializer>,
    backfill: Backfill,
    submaps: SubmapPolicy,
    trajectory: TrajectoryLog,
    last_frame: Option<(u64, i64)>,
    /// What the last frame measured, for whoever wants to see it.
    last_view: Option<View>,
    last_image: LastImage,
    /// The images contradict the calibration.
    is_camera_wrong: bool,
    mapping_enabled: bool,
    lossless: bool,
    /// Whether it is decided at which size images are worked on.
    has_resolution: bool,
    /// Absent where all rows of an image are read at once.
    rolling_shutter: Option<RollingShutter>,
}

impl Pipeline {
    /// Tracks one frame and, where it is worth it, extends the map.
    ///
    /// # Errors
    /// If the frame cannot be used; the session is as it was before.
    pub fn process_frame(&mut self, frame: Frame) -> Result<FrameReport, FrameError> {
        frame.check(&self.camera, self.last_frame)?;
        self.choose_resolution(&frame.image);
        self.last_frame = Some((frame.sequence, frame.timestamp_ns));
        self.mapping.begin_frame();
        let mut stopwatch = Stopwatch::start(self.clock.clone());
        Ok(cores::with_turn(|| {
            stopwatch.lap("wait_for_core");
            self.process(frame, stopwatch)
        }))
    }

    fn process(&mut self, frame: Frame, mut stopwatch: Stopwatch) -> FrameReport {
        let image = Arc::new(self.front_end.working_image(frame.image));
        let now = (frame.sequence, frame.timestamp_ns);
        if self.tracker.image() == Some(&image)
            && let Some((view, result)) = self.repeat(now, &mut stopwatch)
        {
            return self.report(&view, result, LineTrackingStatistics::default(), stopwatch);
        }
        let (mut view, line_statistics) = self.extract(image, now, &mut stopwatch);
        // A stream that comes as fast as it is taken would run ahead of the map, further than any camera
        // does: where new texture is all there is, what the newest keyframes add decides the scale.
        if self.lossless {
            self.mapping.wait();
        }
        stopwatch.lap("wait_for_mapping");
        self.sync_map();
        view.correct_camera(&self.map.correction_of(self.map_camera));
        stopwatch.lap("map_sync");
        let mut result = self.track(&view);
        stopwatch.lap(if result.n_candidates.is_some() { "relocalise" } else { "track" });
        if result.frame.is_none() && self.initializer.is_some() {
            result = self.initialize(&view, result.n_candidates);
            stopwatch.lap("initialise");
        }
        self.last_image.note(&result);
        self.record(&view, &result);
        result.is_keyframe |= self.extend(&view, &result);
        stopwatch.lap("extend");
        self.step_backfill(&view, &result);
        stopwatch.lap("backfill");
        self.last_view = Some(view.clone());
        self.report(&view, result, line_statistics, stopwatch)
    }

    fn report(
        &mut self,
        view: &View,
        mut result: FrameResult,
        line_statistics: LineTrackingStatistics,
        stopwatch: Stopwatch,
    ) -> FrameReport {
        let submap = self.submaps.current();
        let events = self.mapping.take_events();
        self.note_camera(&events);
        result.outcome = self.outcome_told(result.outcome);
        result.into_report(view, submap, line_statistics, events, stopwatch.finish())
    }

    fn extract(
        &mut self,
        image: Arc<GrayImage>,
        (sequence, timestamp_ns): (u64, i64),
        stopwatch: &mut Stopwatch,
    ) -> (View, LineTrackingStatistics) {
        if self.front_end.look_for_mask(&image)
            && let Some(initializer) = &mut self.initializer
        {
            // They show what is not the scene.
            initializer.forget_views();
        }
        stopwatch.lap("mask");
        let rotation = self.tracker.expected_rotation(timestamp_ns);
        self.front_end.set_camera_state(self.camera_state());
        let (features, statistics) = self.front_end.extract(&image, rotation, stopwatch);
        self.tracker.set_image(image);
        (View { sequence, timestamp_ns, features: Arc::new(features) }, statistics)
    }

    /// Brings everything that follows the map up to date with what mapping made of it.
    fn sync_map(&mut self) {
        let newest = self.mapping.newest_map();
        if !Arc::ptr_eq(&newest, &self.map) {
            let correction = newest.correction_of(self.map_camera);
            if correction != self.map.correction_of(self.map_camera) {
                self.front_end.correct_camera(correction);
            }
            let has_new_readout = newest.readout() != self.map.readout();
            self.map = newest;
            if has_new_readout {
                self.sync_rolling_shutter();
            }
            self.tracker.sync_map(&self.map);
            if let Some(last) = self.tracker.last_frame() {
                self.follow(last.submap);
            }
        }
    }

    /// The camera is followed in this submap.
    fn follow(&mut self, submap: SubmapId) {
        self.submaps.follow(submap);
        self.mapping.visit(submap);
    }

    /// Tries to begin a map, or a further submap, with this view.
    fn initialize(&mut self, view: &View, n_candidates: Option<usize>) -> FrameResult {
        let attempt = match &mut self.initializer {
            Some(initializer) if self.mapping_enabled => initializer.try_start(view.clone()),
            _ => Err(InitializationWait::MappingDisabled),
        };
        let result = match attempt {
            Err(wait) => FrameResult::nowhere(TrackingOutcome::Initialising(wait)),
            Ok(pair) => self.begin_map(pair),
        };
        FrameResult { n_candidates, ..result }
    }

    fn begin_map(&mut self, pair: InitialPair) -> FrameResult {
        let n_points = pair.points.len();
        let (first_id, second_id) = (self.mapping.next_keyframe_id(), self.mapping.next_keyframe_id());
        let submap = self.submaps.current();
        let first = TrackedFrame::blank(&pair.first, Pose::identity(), first_id, submap);
        let mut second = TrackedFrame::blank(&pair.second, pair.second_from_first, second_id, submap);
        let first_pose = FramePose { submap, reference: first_id, camera_from_reference: Pose::identity() };
        let first_record = first_record(self.camera_id(), (first.sequence, first.timestamp_ns), first_pose);
        self.mapping.begin(InitialMap {
            first: first.to_keyframe(first_id, self.map_camera, None),
            second: second.to_keyframe(second_id, self.map_camera, Some(first_id)),
            points: pair.points,
            hypothesis: pair.hypothesis,
            frames: self.trajectory.begin_map(first_record),
        });
        self.map = self.mapping.newest_map();
        self.front_end.correct_camera(self.map.correction_of(self.map_camera));
        if let Some(keyframe) = self.map.keyframe(second_id) {
            second.points.clone_from(&keyframe.points);
        }
        self.follow_map();
        self.tracker.sync_map(&self.map);
        self.tracker.start(second.clone(), &self.map);
        FrameResult::begun(second, n_points)
    }

    /// Follows the camera in the map, or looks for it there.
    fn track(&mut self, view: &View) -> FrameResult {
        if self.map.n_keyframes() == 0 {
            return FrameResult::nowhere(TrackingOutcome::Lost(LostReason::NotRelocalized {
                n_candidates: 0,
            }));
        }
        let was_followed = self.tracker.last_frame().is_some();
        let mut tracked = self.tracker.track(view, &self.map);
        match &tracked.frame {
            None => self.lose(view, was_followed),
            Some(frame) => {
                self.follow(frame.submap);
                self.follow_map();
                if let Some(elsewhere) = self.find_elsewhere(view) {
                    tracked = elsewhere;
                }
            }
        }
        FrameResult::from(tracked)
    }

    /// Notes that there is a map to follow.
    fn follow_map(&mut self) {
        self.submaps.found();
        if self.initializer.take().is_some() {
            self.submaps.begun();
            self.choose_n_features();
        }
    }

    /// While a further submap is young, looks for its frames in the others, and goes on there if one is
    /// found.
    fn find_elsewhere(&mut self, view: &View) -> Option<Tracked> {
        if !self.mapping_enabled || !self.submaps.is_search_due(&self.map, self.camera_id()) {
            return None;
        }
        let found = self.tracker.find_elsewhere(view, &self.map, self.submaps.current())?;
        // Before the own one may go: were two cameras found in each other's, both would go.
        if let Some(frame) = &found.frame {
            self.mapping.visit(frame.submap);
        }
        if self.mapping.is_shared(self.submaps.current()) {
            self.trajectory.keep_submap();
        } else {
            self.discard_submap();
        }
        if let Some(frame) = &found.frame {
            self.follow(frame.submap);
        }
        Some(found)
    }

    /// A frame has no pose: in time its submap is given up, and a new one begun in its place or beside it.
    fn lose(&mut self, view: &View, was_followed: bool) {
        if !self.mapping_enabled || self.initializer.is_some() {
            return;
        }
        match self.submaps.lost(view.timestamp_ns, was_followed, &self.map) {
            None => return,
            Some(Abandoned::Discard) if !self.mapping.is_shared(self.submaps.current()) => {
                self.discard_submap();
            }
            Some(Abandoned::Discard | Abandoned::Keep) => {
                self.trajectory.keep_submap();
                self.backfill.begin_submap();
            }
        }
        self.tracker.forget();
        self.submaps.begin_next(self.mapping.core().submap_numbers());
        let (is_first, shutter) = (self.is_first(), self.rolling_shutter.clone());
        self.initializer = Some(Initializer::new(&self.config, is_first, shutter));
        self.choose_n_features();
    }

    /// Whether the camera is to begin a map that there is nothing of yet, and whose camera it is.
    fn is_first(&self) -> bool {
        self.map.n_keyframes() == 0 && self.camera_id() == CameraId::default()
    }

    /// Drops the submap that was begun last. Its frames may yet be placed in another.
    fn discard_submap(&mut self) {
        let submap = self.submaps.current();
        let has_keyframes = self.map.keyframes_of(submap).next().is_some();
        // What else is under way on the map ends when a submap goes: not for nothing where others extend it.
        if has_keyframes || self.camera_id() == CameraId::default() {
            self.mapping.discard(submap);
            self.map = self.mapping.newest_map();
            self.tracker.sync_map(&self.map);
        }
        self.backfill.forget_poses();
        self.trajectory.discard_submap();
    }

    /// Takes note of whether the camera is the one that the map was made with.
    fn note_camera(&mut self, events: &[MapEvent]) {
        for event in events.iter().filter(|_| self.map_camera.is_refined) {
            match event {
                MapEvent::CalibrationContradicted { .. } => self.is_camera_wrong = true,
                MapEvent::CalibrationRefined { .. } => self.is_camera_wrong = false,
                _ => {}
            }
        }
    }

    /// How tracking ended, as it is told: in a bent map no pose is plainly good.
    fn outcome_told(&self, outcome: TrackingOutcome) -> TrackingOutcome {
        match outcome {
            TrackingOutcome::Tracked if self.is_camera_wrong => TrackingOutcome::CalibrationContradicted,
            outcome => outcome,
        }
    }

    fn record_of(&self, view: &View, result: &FrameResult) -> FrameRecord {
        let told = self.outcome_told(result.outcome);
        FrameRecord {
            state: told.state(),
            reason: told.reason(),
            ..result.record(self.camera_id(), view, &self.map)
        }
    }

    /// Notes the frame in the trajectory.
    fn record(&mut self, view: &View, result: &FrameResult) {
        self.trajectory.note(self.record_of(view, result), self.submaps.is_young(&self.map));
        self.flush_full();
    }

    fn flush_full(&mut self) {
        if self.trajectory.is_full() {
            self.flush_records();
        }
    }

    fn flush_records(&mut self) {
        let frames = self.trajectory.take();
        if !frames.is_empty() {
            self.mapping.record(frames);
        }
    }

    /// Makes the frame a keyframe if it is worth it. Returns whether it did.
    fn extend(&mut self, view: &View, result: &FrameResult) -> bool {
        let Some(frame) = result.frame.as_ref().filter(|_| self.mapping_enabled && !result.is_keyframe)
        else {
            return false;
        };
        if !is_certain_enough(&result.outcome, &self.config.tracking)
            || !self.tracker.wants_keyframe(frame, result.inliers, &self.map)
        {
            return false;
        }
        if !self.lossless && !self.mapping.is_idle() {
            return false;
        }
        let Some(place) = frame.pose_in(&self.map) else { return false };
        let id = self.mapping.next_keyframe_id();
        // The frame moves with its keyframe from now on.
        let pose = FramePose { submap: place.submap, reference: id, camera_from_reference: Pose::identity() };
        self.trajectory.replace(FrameRecord { pose: Some(pose), ..self.record_of(view, result) });
        let new = NewKeyframe {
            place,
            keyframe: self.settled(frame).to_keyframe(id, self.map_camera, Some(frame.reference)),
            visibility: self.tracker.take_visibility_counts(),
            frames: self.trajectory.take(),
        };
        self.mapping.add_keyframe(new, !self.lossless);
        self.tracker.became_keyframe(frame);
        true
    }

    /// The frame as it will be once it was stored.
    fn settled(&self, frame: &TrackedFrame) -> TrackedFrame {
        let settled = self.rolling_shutter.as_ref().and_then(|shutter| shutter.settle(&frame.features));
        let features = settled.map_or_else(|| frame.features.clone(), Arc::new);
        TrackedFrame { features, ..frame.clone() }
    }

    /// Keeps a frame that has no pose for later, and places one of those kept before.
    fn step_backfill(&mut self, view: &View, result: &FrameResult) {
        let is_readout_open = self.camera_id() == CameraId::default()
            && self.config.looks_for_readout(self.map.readout().is_some());
        self.backfill.expect_readout(
            is_readout_open && self.map.n_keyframes() <= self.config.rolling_shutter.keep_until_keyframes,
        );
        match &result.frame {
            None => self.backfill.keep(view, None),
            Some(frame) => {
                self.backfill.keep(view, Some(result.inliers.total()));
                self.backfill.placed(frame, &self.map);
                self.trajectory.backfill(self.backfill.step(&self.map, false));
            }
        }
    }

    fn camera_id(&self) -> CameraId {
        self.map_camera.id
    }
}
