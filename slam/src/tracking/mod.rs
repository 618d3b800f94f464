//! Following the camera: motion model, reference key frame or relocalisation, then the local map.

pub(crate) mod frame;
mod keyframe_policy;
pub(crate) mod lines;
mod local_map;
mod pose;
pub(crate) mod relocalisation;
pub(crate) mod search;

pub(crate) use local_map::Sightings;
use pose::place_frame;

use crate::config::SlamConfig;
use crate::features::FrameFeatures;
use crate::map::{FramePose, KeyframeId, Map, SubmapId};
use crate::report::{LostReason, TrackingOutcome};
use frame::{Inliers, TrackedFrame};
use geometry::Pose;
use geometry::nalgebra::UnitQuaternion;
use keyframe_policy::LastKeyframe;
use lines::LineTracks;
use local_map::LocalMap;
use relocalisation::Relocaliser;
use search::{Expected, match_keyframe, search_by_motion};
use std::sync::Arc;

/// A gap in time longer than this many frame intervals is not bridged by the motion model.
const MAX_EXTRAPOLATION: f64 = 3.0;
/// Frames after a relocalisation in which the local map is searched more widely, and how much.
const WIDE_SEARCH_FRAMES: u64 = 10;
const WIDE_SEARCH_FACTOR: f64 = 2.5;

/// What tracking a frame came to.
#[derive(Debug)]
pub(crate) struct Tracked {
    pub outcome: TrackingOutcome,
    /// The frame, where it has a pose.
    pub frame: Option<TrackedFrame>,
    pub inliers: Inliers,
    pub relocalised: bool,
    /// Places that were tried, if the camera had to be looked for.
    pub n_candidates: Option<usize>,
}

/// Follows the camera in a map that it only reads.
pub(crate) struct Tracker {
    config: SlamConfig,
    local_map: LocalMap,
    line_tracks: LineTracks,
    /// Absent where a lost camera is not to be looked for.
    relocaliser: Option<Relocaliser>,
    /// How often points were seen since the last key frame.
    sightings: Sightings,
    last: Option<LastFrame>,
    /// Frames since the camera was last found by relocalisation.
    n_since_relocalisation: Option<u64>,
    last_keyframe: Option<LastKeyframe>,
}

/// The frame before, as the motion model needs it.
struct LastFrame {
    frame: TrackedFrame,
    place: FramePose,
    /// The [unit](crate::map::Keyframe::unit) of the reference key frame when the motion was measured.
    unit: f64,
    /// `camera_now_from_camera_before` over the last interval, and that interval, nanoseconds.
    motion: Option<(Pose, i64)>,
}

impl Tracker {
    /// A tracker that looks for a lost camera in the whole map.
    pub fn new(config: SlamConfig) -> Self {
        let relocaliser = Relocaliser::new(config.relocalisation.clone(), config.seed);
        Self { relocaliser: Some(relocaliser), ..Self::follower(config) }
    }

    /// A tracker that only follows: once lost it stays lost.
    pub fn follower(config: SlamConfig) -> Self {
        Self {
            config,
            local_map: LocalMap::default(),
            line_tracks: LineTracks::default(),
            relocaliser: None,
            sightings: Sightings::default(),
            last: None,
            n_since_relocalisation: None,
            last_keyframe: None,
        }
    }

    /// Starts following from a frame whose pose is known.
    pub fn start(&mut self, frame: TrackedFrame, map: &Map) {
        self.last_keyframe = Some(LastKeyframe::of(&frame));
        self.n_since_relocalisation = None;
        self.remember(frame, map, None);
    }

    /// Takes over corrections that mapping made since the last frame.
    pub fn adopt(&mut self, map: &Map) {
        if let Some(relocaliser) = &mut self.relocaliser {
            relocaliser.learn(map);
        }
        self.line_tracks.learn(map);
        let Some(last) = &mut self.last else { return };
        let Some((anchor, (submap, camera_from_world))) =
            map.anchor_of(last.place.reference).zip(map.locate(&last.place))
        else {
            self.last = None;
            return;
        };
        (last.frame.submap, last.frame.camera_from_world) = (submap, camera_from_world);
        if let Some((motion, _)) = &mut last.motion {
            motion.translation *= anchor.unit / last.unit;
        }
        last.unit = anchor.unit;
    }

    /// How much the camera should have turned since the last frame, if it was placed and the motion is known.
    pub fn expected_rotation(&self, timestamp_ns: i64) -> Option<UnitQuaternion<f64>> {
        let last = self.last.as_ref().filter(|last| last.motion.is_some())?;
        Some(last.predict(timestamp_ns).rotation * last.frame.camera_from_world.rotation.inverse())
    }

