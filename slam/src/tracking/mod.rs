//! Tracking: motion model, reference keyframe, direct alignment or relocalization, then the local map.

mod alignment;
mod following;
pub(crate) mod frame;
pub(crate) mod judgement;
mod keyframe_policy;
mod lines;
mod local_map;
mod pose;
mod primitives;
mod recovery;
pub(crate) mod relocalization;
mod single;
#[cfg(test)]
mod tests;
mod unrolling;

use crate::config::{ConfigError, SlamConfig};
use crate::features::View;
use crate::landmarks::VisibilityCounts;
use crate::map::{Map, MapCamera, SubmapId};
use crate::report::{LostReason, TrackingOutcome};
use crate::rolling_shutter::RollingShutter;
use alignment::Aligner;
use following::{LastFrame, PoseStart};
use frame::{Inliers, TrackedFrame};
use geometry::nalgebra::UnitQuaternion;
use geometry::{Camera, Pose};
use judgement::judge;
use keyframe_policy::LastKeyframe;
use lines::LineTracks;
use local_map::LocalMap;
use primitives::PrimitiveTracks;
use recovery::LastSeen;
use relocalization::Relocalizer;
pub(crate) use single::Located;
use std::collections::BTreeMap;
use std::sync::Arc;
use vision::GrayImage;

/// What tracking a frame came to.
#[derive(Debug)]
pub(crate) struct Tracked {
    pub outcome: TrackingOutcome,
    /// The frame, where it has a pose.
    pub frame: Option<TrackedFrame>,
    pub inliers: Inliers,
    pub relocalized: bool,
    /// Places that were tried, if the camera had to be looked for.
    pub n_candidates: Option<usize>,
}

/// Follows the camera in a map that it only reads.
pub(crate) struct Tracker {
    config: SlamConfig,
    /// Whose frames it follows.
    camera: MapCamera,
    local_map: LocalMap,
    line_tracks: LineTracks,
    primitive_tracks: PrimitiveTracks,
    /// Absent where all rows are read at once.
    rolling_shutter: Option<RollingShutter>,
    /// Absent where there are no images.
    aligner: Option<Aligner>,
    /// The image of the frame to be tracked.
    image: Option<Arc<GrayImage>>,
    /// Absent where a lost camera is not to be looked for.
    relocalizer: Option<Relocalizer>,
    /// How often points were seen since the last keyframe.
    visibility: VisibilityCounts,
    last: Option<LastFrame>,
    /// Frames since the camera was last found by relocalization.
    n_since_relocalization: Option<u64>,
    last_keyframe: Option<LastKeyframe>,
    /// Time of the frame before, placed or not.
    last_timestamp_ns: Option<i64>,
    /// Where the camera was last seen in each submap.
    last_seen: BTreeMap<SubmapId, LastSeen>,
}

impl Tracker {
    /// A tracker that looks for a lost camera in the whole map. `working_camera` is that of the images it [is
    /// given](Self::set_image).
    ///
    /// # Errors
    /// If the configuration of the search for vanishing points cannot be used.
    pub fn new(
        config: SlamConfig,
        camera: MapCamera,
        working_camera: Camera,
        rolling_shutter: Option<RollingShutter>,
    ) -> Result<Self, ConfigError> {
        let relocalizer = Relocalizer::new(&config)?;
        let aligner = Aligner::new(working_camera, config.alignment.clone());
        let follower = Self { camera, ..Self::follower(config, rolling_shutter) };
        Ok(Self { relocalizer: Some(relocalizer), aligner: Some(aligner), ..follower })
    }

