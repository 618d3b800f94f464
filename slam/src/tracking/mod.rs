//! Following the camera: motion model, reference key frame or relocalisation, then the local map.

mod alignment;
pub(crate) mod frame;
mod keyframe_policy;
pub(crate) mod lines;
mod local_map;
mod pose;
mod primitives;
pub(crate) mod relocalisation;
pub(crate) mod search;

pub(crate) use local_map::Sightings;
use pose::{Placement, place_frame};
use primitives::PrimitiveTracks;

use crate::config::{ConfigError, ContinuityConfig, SlamConfig, TrackingConfig};
use crate::continuity::Reach;
use crate::features::FrameFeatures;
use crate::map::{FramePose, KeyframeId, Map, SubmapId};
use crate::report::{LostReason, TrackingOutcome};
use alignment::Aligner;
use frame::{Inliers, TrackedFrame};
use geometry::nalgebra::UnitQuaternion;
use geometry::{Camera, Pose};
use keyframe_policy::LastKeyframe;
use lines::LineTracks;
use local_map::LocalMap;
use relocalisation::Relocaliser;
use search::{Expected, match_keyframe, search_by_motion};
use std::collections::BTreeMap;
use std::sync::Arc;
use vision::GrayImage;

/// A gap in time longer than this many frame intervals is not bridged by the motion model: half a second of video.
const MAX_EXTRAPOLATION: f64 = 15.0;
/// Share of the latest interval in the mean speed, which so spans a third of a second of video.
const SPEED_UPDATE: f64 = 0.1;
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
    primitive_tracks: PrimitiveTracks,
    /// Absent where there are no images.
    aligner: Option<Aligner>,
    /// The image of the frame to be tracked.
    image: Option<Arc<GrayImage>>,
    /// Absent where a lost camera is not to be looked for.
    relocaliser: Option<Relocaliser>,
    /// How often points were seen since the last key frame.
    sightings: Sightings,
    last: Option<LastFrame>,
    /// Frames since the camera was last found by relocalisation.
    n_since_relocalisation: Option<u64>,
    last_keyframe: Option<LastKeyframe>,
    /// Time of the frame before, placed or not.
    last_timestamp_ns: Option<i64>,
    /// Where the camera was last seen in each submap.
    last_seen: BTreeMap<SubmapId, LastSeen>,
}

/// Where a camera was when it was last placed in a submap.
#[derive(Clone, Copy, Debug)]
struct LastSeen {
    place: FramePose,
    timestamp_ns: i64,
    /// Map units per nanosecond, the mean of late.
    speed: f64,
    /// The unit of the reference key frame that the speed is in.
    unit: f64,
}

/// The frame before, as the motion model needs it.
struct LastFrame {
    frame: TrackedFrame,
    image: Option<Arc<GrayImage>>,
    place: FramePose,
    /// The [unit](crate::map::Keyframe::unit) of the reference key frame when the motion was measured.
    unit: f64,
    /// `camera_now_from_camera_before` over the last interval, and that interval, nanoseconds.
    motion: Option<(Pose, i64)>,
}

impl Tracker {
    /// A tracker that looks for a lost camera in the whole map. `working_camera` is that of the images it [sees](Self::see).
    ///
    /// # Errors
    /// If the configuration of the search for vanishing points cannot be used.
    pub fn new(config: SlamConfig, working_camera: Camera) -> Result<Self, ConfigError> {
        let relocaliser = Relocaliser::new(&config)?;
        let aligner = Aligner::new(working_camera, config.alignment.clone());
        Ok(Self { relocaliser: Some(relocaliser), aligner: Some(aligner), ..Self::follower(config) })
    }