    /// The last frame, if it was placed.
    pub fn last_frame(&self) -> Option<&TrackedFrame> {
        self.last.as_ref().map(|last| &last.frame)
    }

    /// Forgets where the camera was: the next frame is relocalised.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// Hands out how often points were seen and begins counting anew.
    pub fn take_sightings(&mut self) -> Sightings {
        std::mem::take(&mut self.sightings)
    }

    /// Finds the pose of a frame in the map.
    pub fn track(
        &mut self,
        sequence: u64,
        timestamp_ns: i64,
        features: Arc<FrameFeatures>,
        map: &Map,
    ) -> Tracked {
        if features.len() < self.config.tracking.min_weak_inliers {
            let n_required = self.config.tracking.min_weak_inliers;
            return self.lose(LostReason::TooFewFeatures { n_keypoints: features.len(), n_required });
        }
        let blank = |camera_from_world, reference, submap| {
            TrackedFrame::blank(
                sequence,
                timestamp_ns,
                features.clone(),
                camera_from_world,
                reference,
                submap,
            )
        };
        let followed = self.last.as_ref().and_then(|last| {
            let frame = blank(last.predict(timestamp_ns), last.frame.reference, last.frame.submap);
            self.follow_motion(last, frame.clone(), map).or_else(|| self.follow_reference(last, frame, map))
        });
        let relocalised = followed.is_none();
        let Some(mut frame) = followed.or_else(|| {
            let frame = blank(Pose::identity(), KeyframeId::from_index(0), SubmapId::default());
            self.relocaliser.as_mut()?.relocalise(frame, map, None)
        }) else {
            let n_candidates = self.relocaliser.as_ref().map_or(0, Relocaliser::n_candidates);
            let lost = self.lose(LostReason::NotRelocalised { n_candidates });
            return Tracked { n_candidates: Some(n_candidates), ..lost };
        };
        if relocalised {
            self.n_since_relocalisation = Some(0);
        }
        let inliers = self.track_local_map(&mut frame, map);
        self.conclude(frame, inliers, relocalised, map)
    }

    /// Looks for a frame in the submaps other than the one it is followed in. Where it is found there, the camera is
    /// followed there from now on.
    pub fn find_elsewhere(
        &mut self,
        sequence: u64,
        timestamp_ns: i64,
        features: Arc<FrameFeatures>,
        map: &Map,
        except: SubmapId,
    ) -> Option<Tracked> {
        let blank = TrackedFrame {
            sequence,
            timestamp_ns,
            points: vec![None; features.len()],
            lines: vec![None; features.lines.len()],
            features,
            camera_from_world: Pose::identity(),
            reference: KeyframeId::from_index(0),
            submap: except,
        };
        let mut frame = self.relocaliser.as_mut()?.relocalise(blank, map, Some(except))?;
        let before = (self.n_since_relocalisation, self.last.take());
        self.n_since_relocalisation = Some(0);
        let inliers = self.track_local_map(&mut frame, map);
        if inliers.total() >= self.config.tracking.min_inliers {
            return Some(self.conclude(frame, inliers, true, map));
        }
        (self.n_since_relocalisation, self.last) = before;
        None
    }

    /// Whether a frame with these inliers should become a key frame.
    pub fn wants_keyframe(&self, frame: &TrackedFrame, inliers: Inliers, map: &Map) -> bool {
        keyframe_policy::wants_keyframe(
            &self.config.keyframes,
            map,
            frame,
            inliers,
            self.last_keyframe.as_ref(),
            self.n_since_relocalisation,
        )
    }

    /// Notes that a frame became a key frame.
    pub fn became_keyframe(&mut self, frame: &TrackedFrame) {
        self.last_keyframe = Some(LastKeyframe::of(frame));
    }