    /// A tracker that only follows: once lost it stays lost.
    pub fn follower(config: SlamConfig, rolling_shutter: Option<RollingShutter>) -> Self {
        Self {
            config,
            camera: MapCamera::default(),
            rolling_shutter,
            local_map: LocalMap::default(),
            line_tracks: LineTracks::default(),
            primitive_tracks: PrimitiveTracks::default(),
            aligner: None,
            image: None,
            relocalizer: None,
            visibility: VisibilityCounts::default(),
            last: None,
            n_since_relocalization: None,
            last_keyframe: None,
            last_timestamp_ns: None,
            last_seen: BTreeMap::new(),
        }
    }

    /// Takes over what is known of the camera's shutter.
    pub fn set_rolling_shutter(&mut self, rolling_shutter: Option<RollingShutter>) {
        self.rolling_shutter = rolling_shutter;
    }

    /// Takes the image of the frame that is tracked next.
    pub fn set_image(&mut self, image: Arc<GrayImage>) {
        self.image = Some(image);
    }

    /// The image of the last frame.
    pub fn image(&self) -> Option<&Arc<GrayImage>> {
        self.image.as_ref()
    }

    /// Starts following from a frame whose pose is known.
    pub fn start(&mut self, frame: TrackedFrame, map: &Map) {
        self.last_keyframe = Some(LastKeyframe::of(&frame));
        self.n_since_relocalization = None;
        self.last_timestamp_ns = Some(frame.timestamp_ns);
        self.remember(frame, map, None);
    }