    /// A tracker that only follows: once lost it stays lost.
    pub fn follower(config: SlamConfig) -> Self {
        Self {
            config,
            local_map: LocalMap::default(),
            line_tracks: LineTracks::default(),
            primitive_tracks: PrimitiveTracks::default(),
            aligner: None,
            image: None,
            relocaliser: None,
            sightings: Sightings::default(),
            last: None,
            n_since_relocalisation: None,
            last_keyframe: None,
            last_timestamp_ns: None,
            last_seen: BTreeMap::new(),
        }
    }

    /// Takes the image of the frame that is tracked next.
    pub fn see(&mut self, image: Arc<GrayImage>) {
        self.image = Some(image);
    }

    /// Starts following from a frame whose pose is known.
    pub fn start(&mut self, frame: TrackedFrame, map: &Map) {
        self.last_keyframe = Some(LastKeyframe::of(&frame));
        self.n_since_relocalisation = None;
        self.last_timestamp_ns = Some(frame.timestamp_ns);
        self.remember(frame, map, None);
    }

    /// Takes over corrections that mapping made since the last frame.
    pub fn adopt(&mut self, map: &Map) {
        if let Some(relocaliser) = &mut self.relocaliser {
            relocaliser.learn(map);
        }
        self.line_tracks.learn(map);
        self.primitive_tracks.learn(map);
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
        let before = self.last_timestamp_ns.map_or(last.frame.camera_from_world, |time| last.predict(time));
        Some(last.predict(timestamp_ns).rotation * before.rotation.inverse())
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
        let tracked = self.try_track(sequence, timestamp_ns, features, map);
        self.last_timestamp_ns = Some(timestamp_ns);
        tracked
    }