    /// Points of the last frame, projected to where the motion so far would take them.
    fn follow_motion(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<TrackedFrame> {
        last.motion.as_ref()?;
        let config = &self.config.tracking;
        let expected = || {
            last.frame.points.iter().enumerate().filter_map(|(idx, id)| {
                let point = map.point((*id)?)?;
                let keypoint = &last.frame.features.keypoints[idx];
                let descriptor = &point.descriptor;
                Some(Expected { point, octave: keypoint.octave, angle: keypoint.angle, descriptor })
            })
        };
        let features = frame.features.clone();
        let radius = config.motion_search_radius_px;
        let mut n_matches =
            search_by_motion(&features, &frame.camera_from_world, expected(), radius, &mut frame.points);
        if n_matches < config.min_motion_matches {
            frame.points.fill(None);
            n_matches = search_by_motion(
                &features,
                &frame.camera_from_world,
                expected(),
                2.0 * radius,
                &mut frame.points,
            );
        }
        self.line_tracks.associate(&mut frame, map, &self.config.lines);
        let n_matches = n_matches + frame.lines.iter().flatten().count();
        if n_matches < config.min_first_inliers {
            return None;
        }
        (place_frame(&mut frame, map).total() >= config.min_first_inliers).then_some(frame)
    }

    /// Points of the reference key frame, recognised by their descriptors, starting from the last pose.
    fn follow_reference(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<TrackedFrame> {
        let config = &self.config.tracking;
        let reference = map.keyframe(last.frame.reference)?;
        let matches = match_keyframe(reference, &frame.features);
        if matches.len() < config.min_reference_matches {
            return None;
        }
        frame.camera_from_world = last.frame.camera_from_world;
        for (feature_idx, id) in matches {
            frame.points[feature_idx] = Some(id);
        }
        self.line_tracks.associate(&mut frame, map, &self.config.lines);
        (place_frame(&mut frame, map).total() >= config.min_first_inliers).then_some(frame)
    }

    /// Finds more of what is near and places the frame by all of it. Returns what agrees.
    fn track_local_map(&mut self, frame: &mut TrackedFrame, map: &Map) -> Inliers {
        let config = &self.config.tracking;
        if let Some(reference) = self.local_map.collect(map, frame, config) {
            frame.reference = reference;
            frame.submap = map.keyframe(reference).map_or(frame.submap, |keyframe| keyframe.submap);
        }
        let wide = self.n_since_relocalisation.is_some_and(|n| n < WIDE_SEARCH_FRAMES);
        let radius = config.map_search_radius_px * if wide { WIDE_SEARCH_FACTOR } else { 1.0 };
        self.local_map.search(map, frame, radius, config, &mut self.sightings);
        self.local_map.search_lines(map, frame, &self.config.lines, &mut self.sightings);
        let inliers = place_frame(frame, map);
        frame.points.iter().flatten().for_each(|id| self.sightings.found(*id));
        frame.lines.iter().flatten().for_each(|id| self.sightings.line_found(*id));
        inliers
    }

    /// Judges a placed frame and remembers it for the next.
    fn conclude(&mut self, frame: TrackedFrame, inliers: Inliers, relocalised: bool, map: &Map) -> Tracked {
        let config = &self.config.tracking;
        let n_inliers = inliers.total();
        if n_inliers < config.min_weak_inliers {
            let n_required = config.min_weak_inliers;
            return self.lose(LostReason::TooFewInliers { n_inliers, n_required });
        }
        let outcome = if n_inliers < config.min_inliers {
            TrackingOutcome::Weak { n_inliers, n_required: config.min_inliers }
        } else {
            TrackingOutcome::Tracked
        };
        if let Some(n) = self.n_since_relocalisation.as_mut().filter(|_| !relocalised) {
            *n += 1;
        }
        let motion = self.last.as_ref().filter(|_| !relocalised).map(|last| {
            let motion = frame.camera_from_world * last.frame.camera_from_world.inverse();
            (motion, frame.timestamp_ns - last.frame.timestamp_ns)
        });
        self.line_tracks.remember(&frame);
        self.remember(frame.clone(), map, motion);
        let searched = self.relocaliser.as_ref().filter(|_| relocalised);
        let n_candidates = searched.map(Relocaliser::n_candidates);
        Tracked { outcome, frame: Some(frame), inliers, relocalised, n_candidates }
    }

    fn remember(&mut self, frame: TrackedFrame, map: &Map, motion: Option<(Pose, i64)>) {
        let unit = map.anchor_of(frame.reference).map_or(1.0, |anchor| anchor.unit);
        self.last = frame.pose_in(map).map(|place| LastFrame { frame, place, unit, motion });
    }

    fn lose(&mut self, reason: LostReason) -> Tracked {
        self.last = None;
        Tracked {
            outcome: TrackingOutcome::Lost(reason),
            frame: None,
            inliers: Inliers::default(),
            relocalised: false,
            n_candidates: None,
        }
    }
}

impl LastFrame {
    /// The pose the motion so far leads to, for equal velocity over a frame interval that may differ from the last.
    fn predict(&self, timestamp_ns: i64) -> Pose {
        let Some((motion, interval_ns)) = &self.motion else { return self.frame.camera_from_world };
        // Both are negative when a recording is followed backwards.
        let ratio = (timestamp_ns - self.frame.timestamp_ns) as f64 / *interval_ns as f64;
        let ratio = if ratio.is_finite() { ratio } else { 1.0 };
        Pose::exp(&(motion.log() * ratio.clamp(0.0, MAX_EXTRAPOLATION))) * self.frame.camera_from_world
    }
}