    /// Takes over corrections that mapping made since the last frame.
    pub fn sync_map(&mut self, map: &Map) {
        if let Some(relocalizer) = &mut self.relocalizer {
            relocalizer.update(map);
        }
        if let Some(aligner) = &mut self.aligner {
            aligner.correct_camera(map.correction_of(self.camera));
        }
        self.line_tracks.update(map);
        self.primitive_tracks.update(map);
        let Some(last) = &mut self.last else { return };
        let Some((anchor, (submap, camera_from_world))) =
            map.anchor_of(last.place.reference).zip(map.locate(&last.place))
        else {
            self.last = None;
            return;
        };
        (last.frame.submap, last.frame.camera_from_world) = (submap, camera_from_world);
        if let Some((motion, _)) = &mut last.motion {
            motion.translation *= anchor.local_scale / last.local_scale;
        }
        last.local_scale = anchor.local_scale;
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

    /// Forgets where the camera was: the next frame is relocalized.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// Hands out how often points were seen and begins counting anew.
    pub fn take_visibility_counts(&mut self) -> VisibilityCounts {
        std::mem::take(&mut self.visibility)
    }

    /// Finds the pose of a frame in the map.
    pub fn track(&mut self, view: &View, map: &Map) -> Tracked {
        let tracked = self.try_track(view, map);
        self.last_timestamp_ns = Some(view.timestamp_ns);
        tracked
    }

    fn try_track(&mut self, view: &View, map: &Map) -> Tracked {
        let (n_keypoints, n_segments) = (view.features.len(), view.features.lines.len());
        let n_required = self.config.tracking.min_weak_inliers;
        if n_keypoints + n_segments < n_required {
            let reason = LostReason::TooFewFeatures { n_keypoints, n_segments, n_required };
            return self.lose(view.timestamp_ns, reason);
        }
        let unrolled = self.unroll_expected(view, map);
        if let Some(mut found) = self.follow_in_map(unrolled.as_ref().unwrap_or(view), map) {
            self.unroll_found(view, &mut found, map);
            let outcome =
                judge(&found.placement, found.n_expected, self.is_coasting(), &self.config.tracking);
            return self.conclude(found.frame, found.placement.inliers, outcome, found.start, map);
        }
        let found = self.relocalize(view, map, None);
        let n_candidates = self.relocalizer.as_ref().map_or(0, Relocalizer::n_candidates);
        match found {
            Some((frame, inliers, outcome)) => {
                self.conclude(frame, inliers, outcome, PoseStart::Relocalized, map)
            }
            None => {
                let lost = self.lose(view.timestamp_ns, LostReason::NotRelocalized { n_candidates });
                Tracked { n_candidates: Some(n_candidates), ..lost }
            }
        }
    }

    /// Passes a frame that is a keyframe, whose pose the map knows better than tracking would.
    pub fn pass(&mut self, frame: TrackedFrame, map: &Map) {
        let timestamp_ns = frame.timestamp_ns;
        self.conclude(frame, Inliers::default(), TrackingOutcome::Tracked, PoseStart::Followed, map);
        self.last_timestamp_ns = Some(timestamp_ns);
    }

    /// Whether a frame with these inliers should become a keyframe.
    pub fn wants_keyframe(&self, frame: &TrackedFrame, inliers: Inliers, map: &Map) -> bool {
        keyframe_policy::wants_keyframe(
            &self.config.keyframes,
            map,
            frame,
            inliers,
            self.last_keyframe.as_ref(),
            self.n_since_relocalization,
        )
    }

    /// Notes that a frame became a keyframe.
    pub fn became_keyframe(&mut self, frame: &TrackedFrame) {
        self.last_keyframe = Some(LastKeyframe::of(frame));
    }

    /// Remembers a placed and judged frame for the next.
    fn conclude(
        &mut self,
        frame: TrackedFrame,
        inliers: Inliers,
        outcome: TrackingOutcome,
        start: PoseStart,
        map: &Map,
    ) -> Tracked {
        if let TrackingOutcome::Lost(reason) = outcome {
            return self.lose(frame.timestamp_ns, reason);
        }
        if let Some(last_keyframe) = &mut self.last_keyframe {
            last_keyframe.note_found(inliers.total());
        }
        let relocalized = start == PoseStart::Relocalized;
        if let Some(n) = self.n_since_relocalization.as_mut().filter(|_| !relocalized) {
            *n += 1;
        }
        let motion = self.last.as_ref().filter(|_| !relocalized).and_then(|last| {
            let motion = frame.camera_from_world * last.frame.camera_from_world.inverse();
            let motion = (motion, frame.timestamp_ns - last.frame.timestamp_ns);
            (start == PoseStart::Followed || !last.is_cut_before(&motion)).then_some(motion)
        });
        self.line_tracks.remember(&frame);
        self.primitive_tracks.remember(&frame);
        // Weak poses jump about: their motion says nothing of the camera's.
        let is_good = matches!(outcome, TrackingOutcome::Tracked);
        self.note_seen(&frame, motion.as_ref().filter(|_| is_good), map);
        self.remember(frame.clone(), map, motion);
        let searched = self.relocalizer.as_ref().filter(|_| relocalized);
        let n_candidates = searched.map(Relocalizer::n_candidates);
        Tracked { outcome, frame: Some(frame), inliers, relocalized, n_candidates }
    }

    fn remember(&mut self, frame: TrackedFrame, map: &Map, motion: Option<(Pose, i64)>) {
        let local_scale = map.anchor_of(frame.reference).map_or(1.0, |anchor| anchor.local_scale);
        let image = self.image.clone();
        self.last = frame.pose_in(map).map(|place| LastFrame { frame, image, place, local_scale, motion });
    }

    /// Whether the frame before had no pose.
    fn is_coasting(&self) -> bool {
        self.last.as_ref().is_some_and(|last| self.last_timestamp_ns != Some(last.frame.timestamp_ns))
    }

    /// For a while the camera is looked for where it was heading; after that only by recognizing places.
    fn lose(&mut self, timestamp_ns: i64, reason: LostReason) -> Tracked {
        let max_coasting_ns = self.config.tracking.max_coasting_ns;
        let is_recent = |last: &LastFrame| (timestamp_ns - last.frame.timestamp_ns).abs() <= max_coasting_ns;
        self.last = self.last.take().filter(is_recent);
        Tracked {
            outcome: TrackingOutcome::Lost(reason),
            frame: None,
            inliers: Inliers::default(),
            relocalized: false,
            n_candidates: None,
        }
    }
}
