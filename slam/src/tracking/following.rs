//! Tracking: the pose of a frame from that of the one before (motion model, reference keyframe, direct
//! alignment, in the order of how much each assumes), then from the local map.
//! [method: Pose from the last frame]

use super::Tracker;
use super::frame::TrackedFrame;
use super::pose::{Placement, place_frame};
use crate::features::View;
use crate::landmarks::VisibleLandmarks;
use crate::map::{FramePose, Map};
use crate::matching::{Expected, match_keyframe, search_by_motion};
use geometry::Pose;
use std::sync::Arc;
use vision::GrayImage;

/// A gap in time longer than this many frame intervals is not bridged by the motion model: half a second of
/// video.
const MAX_EXTRAPOLATION: f64 = 15.0;
/// Frames after a relocalization in which the local map is searched more widely, and how much.
const WIDE_SEARCH_FRAMES: u64 = 10;
const WIDE_SEARCH_FACTOR: f64 = 2.5;
/// A frame that is recognized this many times as far off as the motion so far leads to was taken after a cut:
/// people and cars speed up two- or threefold from one image to the next, cuts are dozens of steps wide.
const CUT_SPEED_FACTOR: f64 = 8.0;

/// The frame before, as the motion model needs it.
pub(super) struct LastFrame {
    pub frame: TrackedFrame,
    pub image: Option<Arc<GrayImage>>,
    pub place: FramePose,
    /// The [local scale](crate::map::Keyframe::local_scale) of the reference keyframe when the motion was
    /// measured.
    pub local_scale: f64,
    /// `camera_now_from_camera_before` over the last interval, and that interval, nanoseconds.
    pub motion: Option<(Pose, i64)>,
}

/// A frame that was followed from the one before, and how many landmarks agree with its pose.
struct Followed {
    frame: TrackedFrame,
    n_inliers: usize,
}

/// What the pose of a frame is found from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PoseStart {
    /// From the frame before.
    Followed,
    /// From what a keyframe shows, by descriptors alone.
    Recognized,
    /// From a place that was looked for in the whole map.
    Relocalized,
}

/// A frame placed by the local map.
pub(super) struct InLocalMap {
    pub frame: TrackedFrame,
    pub placement: Placement,
    /// Points that could have been found.
    pub n_expected: usize,
    /// What should be visible under the pose it was looked for with.
    pub visible: VisibleLandmarks,
    /// Where the search began.
    pub start: PoseStart,
}

impl InLocalMap {
    fn n_inliers(&self) -> usize {
        self.placement.inliers.total()
    }
}

impl Tracker {
    /// Follows a frame into the local map. Where much less is found than in the frame before, the pose may be
    /// wrong in a way that the landmarks it was found by cannot tell: poses found from keyframes by
    /// descriptors alone then compete with it, and the one with which the most landmarks agree wins.
    pub(super) fn follow_in_map(&mut self, view: &View, map: &Map) -> Option<InLocalMap> {
        let last = self.last.take()?;
        let followed =
            self.follow(&last, view, map).map(|frame| self.track_local_map(frame, PoseStart::Followed, map));
        let n_required = self.config.tracking.doubtful_kept_share * last.frame.n_landmarks() as f64;
        let found = match followed {
            Some(found) if found.n_inliers() as f64 >= n_required => Some(found),
            found => self.compete(found, &last, view, map),
        };
        self.last = Some(last);
        if let Some(found) = &found {
            self.count_visibility(found);
        }
        found
    }

    /// The better of a doubtful pose and those found from the keyframes that were last seen, by descriptors.
    fn compete(
        &mut self,
        mut best: Option<InLocalMap>,
        last: &LastFrame,
        view: &View,
        map: &Map,
    ) -> Option<InLocalMap> {
        let mut reference_ids = vec![last.frame.reference];
        reference_ids.extend(best.as_ref().map(|found| found.frame.reference));
        reference_ids.dedup();
        for id in reference_ids {
            let Some(keyframe) = map.keyframe(id) else { continue };
            let Some(frame) =
                self.relocalizer.as_mut().and_then(|relocalizer| relocalizer.try_place(view, keyframe, map))
            else {
                continue;
            };
            let found = self.track_local_map(frame, PoseStart::Recognized, map);
            let n_best = best.as_ref().map_or(0, InLocalMap::n_inliers);
            if found.n_inliers() as f64 > self.config.tracking.better_pose_factor * n_best as f64 {
                best = Some(found);
            }
        }
        best
    }

    /// By the motion so far, or, where little is found by that, by what the reference keyframe sees or by
    /// the images.
    pub(super) fn follow(&self, last: &LastFrame, view: &View, map: &Map) -> Option<TrackedFrame> {
        let predicted = last.predict(view.timestamp_ns);
        let mut frame = TrackedFrame::blank(view, predicted, last.frame.reference, last.frame.submap);
        self.primitive_tracks.associate(&mut frame, map);
        let is_enough = |found: &Option<Followed>| {
            found.as_ref().is_some_and(|found| found.n_inliers >= self.config.tracking.min_motion_matches)
        };
        let by_motion =
            last.motion.is_some().then(|| self.follow_prediction(last, frame.clone(), map)).flatten();
        if is_enough(&by_motion) {
            return by_motion.map(|found| found.frame);
        }
        let by_reference = self.follow_reference(last, frame.clone(), map);
        let by_image = if is_enough(&by_reference) { None } else { self.follow_image(last, frame, map) };
        let found = [by_motion, by_reference, by_image];
        found.into_iter().flatten().max_by_key(|found| found.n_inliers).map(|found| found.frame)
    }

