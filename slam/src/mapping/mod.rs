//! Local mapping: extending and maintaining the map, keyframe by keyframe.

mod culling;
mod fusion;
mod global_stage;
mod intrinsics;
mod lines;
mod primitives;
mod readout;
pub(crate) mod stage;
mod triangulation;

use crate::bundle;
use crate::config::{ConfigError, SlamConfig};
use crate::landmarks::VisibilityCounts;
use crate::loops::LoopCloser;
use crate::map::{
    FramePose, FrameRecord, Keyframe, KeyframeId, Map, MapUpdate, Observation, PointId, SubmapId,
};
use crate::report::{LineJudgement, MapEvent};
use geometry::nalgebra::Vector3;
use geometry::{Camera, CameraCorrection};
use global_stage::{Check, Done, GlobalStage, Task};
use intrinsics::IntrinsicsMonitor;
use lines::LineMapper;
use primitives::PrimitiveMapper;
use readout::ReadoutMonitor;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Looks at the camera at the end of a recording, at most, after one that moved it far.
const MAX_LOOKS_AGAIN: usize = 3;

/// A frame that tracking found worth keeping.
#[derive(Debug)]
pub(crate) struct NewKeyframe {
    pub keyframe: Keyframe,
    /// Where it is relative to its reference keyframe. The map may be corrected before the keyframe arrives
    /// in it.
    pub place: FramePose,
    /// How often points were seen since the keyframe before.
    pub visibility: VisibilityCounts,
    /// Frames of the trajectory since the keyframe before.
    pub frames: Vec<FrameRecord>,
}

/// Two views and what both see, to begin a map with.
#[derive(Debug)]
pub(crate) struct InitialMap {
    pub first: Keyframe,
    pub second: Keyframe,
    /// Keypoint of the first view, keypoint of the second, position.
    pub points: Vec<(usize, usize, Vector3<f64>)>,
    /// The camera it was found with, if that was only tried.
    pub hypothesis: Option<CameraCorrection>,
    pub frames: Vec<FrameRecord>,
}

/// Owns the map and extends it.
pub(crate) struct Mapper {
    config: SlamConfig,
    map: Map,
    /// Points on probation, with the keyframe that made them.
    recent_points: Vec<PointId>,
    lines: LineMapper,
    /// Absent where primitives are switched off.
    primitives: Option<PrimitiveMapper>,
    /// Absent where loops are not to be closed.
    loops: Option<LoopCloser>,
    global: GlobalStage,
    /// Absent where the calibration is to be taken as it is.
    camera: Option<IntrinsicsMonitor>,
    /// Absent where all rows of an image are read at once.
    readout: Option<ReadoutMonitor>,
    /// Submaps that grew since they were adjusted by their primitives.
    grown: BTreeSet<SubmapId>,
    /// Corrections of the map that nobody was told of yet.
    events: Vec<MapEvent>,
}

impl Mapper {
    /// `working_camera` is that of the images that features are looked for in.
    ///
    /// # Errors
    /// If the configuration cannot be used.
    pub fn new(config: SlamConfig, working_camera: &Camera, map: Map) -> Result<Self, ConfigError> {
        let with_primitives = config.features.lines && config.features.global_primitives;
        let primitives = with_primitives.then(|| PrimitiveMapper::new(&config)).transpose()?;
        let loops = config.features.loop_closing.then(|| LoopCloser::new(&config));
        let global = GlobalStage::new(config.threading);
        let (recent_points, lines, events) = (Vec::new(), LineMapper::default(), Vec::new());
        let is_contradicted = map.is_contradicted();
        let monitor = || IntrinsicsMonitor::new(&config.calibration, is_contradicted);
        let camera = config.features.refine_calibration.then(monitor);
        let readout = ReadoutMonitor::new(&config, working_camera, &map);
        let grown = BTreeSet::new();
        Ok(Self {
            config,
            map,
            recent_points,
            lines,
            primitives,
            loops,
            global,
            camera,
            readout,
            grown,
            events,
        })
    }

