//! Finding a lost camera: which known places look like the image, and a pose that its geometry confirms.

use super::frame::TrackedFrame;
use super::pose::place_frame;
use super::search::{Expected, match_keyframe, search_by_motion};
use crate::config::{PrimitiveConfig, RelocalisationConfig, SlamConfig};
use crate::map::{Keyframe, KeyframeId, Map, PointId, SubmapId};
use crate::places::KeyframePlaces;
use geometry::absolute_pose::{PoseObservation, ransac_pose};
use geometry::ransac::RansacConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Radius of the guided search around a pose found from few matches, pixels of the level.
const GUIDED_RADIUS_PX: f64 = 10.0;
/// Neighbours of a recognised key frame whose points are looked for as well.
const N_NEIGHBOURS: usize = 10;

/// Recognises places. Learns the key frames of a map as they appear.
pub(crate) struct Relocaliser {
    config: RelocalisationConfig,
    primitives: PrimitiveConfig,
    places: KeyframePlaces,
    rng: ChaCha8Rng,
    n_candidates: usize,
}

impl Relocaliser {
    pub fn new(config: &SlamConfig) -> Self {
        Self {
            config: config.relocalisation.clone(),
            primitives: config.primitives.clone(),
            places: KeyframePlaces::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
            n_candidates: 0,
        }
    }

    /// Enters the key frames that are new in the map and drops those that are gone.
    pub fn learn(&mut self, map: &Map) {
        self.places.learn(map);
    }

    /// Places that were tried for the last frame.
    pub fn n_candidates(&self) -> usize {
        self.n_candidates
    }

    /// The key frames that look most like a frame, best first. A submap may be left out.
    pub fn candidates(
        &mut self,
        blank: &TrackedFrame,
        map: &Map,
        except: Option<SubmapId>,
    ) -> Vec<KeyframeId> {
        let is_wanted = |id| map.keyframe(id).is_some_and(|keyframe| Some(keyframe.submap) != except);
        let candidates =
            self.places.most_similar(&blank.features.descriptors, self.config.max_candidates, is_wanted);
        self.n_candidates = candidates.len();
        candidates.iter().map(|candidate| candidate.keyframe).collect()
    }

    /// The frame with a pose and matches, if the place of a key frame fits it.
    pub fn try_place(
        &mut self,
        mut frame: TrackedFrame,
        keyframe: &Keyframe,
        map: &Map,
    ) -> Option<TrackedFrame> {
        let matches = match_keyframe(keyframe, &frame.features);
        if matches.len() < self.config.min_matches {
            return None;
        }
        frame.reference = keyframe.id;
        frame.submap = keyframe.submap;
        self.place_by_matches(&mut frame, &matches, map)?;
        let mut n_inliers = place_frame(&mut frame, map, &self.primitives).inliers.total();
        if n_inliers < self.config.min_first_inliers {
            return None;
        }
        if n_inliers < self.config.min_inliers {
            self.search_around(&mut frame, keyframe, map);
            n_inliers = place_frame(&mut frame, map, &self.primitives).inliers.total();
        }
        (n_inliers >= self.config.min_inliers).then_some(frame)
    }

    /// A pose from three matches that many others agree with; only those are kept.
    fn place_by_matches(
        &mut self,
        frame: &mut TrackedFrame,
        matches: &[(usize, PointId)],
        map: &Map,
    ) -> Option<()> {
        let focal_px = frame.features.pinhole.mean_focal_px();
        let mut known = Vec::with_capacity(matches.len());
        let mut observations = Vec::with_capacity(matches.len());
        for (feature_idx, id) in matches {
            let Some(point) = map.point(*id) else { continue };
            known.push((*feature_idx, *id));
            observations.push(PoseObservation {
                bearing: frame.features.pinhole.bearing(&frame.features.undistorted[*feature_idx]),
                point: point.position,
                sigma_rad: frame.features.sigma_px(*feature_idx) / focal_px,
            });
        }
        let config = RansacConfig { max_iterations: self.config.max_iterations, ..RansacConfig::default() };
        let report = ransac_pose(&observations, &config, &mut self.rng)?;
        if report.n_inliers < self.config.min_first_inliers {
            return None;
        }
        frame.camera_from_world = report.model;
        frame.points.fill(None);
        for ((feature_idx, id), _) in known.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier) {
            frame.points[*feature_idx] = Some(*id);
        }
        Some(())
    }

    /// Looks for what the recognised key frame and its neighbours see, around where the pose puts it.
    fn search_around(&self, frame: &mut TrackedFrame, keyframe: &Keyframe, map: &Map) {
        let mut seen: BTreeSet<PointId> = frame.points.iter().flatten().copied().collect();
        let features = frame.features.clone();
        let neighbours =
            keyframe.covisible().iter().take(N_NEIGHBOURS).filter_map(|(id, _)| map.keyframe(*id));
        for neighbour in std::iter::once(keyframe).chain(neighbours) {
            let wanted: Vec<(usize, PointId)> =
                neighbour.observed_points().filter(|(_, id)| seen.insert(*id)).collect();
            let expected = wanted.iter().filter_map(|(keypoint_idx, id)| {
                let point = map.point(*id)?;
                let keypoint = &neighbour.features.keypoints[*keypoint_idx];
                let descriptor = &point.descriptor;
                Some(Expected { point, octave: keypoint.octave, angle: keypoint.angle, descriptor })
            });
            search_by_motion(
                &features,
                &frame.camera_from_world,
                expected,
                GUIDED_RADIUS_PX,
                &mut frame.points,
            );
        }
    }
}
