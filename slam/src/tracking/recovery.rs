//! Recovery of a lost camera: candidates for relocalization, and whether one is credible.

use super::following::{InLocalMap, PoseStart};
use super::frame::{Inliers, TrackedFrame};
use super::judgement::judge;
use super::{Tracked, Tracker};
use crate::config::ContinuityConfig;
use crate::continuity::Reach;
use crate::features::View;
use crate::map::{FramePose, Map, SubmapId};
use crate::report::TrackingOutcome;
use geometry::Pose;

/// Share of the latest interval in the mean speed, which so spans a third of a second of video.
const SPEED_UPDATE: f64 = 0.1;

/// Where a camera was when it was last placed in a submap.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastSeen {
    place: FramePose,
    timestamp_ns: i64,
    /// Map units per nanosecond, the mean of late.
    speed: f64,
    /// The local scale of the reference keyframe that the speed is in.
    local_scale: f64,
}

impl Tracker {
    /// Looks for a frame in the submaps other than the one it is followed in. Where it is found there, the
    /// camera is followed there from now on.
    pub fn find_elsewhere(&mut self, view: &View, map: &Map, except: SubmapId) -> Option<Tracked> {
        let before = self.last.take();
        match self.relocalize(view, map, Some(except)) {
            Some((frame, inliers, outcome @ TrackingOutcome::Tracked)) => {
                Some(self.conclude(frame, inliers, outcome, PoseStart::Relocalized, map))
            }
            _ => {
                self.last = before;
                None
            }
        }
    }

    /// Tries the places that look like a frame until one fits that the camera can have reached.
    pub(super) fn relocalize(
        &mut self,
        view: &View,
        map: &Map,
        except: Option<SubmapId>,
    ) -> Option<(TrackedFrame, Inliers, TrackingOutcome)> {
        let (found, outcome) = self.search(view, map, except)?;
        Some((found.frame, found.placement.inliers, outcome))
    }

    pub(super) fn search(
        &mut self,
        view: &View,
        map: &Map,
        except: Option<SubmapId>,
    ) -> Option<(InLocalMap, TrackingOutcome)> {
        let reaches: Vec<Reach> = self
            .last_seen
            .values()
            .filter_map(|seen| seen.reach(map, view.timestamp_ns, &self.config.continuity))
            .collect();
        for candidate in self.relocalizer.as_mut()?.candidates(view, map, except) {
            let found = map
                .keyframe(candidate)
                .and_then(|keyframe| self.relocalizer.as_mut()?.try_place(view, keyframe, map));
            let Some(frame) = found else { continue };
            let before = self.n_since_relocalization.replace(0);
            let found = self.track_local_map(frame, PoseStart::Relocalized, map);
            let (inliers, n_expected) = (found.placement.inliers, found.n_expected);
            let outcome = judge(&found.placement, n_expected, true, &self.config.tracking);
            let is_lost = matches!(outcome, TrackingOutcome::Lost(_));
            if !is_lost && self.is_credible(&found.frame, inliers, n_expected, &reaches) {
                self.count_visibility(&found);
                return Some((found, outcome));
            }
            self.n_since_relocalization = before;
        }
        None
    }

    /// Whether enough of what a place should show was found there: where two places look alike, it is what
    /// both have.
    fn is_credible(
        &self,
        frame: &TrackedFrame,
        inliers: Inliers,
        n_expected: usize,
        reaches: &[Reach],
    ) -> bool {
        // A camera seen a moment ago in another submap is at a place of this one that nothing is known of.
        let reach = reaches.iter().find(|reach| reach.submap == frame.submap);
        let center = frame.camera_from_world.center();
        if reach.map_or(reaches.is_empty(), |reach| reach.includes(&center)) {
            return self.config.relocalization.is_enough(inliers.total(), n_expected);
        }
        let continuity = &self.config.continuity;
        let share = inliers.total() as f64 / n_expected.max(1) as f64;
        inliers.total() >= continuity.n_beyond_doubt && share >= continuity.share_beyond_doubt
    }

    /// Notes where the camera is in its submap and how fast it moves.
    pub(super) fn note_seen(&mut self, frame: &TrackedFrame, motion: Option<&(Pose, i64)>, map: &Map) {
        let Some((place, anchor)) = frame.pose_in(map).zip(map.anchor_of(frame.reference)) else { return };
        let (timestamp_ns, local_scale) = (frame.timestamp_ns, anchor.local_scale);
        let now =
            motion.map(|(motion, interval_ns)| motion.translation.norm() / interval_ns.abs().max(1) as f64);
        let known = self.last_seen.get(&frame.submap).filter(|seen| seen.speed > 0.0);
        let before = known.map(|seen| seen.speed * local_scale / seen.local_scale);
        let speed = match (before, now) {
            (Some(before), Some(now)) => before + SPEED_UPDATE * (now - before),
            (before, now) => before.or(now).unwrap_or(0.0),
        };
        self.last_seen.insert(frame.submap, LastSeen { place, timestamp_ns, speed, local_scale });
    }
}

impl LastSeen {
    fn reach(&self, map: &Map, timestamp_ns: i64, config: &ContinuityConfig) -> Option<Reach> {
        let (_, camera_from_world) = map.locate(&self.place)?;
        let speed = self.speed * map.anchor_of(self.place.reference)?.local_scale / self.local_scale;
        let elapsed_ns = timestamp_ns - self.timestamp_ns;
        Reach::from(map, self.place.reference, &camera_from_world.center(), speed, elapsed_ns, config)
    }
}