    /// Hands out what corrected the map since the last call.
    pub fn take_events(&mut self) -> Vec<MapEvent> {
        std::mem::take(&mut self.events)
    }

    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Begins a map, or a further submap of it, from two views.
    pub fn begin(&mut self, initial: InitialMap) -> MapUpdate {
        let (first, second) = (initial.first.id, initial.second.id);
        self.grown.insert(initial.first.submap);
        if let Some(camera) = initial.hypothesis {
            self.map.set_correction(camera);
        }
        self.map.add_keyframe(initial.first);
        self.map.add_keyframe(initial.second);
        for (first_idx, second_idx, position) in initial.points {
            let observations = [
                Observation { keyframe: first, feature_idx: first_idx as u32 },
                Observation { keyframe: second, feature_idx: second_idx as u32 },
            ];
            self.recent_points.extend(self.map.add_point(position, second, &observations));
        }
        self.map.refresh_covisibility(second, self.config.mapping.min_covisible_points);
        if let Some(primitives) = &mut self.primitives {
            // Only the directions that the first views show say how the map lay before anything drifted.
            [first, second].into_iter().for_each(|id| primitives.extend(&mut self.map, id, &self.config));
        }
        self.note_motion(&initial.frames);
        self.update(initial.frames)
    }

    /// Removes every keyframe and point of a submap that came to nothing.
    pub fn discard(&mut self, submap: SubmapId) -> MapUpdate {
        self.global.cancel();
        self.map.remove_submap(submap);
        self.recent_points.retain(|id| self.map.point(*id).is_some());
        self.lines.forget_missing(&self.map);
        self.update(Vec::new())
    }

    /// Takes in a keyframe: cull, triangulate, fuse, optimize, cull again. `publish` is shown the map as
    /// soon as it has its new points, since tracking waits for them; `abort` cuts optimization short.
    pub fn add_keyframe(
        &mut self,
        new: NewKeyframe,
        publish: &mut dyn FnMut(&Map),
        abort: &AtomicBool,
    ) -> MapUpdate {
        self.take_over_global(false);
        if let Some(readout) = &mut self.readout {
            readout.note_keyframe(&new, &self.map);
        }
        let id = new.keyframe.id;
        for (point, n_visible, n_found) in new.visibility.iter() {
            self.map.count_visibility(point, n_visible, n_found);
        }
        for (line, n_visible, n_found) in new.visibility.lines() {
            self.map.count_line_visibility(line, n_visible, n_found);
        }
        if !self.insert(new.keyframe, &new.place) {
            // Nothing may refer to a keyframe that is not there.
            let mut frames = new.frames;
            let of_it = |frame: &&mut FrameRecord| frame.pose.is_some_and(|pose| pose.reference == id);
            frames.iter_mut().filter(of_it).for_each(|frame| frame.pose = Some(new.place));
            return self.update(frames);
        }
        self.unroll_keyframes(false);
        culling::cull_recent_points(&mut self.map, &mut self.recent_points, id, &self.config.mapping);
        let made = triangulation::triangulate_with_neighbors(&mut self.map, id, &self.config.mapping);
        self.recent_points.extend(made);
        fusion::fuse_with_neighbors(&mut self.map, id, &self.config);
        self.lines.extend(&mut self.map, id, &self.config);
        if let Some(primitives) = &mut self.primitives {
            primitives.extend(&mut self.map, id, &self.config);
        }
        publish(&self.map);
        bundle::local::optimize(&mut self.map, id, &self.config, abort);
        culling::cull_keyframes(&mut self.map, id, &self.config);
        publish(&self.map);
        self.close_loops(id);
        self.check_intrinsics(1.0);
        self.update(new.frames)
    }

    /// Adds frames to the trajectory.
    pub fn record(&mut self, frames: Vec<FrameRecord>) -> MapUpdate {
        self.take_over_global(false);
        self.note_motion(&frames);
        self.update(frames)
    }