    /// Landmarks of the last frame, looked for where the images show that the camera moved.
    fn follow_image(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<Followed> {
        let (before, now) = (last.image.as_ref()?, self.image.as_ref()?);
        let last_from_world = last.frame.camera_from_world;
        let expected = frame.camera_from_world * last_from_world.inverse();
        let positions = last.frame.landmark_positions(map);
        let now_from_last = self.aligner.as_ref()?.align(before, now, &positions, &expected)?;
        frame.camera_from_world = now_from_last * last_from_world;
        self.follow_prediction(last, frame, map)
    }

    /// Landmarks of the last frame, looked for where the frame's pose so far puts them.
    fn follow_prediction(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<Followed> {
        let config = &self.config.tracking;
        let features = frame.features.clone();
        let radius = config.motion_search_radius_px;
        for radius in [radius, 2.0 * radius] {
            frame.points.fill(None);
            let expected = last.frame.points.iter().enumerate().filter_map(|(idx, id)| {
                let point = map.point((*id)?)?;
                let keypoint = &last.frame.features.keypoints[idx];
                let descriptor = &point.descriptor;
                Some(Expected { point, octave: keypoint.octave, angle: keypoint.angle, descriptor })
            });
            let pose = &frame.camera_from_world;
            if search_by_motion(&features, pose, expected, radius, &mut frame.points)
                >= config.min_motion_matches
            {
                break;
            }
        }
        self.place_followed(frame, map)
    }

    /// Points of the reference keyframe, recognized by their descriptors, starting from the last pose.
    fn follow_reference(&self, last: &LastFrame, mut frame: TrackedFrame, map: &Map) -> Option<Followed> {
        let reference = map.keyframe(last.frame.reference)?;
        let matches = match_keyframe(reference, &frame.features);
        if matches.len() < self.config.tracking.min_reference_matches {
            return None;
        }
        frame.camera_from_world = last.frame.camera_from_world;
        for (feature_idx, id) in matches {
            frame.points[feature_idx] = Some(id);
        }
        self.place_followed(frame, map)
    }

    /// Adds the lines that the frame's segments are known to be of, and places it by all of it.
    fn place_followed(&self, mut frame: TrackedFrame, map: &Map) -> Option<Followed> {
        let n_required = self.config.tracking.min_first_inliers;
        self.line_tracks.associate(&mut frame, map, &self.config.lines);
        if frame.points.iter().flatten().count() + frame.lines.iter().flatten().count() < n_required {
            return None;
        }
        let n_inliers = place_frame(&mut frame, map, &self.config.primitives).inliers.total();
        (n_inliers >= n_required).then_some(Followed { frame, n_inliers })
    }

    /// Finds more of what is near and places the frame by all of it. Counts nothing: the pose may yet be
    /// refused.
    pub(super) fn track_local_map(
        &mut self,
        mut frame: TrackedFrame,
        start: PoseStart,
        map: &Map,
    ) -> InLocalMap {
        let config = &self.config.tracking;
        if let Some(reference) = self.local_map.collect(map, &frame, config) {
            frame.reference = reference;
            frame.submap = map.keyframe(reference).map_or(frame.submap, |keyframe| keyframe.submap);
        }
        let wide = self.n_since_relocalization.is_some_and(|n| n < WIDE_SEARCH_FRAMES);
        let radius = config.map_search_radius_px * if wide { WIDE_SEARCH_FACTOR } else { 1.0 };
        let points = self.local_map.search(map, &mut frame, radius, config);
        let lines = self.local_map.search_lines(map, &mut frame, &self.config.lines);
        let visible = VisibleLandmarks { points, lines };
        let placement = place_frame(&mut frame, map, &self.config.primitives);
        // Of crowded places the extractor picks only so many keypoints.
        let n_expected = visible.points.len().min(frame.features.len());
        InLocalMap { frame, placement, n_expected, visible, start }
    }

    /// Counts what a frame whose pose is accepted should have seen and did.
    pub(super) fn count_visibility(&mut self, found: &InLocalMap) {
        let InLocalMap { frame, visible, .. } = found;
        visible.points.iter().for_each(|id| self.visibility.visible(*id));
        visible.lines.iter().for_each(|id| self.visibility.line_visible(*id));
        frame.points.iter().flatten().for_each(|id| self.visibility.found(*id));
        frame.lines.iter().flatten().for_each(|id| self.visibility.line_found(*id));
    }
}

impl LastFrame {
    /// Whether the recording seems to be cut after this frame: the way to the next, and the time it took, is
    /// no motion that could go on.
    pub fn is_cut_before(&self, (motion, interval_ns): &(Pose, i64)) -> bool {
        let speed = |motion: &Pose, interval_ns: i64| motion.translation.norm() / interval_ns.abs() as f64;
        self.motion.as_ref().is_some_and(|(before, before_ns)| {
            speed(motion, *interval_ns) > CUT_SPEED_FACTOR * speed(before, *before_ns)
        })
    }

    /// The pose the motion so far leads to, for equal velocity over a frame interval that may differ from the
    /// last.
    pub fn predict(&self, timestamp_ns: i64) -> Pose {
        let Some((motion, interval_ns)) = &self.motion else { return self.frame.camera_from_world };
        // Both are negative when a recording is followed backwards.
        let ratio = (timestamp_ns - self.frame.timestamp_ns) as f64 / *interval_ns as f64;
        let ratio = if ratio.is_finite() { ratio } else { 1.0 };
        Pose::exp(&(motion.log() * ratio.clamp(0.0, MAX_EXTRAPOLATION))) * self.frame.camera_from_world
    }
}