    fn try_track(
        &mut self,
        sequence: u64,
        timestamp_ns: i64,
        features: Arc<FrameFeatures>,
        map: &Map,
    ) -> Tracked {
        let n_required = self.config.tracking.min_weak_inliers;
        if features.len() + features.lines.len() < n_required {
            let (n_keypoints, n_segments) = (features.len(), features.lines.len());
            let reason = LostReason::TooFewFeatures { n_keypoints, n_segments, n_required };
            return self.lose(timestamp_ns, reason);
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
            self.follow(last, frame, map)
        });
        if let Some(mut frame) = followed {
            let (placement, n_expected) = self.track_local_map(&mut frame, map);
            let outcome = judge(&placement, n_expected, self.is_coasting(), &self.config.tracking);
            return self.conclude(frame, placement.inliers, outcome, false, map);
        }
        let blank = blank(Pose::identity(), KeyframeId::from_index(0), SubmapId::default());
        let found = self.relocalise(&blank, map, None);
        let n_candidates = self.relocaliser.as_ref().map_or(0, Relocaliser::n_candidates);
        match found {
            Some((frame, inliers, outcome)) => self.conclude(frame, inliers, outcome, true, map),
            None => {
                let lost = self.lose(timestamp_ns, LostReason::NotRelocalised { n_candidates });
                Tracked { n_candidates: Some(n_candidates), ..lost }
            }
        }
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
        let reference = KeyframeId::from_index(0);
        let blank =
            TrackedFrame::blank(sequence, timestamp_ns, features, Pose::identity(), reference, except);
        let before = self.last.take();
        match self.relocalise(&blank, map, Some(except)) {
            Some((frame, inliers, outcome @ TrackingOutcome::Tracked)) => {
                Some(self.conclude(frame, inliers, outcome, true, map))
            }
            _ => {
                self.last = before;
                None
            }
        }
    }

    /// Tries the places that look like a frame until one fits that the camera can have reached.
    fn relocalise(
        &mut self,
        blank: &TrackedFrame,
        map: &Map,
        except: Option<SubmapId>,
    ) -> Option<(TrackedFrame, Inliers, TrackingOutcome)> {
        let reaches: Vec<Reach> = self
            .last_seen
            .values()
            .filter_map(|seen| seen.reach(map, blank.timestamp_ns, &self.config.continuity))
            .collect();
        let candidates = self.relocaliser.as_mut()?.candidates(blank, map, except);
        for candidate in candidates {
            let found = map
                .keyframe(candidate)
                .and_then(|keyframe| self.relocaliser.as_mut()?.try_place(blank, keyframe, map));
            let Some(mut frame) = found else { continue };
            let before = (self.n_since_relocalisation.replace(0), self.sightings.clone());
            let (placement, n_expected) = self.track_local_map(&mut frame, map);
            let outcome = judge(&placement, n_expected, true, &self.config.tracking);
            let is_lost = matches!(outcome, TrackingOutcome::Lost(_));
            if !is_lost && self.is_credible(&frame, placement.inliers, n_expected, &reaches) {
                return Some((frame, placement.inliers, outcome));
            }
            (self.n_since_relocalisation, self.sightings) = before;
        }
        None
    }

    /// Whether enough of what a place should show was found there: where two places look alike, it is what both have.
    fn is_credible(
        &self,
        frame: &TrackedFrame,
        inliers: Inliers,
        n_expected: usize,
        reaches: &[Reach],
    ) -> bool {
        // A camera seen a moment ago in another submap is at a place of this one that nothing is known of.
        let reach = reaches.iter().find(|reach| reach.submap == frame.submap);
        let centre = frame.camera_from_world.centre();
        if reach.map_or(reaches.is_empty(), |reach| reach.includes(&centre)) {
            return self.config.relocalisation.is_enough(inliers.total(), n_expected);
        }
        let continuity = &self.config.continuity;
        let share = inliers.total() as f64 / n_expected.max(1) as f64;
        inliers.total() >= continuity.n_beyond_doubt && share >= continuity.share_beyond_doubt
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

    /// By the motion so far, or, where little is found by that, by what the reference key frame sees.
    fn follow(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<TrackedFrame> {
        self.primitive_tracks.associate(&mut frame, map);
        let by_motion = self.follow_motion(last, frame.clone(), map);
        if by_motion
            .as_ref()
            .is_some_and(|(_, n_inliers)| *n_inliers >= self.config.tracking.min_motion_matches)
        {
            return by_motion.map(|(frame, _)| frame);
        }
        let by_reference = self.follow_reference(last, frame.clone(), map);
        let enough = |(_, n_inliers): &(_, usize)| *n_inliers >= self.config.tracking.min_motion_matches;
        let is_enough = by_reference.as_ref().is_some_and(enough);
        let by_image = if is_enough { None } else { self.follow_image(last, frame, map) };
        let found = [by_motion, by_reference, by_image];
        found.into_iter().flatten().max_by_key(|(_, n_inliers)| *n_inliers).map(|(frame, _)| frame)
    }

    /// Points of the last frame, looked for where the images show that the camera moved.
    fn follow_image(
        &self,
        last: &LastFrame,
        mut frame: TrackedFrame,
        map: &Map,
    ) -> Option<(TrackedFrame, usize)> {
        let (before, now) = (last.image.as_ref()?, self.image.as_ref()?);
        let last_from_world = last.frame.camera_from_world;
        let expected = frame.camera_from_world * last_from_world.inverse();
        let positions = last.frame.landmark_positions(map);
        let now_from_last = self.aligner.as_ref()?.align(before, now, &positions, &expected)?;
        frame.camera_from_world = now_from_last * last_from_world;
        self.follow_prediction(last, frame, map)
    }

    /// Points of the last frame, projected to where the motion so far would take them. Returns how many agree.
    fn follow_motion(
        &self,
        last: &LastFrame,
        frame: TrackedFrame,
        map: &Map,
    ) -> Option<(TrackedFrame, usize)> {
        last.motion.as_ref()?;
        self.follow_prediction(last, frame, map)
    }

    /// Landmarks of the last frame, looked for where the frame's pose so far puts them. Returns how many agree.
    fn follow_prediction(
        &self,
        last: &LastFrame,
        mut frame: TrackedFrame,
        map: &Map,
    ) -> Option<(TrackedFrame, usize)> {
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
        let n_inliers = place_frame(&mut frame, map, &self.config.primitives).inliers.total();
        (n_inliers >= config.min_first_inliers).then_some((frame, n_inliers))
    }

    /// Points of the reference key frame, recognised by their descriptors, starting from the last pose. Returns how many
    /// agree.
    fn follow_reference(
        &self,
        last: &LastFrame,
        mut frame: TrackedFrame,
        map: &Map,
    ) -> Option<(TrackedFrame, usize)> {
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
        let n_inliers = place_frame(&mut frame, map, &self.config.primitives).inliers.total();
        (n_inliers >= config.min_first_inliers).then_some((frame, n_inliers))
    }

    /// Finds more of what is near and places the frame by all of it. Returns how many points could have been found, too.
    fn track_local_map(&mut self, frame: &mut TrackedFrame, map: &Map) -> (Placement, usize) {
        let config = &self.config.tracking;
        if let Some(reference) = self.local_map.collect(map, frame, config) {
            frame.reference = reference;
            frame.submap = map.keyframe(reference).map_or(frame.submap, |keyframe| keyframe.submap);
        }
        let wide = self.n_since_relocalisation.is_some_and(|n| n < WIDE_SEARCH_FRAMES);
        let radius = config.map_search_radius_px * if wide { WIDE_SEARCH_FACTOR } else { 1.0 };
        let n_visible = self.local_map.search(map, frame, radius, config, &mut self.sightings);
        self.local_map.search_lines(map, frame, &self.config.lines, &mut self.sightings);
        let placement = place_frame(frame, map, &self.config.primitives);
        frame.points.iter().flatten().for_each(|id| self.sightings.found(*id));
        frame.lines.iter().flatten().for_each(|id| self.sightings.line_found(*id));
        // Of crowded places the extractor picks only so many keypoints.
        (placement, n_visible.min(frame.features.len()))
    }

    /// Remembers a placed and judged frame for the next.
    fn conclude(
        &mut self,
        frame: TrackedFrame,
        inliers: Inliers,
        outcome: TrackingOutcome,
        relocalised: bool,
        map: &Map,
    ) -> Tracked {
        if let TrackingOutcome::Lost(reason) = outcome {
            return self.lose(frame.timestamp_ns, reason);
        }
        if let Some(n) = self.n_since_relocalisation.as_mut().filter(|_| !relocalised) {
            *n += 1;
        }
        let motion = self.last.as_ref().filter(|_| !relocalised).map(|last| {
            let motion = frame.camera_from_world * last.frame.camera_from_world.inverse();
            (motion, frame.timestamp_ns - last.frame.timestamp_ns)
        });
        self.line_tracks.remember(&frame);
        self.primitive_tracks.remember(&frame);
        // Weak poses jump about: their motion says nothing of the camera's.
        let is_good = matches!(outcome, TrackingOutcome::Tracked);
        self.note_seen(&frame, motion.as_ref().filter(|_| is_good), map);
        self.remember(frame.clone(), map, motion);
        let searched = self.relocaliser.as_ref().filter(|_| relocalised);
        let n_candidates = searched.map(Relocaliser::n_candidates);
        Tracked { outcome, frame: Some(frame), inliers, relocalised, n_candidates }
    }

    fn remember(&mut self, frame: TrackedFrame, map: &Map, motion: Option<(Pose, i64)>) {
        let unit = map.anchor_of(frame.reference).map_or(1.0, |anchor| anchor.unit);
        let image = self.image.clone();
        self.last = frame.pose_in(map).map(|place| LastFrame { frame, image, place, unit, motion });
    }

    /// Whether the frame before had no pose.
    fn is_coasting(&self) -> bool {
        self.last.as_ref().is_some_and(|last| self.last_timestamp_ns != Some(last.frame.timestamp_ns))
    }

    fn note_seen(&mut self, frame: &TrackedFrame, motion: Option<&(Pose, i64)>, map: &Map) {
        let Some((place, anchor)) = frame.pose_in(map).zip(map.anchor_of(frame.reference)) else { return };
        let (timestamp_ns, unit) = (frame.timestamp_ns, anchor.unit);
        let now =
            motion.map(|(motion, interval_ns)| motion.translation.norm() / interval_ns.abs().max(1) as f64);
        let known = self.last_seen.get(&frame.submap).filter(|seen| seen.speed > 0.0);
        let before = known.map(|seen| seen.speed * unit / seen.unit);
        let speed = match (before, now) {
            (Some(before), Some(now)) => before + SPEED_UPDATE * (now - before),
            (before, now) => before.or(now).unwrap_or(0.0),
        };
        self.last_seen.insert(frame.submap, LastSeen { place, timestamp_ns, speed, unit });
    }

    /// For a while the camera is looked for where it was heading; after that only by recognising places.
    fn lose(&mut self, timestamp_ns: i64, reason: LostReason) -> Tracked {
        let max_coasting_ns = self.config.tracking.max_coasting_ns;
        let is_recent = |last: &LastFrame| (timestamp_ns - last.frame.timestamp_ns).abs() <= max_coasting_ns;
        self.last = self.last.take().filter(is_recent);
        Tracked {
            outcome: TrackingOutcome::Lost(reason),
            frame: None,
            inliers: Inliers::default(),
            relocalised: false,
            n_candidates: None,
        }
    }
}

/// Whether enough landmarks agree with a pose, and whether they determine it. [ALGORITHMS 9]
///
/// Few landmarks are enough in a place that has few, but where `n_expected` could have been found and hardly any was, the
/// few agree by chance.
fn judge(
    placement: &Placement,
    n_expected: usize,
    was_lost: bool,
    config: &TrackingConfig,
) -> TrackingOutcome {
    let Placement { inliers, uncertainty } = *placement;
    let n_inliers = inliers.total();
    let max_rotation_rad = config.max_rotation_sigma_deg.to_radians();
    let within = |factor: f64| {
        uncertainty.rotation_rad <= factor * max_rotation_rad
            && uncertainty.position_share <= factor * config.max_position_sigma_share
    };
    let n_required_of = |share: f64, least: usize, plenty: usize| {
        ((share * n_expected as f64).ceil() as usize).clamp(least, plenty)
    };
    let n_required_good = n_required_of(config.min_found_share, config.min_inliers, config.plentiful_inliers);
    let n_required_weak = n_required_of(
        0.5 * config.min_found_share,
        config.min_weak_inliers,
        config.plentiful_inliers.div_ceil(2),
    );
    // A camera that was lost may be anywhere: a weak pose is no evidence that it was found.
    let n_required_weak = if was_lost { n_required_good } else { n_required_weak };
    if n_inliers < n_required_weak {
        let n_required = n_required_weak;
        TrackingOutcome::Lost(LostReason::TooFewInliers { n_inliers, n_required })
    } else if !within(config.weak_sigma_factor) {
        TrackingOutcome::Lost(LostReason::Undetermined { uncertainty })
    } else if n_inliers < n_required_good || !within(1.0) {
        TrackingOutcome::Weak { n_inliers, n_required: n_required_good, uncertainty }
    } else {
        TrackingOutcome::Tracked
    }
}

impl LastSeen {
    fn reach(&self, map: &Map, timestamp_ns: i64, config: &ContinuityConfig) -> Option<Reach> {
        let (_, camera_from_world) = map.locate(&self.place)?;
        let speed = self.speed * map.anchor_of(self.place.reference)?.unit / self.unit;
        let elapsed_ns = timestamp_ns - self.timestamp_ns;
        Reach::from(map, self.place.reference, &camera_from_world.centre(), speed, elapsed_ns, config)
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