    /// What became of candidate lines since this was last called.
    pub fn take_line_judgements(&mut self) -> Vec<LineJudgement> {
        self.lines.take_judgements()
    }

    /// Waits for the adjustment of the whole map that is under way, if any, and takes it over. Then looks at
    /// what only the whole recording tells: the camera of a short one, and what primitives say of all of it.
    pub fn settle(&mut self) -> MapUpdate {
        self.take_over_global(true);
        // A short recording ends between two times of looking at the camera.
        self.check_intrinsics(1.0 / self.config.calibration.growth);
        self.take_over_global(true);
        for _ in 0..MAX_LOOKS_AGAIN {
            if !self.camera.as_ref().is_some_and(IntrinsicsMonitor::wants_another_look) {
                break;
            }
            self.check_intrinsics(0.0);
            self.take_over_global(true);
        }
        self.adjust_by_primitives();
        self.update(Vec::new())
    }

    /// Waits for the look at the camera that is under way, if any. Returns whether there was one.
    pub fn settle_intrinsics(&mut self) -> bool {
        let was_under_way = self.global.is_checking_intrinsics();
        if was_under_way {
            self.take_over_global(true);
        }
        was_under_way
    }

    /// Looks at the camera if there are enough keyframes for it, or `share` of those planned.
    fn check_intrinsics(&mut self, share: f64) {
        let Some(camera) = self.camera.as_mut().filter(|_| self.global.is_idle()) else { return };
        let Some(submap) = camera.is_due(&self.map, share, &self.config.calibration) else { return };
        let readout = self.readout.as_ref().and_then(|readout| readout.look(&self.map, submap));
        let task = Task::CheckIntrinsics(Box::new(Check { before: camera.memory(), readout }));
        let done = self.global.start(task, &self.map, submap, &self.config);
        self.take_over(done);
    }

    /// Adjusts the submaps that grew, and whose primitives reach farther than sight, as a whole: until then
    /// each window knew what primitives say of it, and held on to neighbors that had been placed knowing
    /// less.
    fn adjust_by_primitives(&mut self) {
        let grown = std::mem::take(&mut self.grown);
        // A wrong camera bends the whole to suit itself; piece by piece it does less harm.
        let is_camera_wrong = self.camera.as_ref().is_some_and(IntrinsicsMonitor::is_contradicted);
        if self.primitives.is_none() || is_camera_wrong {
            return;
        }
        let max_keyframes = self.config.primitives.max_keyframes_to_adjust;
        for submap in grown {
            let n_keyframes = self.map.keyframes_of(submap).count();
            if n_keyframes <= max_keyframes && self.map.primitives_tie_beyond_sight(submap) {
                let done = self.global.start(Task::AdjustMap, &self.map, submap, &self.config);
                self.take_over(done);
                self.take_over_global(true);
            }
        }
    }

    /// Recognizes the place the keyframe shows, corrects the map by it, and has all of it adjusted.
    fn close_loops(&mut self, id: KeyframeId) {
        let Some(closed) = self.loops.as_mut().and_then(|loops| loops.close(&mut self.map, id)) else {
            return;
        };
        self.events.push(closed.event);
        self.lines.forget_missing(&self.map);
        self.recent_points.retain(|id| self.map.point(*id).is_some());
        if closed.moved {
            let done = self.global.start(Task::AdjustMap, &self.map, closed.submap, &self.config);
            self.take_over(done);
        }
    }

    fn take_over_global(&mut self, wait: bool) {
        let done = self.global.take(wait);
        self.take_over(done);
    }

