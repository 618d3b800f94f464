//! Finding a lost camera: which known places look like the image, and a pose that its geometry confirms.

use super::frame::TrackedFrame;
use super::pose::place_frame;
use super::search::{Expected, match_keyframe, search_by_motion};
use crate::config::{ConfigError, PrimitiveConfig, RelocalisationConfig, SlamConfig};
use crate::map::{Keyframe, KeyframeId, Map, PointId, SubmapId};
use crate::places::KeyframePlaces;
use crate::vanishing::VanishingFinder;
use geometry::absolute_pose::{PoseObservation, ransac_pose, ransac_pose_with_rotations};
use geometry::nalgebra::{UnitQuaternion, Vector3};
use geometry::ransac::RansacConfig;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use vision::vanishing::rotation_hypotheses;

/// Radius of the guided search around a pose found from few matches, pixels of the level.
const GUIDED_RADIUS_PX: f64 = 10.0;
/// Neighbours of a recognised key frame whose points are looked for as well.
const N_NEIGHBOURS: usize = 10;

/// Angles between directions that count as the same, and attitudes that count as one, degrees.
const ATTITUDE_TOLERANCE_DEG: f64 = 3.0;
/// Attitudes tried: three directions at right angles allow 24.
const MAX_ATTITUDES: usize = 48;

/// Recognises places. Learns the key frames of a map as they appear.
pub(crate) struct Relocaliser {
    config: RelocalisationConfig,
    primitives: PrimitiveConfig,
    places: KeyframePlaces,
    /// Absent where primitives are switched off.
    finder: Option<VanishingFinder>,
    rng: ChaCha8Rng,
    n_candidates: usize,
}

/// What a search for a pose starts from.
enum Start<'a> {
    Matches,
    /// The attitude is one of these.
    Attitudes(&'a [UnitQuaternion<f64>]),
}

impl Relocaliser {
    /// # Errors
    /// If the configuration of the search for vanishing points cannot be used.
    pub fn new(config: &SlamConfig) -> Result<Self, ConfigError> {
        let finder = || VanishingFinder::new(&config.primitives, config.seed);
        Ok(Self {
            finder: config.features.global_primitives.then(finder).transpose()?,
            config: config.relocalisation.clone(),
            primitives: config.primitives.clone(),
            places: KeyframePlaces::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
            n_candidates: 0,
        })
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

    /// The frame with a pose and matches, if the place of a key frame fits it: by its points, or, where few are matched, by
    /// those and the directions that both show.
    pub fn try_place(
        &mut self,
        frame: &TrackedFrame,
        keyframe: &Keyframe,
        map: &Map,
    ) -> Option<TrackedFrame> {
        let matches = match_keyframe(keyframe, &frame.features);
        if matches.len() >= self.config.min_matches {
            let placed = self.place(frame, keyframe, &matches, &Start::Matches, map);
            if placed.is_some() {
                return placed;
            }
        }
        if matches.len() < self.config.min_matches_with_directions {
            return None;
        }
        let attitudes = self.attitudes(frame, keyframe, map);
        if attitudes.is_empty() {
            return None;
        }
        self.place(frame, keyframe, &matches, &Start::Attitudes(&attitudes), map)
    }

    fn place(
        &mut self,
        frame: &TrackedFrame,
        keyframe: &Keyframe,
        matches: &[(usize, PointId)],
        start: &Start<'_>,
        map: &Map,
    ) -> Option<TrackedFrame> {
        let min_first_inliers = match start {
            Start::Matches => self.config.min_first_inliers,
            Start::Attitudes(_) => self.config.min_first_inliers_with_directions,
        };
        let mut frame = TrackedFrame { reference: keyframe.id, submap: keyframe.submap, ..frame.clone() };
        self.place_by_matches(&mut frame, matches, start, min_first_inliers, map)?;
        let mut n_inliers = place_frame(&mut frame, map, &self.primitives).inliers.total();
        if n_inliers < min_first_inliers {
            return None;
        }
        if n_inliers < self.config.min_inliers {
            self.search_around(&mut frame, keyframe, map);
            n_inliers = place_frame(&mut frame, map, &self.primitives).inliers.total();
        }
        (n_inliers >= self.config.min_inliers).then_some(frame)
    }

    /// The attitudes, in the world of a key frame, under which the frame shows its vanishing points where primitives are.
    fn attitudes(
        &mut self,
        frame: &TrackedFrame,
        keyframe: &Keyframe,
        map: &Map,
    ) -> Vec<UnitQuaternion<f64>> {
        let Some(finder) = &mut self.finder else { return Vec::new() };
        let in_submap = map.primitives().filter(|primitive| primitive.submap == keyframe.submap);
        let known: Vec<Vector3<f64>> = in_submap.map(|primitive| *primitive.direction.as_vector()).collect();
        let found = finder.find(&frame.features, &[]);
        let seen: Vec<Vector3<f64>> = found.iter().map(|vanishing| vanishing.direction).collect();
        rotation_hypotheses(&known, &seen, ATTITUDE_TOLERANCE_DEG.to_radians(), MAX_ATTITUDES)
    }

    /// A pose that many matches agree with; only those are kept.
    fn place_by_matches(
        &mut self,
        frame: &mut TrackedFrame,
        matches: &[(usize, PointId)],
        start: &Start<'_>,
        min_inliers: usize,
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
        let report = match start {
            Start::Matches => ransac_pose(&observations, &config, &mut self.rng),
            Start::Attitudes(attitudes) => {
                ransac_pose_with_rotations(&observations, attitudes, &config, &mut self.rng)
            }
        };
        let report = report.filter(|report| report.n_inliers >= min_inliers)?;
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