    fn take_over(&mut self, done: Option<Done>) {
        let result = match done {
            None => None,
            Some(Done::Adjusted(result)) => Some(result),
            Some(Done::CheckedIntrinsics(check)) => {
                let check = *check;
                let event = self.camera.as_mut().and_then(|camera| camera.note(&check));
                match event {
                    Some(MapEvent::CalibrationContradicted { .. }) => self.map.set_contradicted(true),
                    Some(MapEvent::CalibrationRefined { .. }) => self.map.set_contradicted(false),
                    _ => {}
                }
                self.events.extend(event);
                if let Some(monitor) = &mut self.readout {
                    monitor.note_look(check.seen_readout_ns, check.readout);
                }
                if let Some(readout) = check.readout {
                    self.map.set_readout(readout);
                    self.unroll_keyframes(true);
                }
                if let Some(result) = check.adjusted {
                    result.merge_into(&mut self.map);
                    if let Some(submap) = check.search_again {
                        self.search_again(submap);
                    }
                }
                None
            }
        };
        if let Some(result) = result {
            result.merge_into(&mut self.map);
        }
    }

    fn note_motion(&mut self, frames: &[FrameRecord]) {
        if let Some(readout) = &mut self.readout {
            readout.note(frames, &self.map);
        }
    }

    /// Takes the readout out of the keyframes in which it is not; out of all, if it is `another` than before.
    fn unroll_keyframes(&mut self, another: bool) {
        if let Some(readout) = &self.readout {
            readout.unroll(&mut self.map, another);
        }
    }

    /// Looks for what the keyframes of a submap share once more: by another camera than the present one much
    /// of it did not agree, and what was left agrees with that camera too well.
    fn search_again(&mut self, submap: SubmapId) {
        let ids: Vec<KeyframeId> = self.map.keyframes_of(submap).map(|keyframe| keyframe.id).collect();
        for id in ids {
            let made = triangulation::triangulate_with_neighbors(&mut self.map, id, &self.config.mapping);
            self.recent_points.extend(made);
            fusion::fuse_with_neighbors(&mut self.map, id, &self.config);
        }
        self.recent_points.retain(|id| self.map.point(*id).is_some());
        self.lines.forget_missing(&self.map);
    }

    /// Puts a keyframe into the map where its reference now is. `false` if that has gone with its submap.
    fn insert(&mut self, mut keyframe: Keyframe, place: &FramePose) -> bool {
        let Some((anchor, (submap, camera_from_world))) =
            self.map.anchor_of(place.reference).zip(self.map.locate(place))
        else {
            return false;
        };
        keyframe.parent = Some(anchor.id);
        (keyframe.submap, keyframe.camera_from_world) = (submap, camera_from_world);
        keyframe.local_scale = anchor.local_scale;
        let id = keyframe.id;
        self.map.add_keyframe(keyframe);
        self.grown.insert(submap);
        let seen: Vec<PointId> = self
            .map
            .keyframe(id)
            .into_iter()
            .flat_map(Keyframe::observed_points)
            .map(|(_, point)| point)
            .collect();
        for point in seen {
            self.map.refresh_point(point);
        }
        self.map.refresh_covisibility(id, self.config.mapping.min_covisible_points);
        let strongest =
            self.map.keyframe(id).and_then(|keyframe| keyframe.covisible().first().map(|(id, _)| *id));
        if let Some(parent) = strongest {
            self.map.set_parent(id, parent);
        }
        true
    }

    fn update(&mut self, frames: Vec<FrameRecord>) -> MapUpdate {
        let mut changes = self.map.take_changes();
        changes.enlarged = self.config.enlarge_for_border && !changes.keyframes.is_empty();
        debug_assert_eq!(self.map.check(), Ok(()));
        MapUpdate { map: Arc::new(self.map.clone()), changes, frames }
    }
}

/// Keyframes around one, strongest ties first.
fn neighbors(map: &Map, id: KeyframeId, n: usize) -> Vec<KeyframeId> {
    map.keyframe(id).map_or(Vec::new(), |keyframe| {
        keyframe.covisible().iter().take(n).map(|(neighbor, _)| *neighbor).collect()
    })
}
