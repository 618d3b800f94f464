//! Relocalization: which keyframes look like the image, and a pose that geometry confirms.
//! [method: Relocalization]

use super::frame::TrackedFrame;
use super::pose::place_frame;
use crate::config::{ConfigError, PrimitiveConfig, RelocalizationConfig, SlamConfig};
use crate::features::View;
use crate::keyframe_index::KeyframeIndex;
use crate::map::{Keyframe, KeyframeId, Map, PointId, SubmapId};
use crate::matching::{Expected, match_place, search_by_motion};
use crate::vanishing::VanishingFinder;
use geometry::Pose;
use geometry::absolute_pose::{PoseObservation, ransac_pose, ransac_pose_with_rotations};
use geometry::nalgebra::{UnitQuaternion, Vector3};
use geometry::ransac::{RansacConfig, RansacReport};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use vision::vanishing::rotation_hypotheses;

/// Radius of the guided search around a pose found from few matches, pixels of the level.
const GUIDED_RADIUS_PX: f64 = 10.0;
/// Neighbors of a recognized keyframe whose points are looked for as well.
const N_NEIGHBORS: usize = 10;

/// Angles between directions that count as the same, and attitudes that count as one, degrees.
const ATTITUDE_TOLERANCE_DEG: f64 = 3.0;
/// Attitudes tried: three directions at right angles allow 24.
const MAX_ATTITUDES: usize = 48;

/// Recognizes places. Learns the keyframes of a map as they appear.
pub(crate) struct Relocalizer {
    config: RelocalizationConfig,
    primitives: PrimitiveConfig,
    places: KeyframeIndex,
    /// Absent where primitives are switched off.
    finder: Option<VanishingFinder>,
    rng: ChaCha8Rng,
    n_candidates: usize,
    /// The frame whose vanishing points were asked for last, by its number, and these, in its camera's frame.
    vanishing: Option<(u64, Vec<Vector3<f64>>)>,
    /// Where to look only: a place, and how far from it, map units.
    near: Option<(Vector3<f64>, f64)>,
    seed: u64,
}

/// Keypoints of a frame that look like landmarks.
struct Matches {
    /// Keypoint and landmark.
    known: Vec<(usize, PointId)>,
    /// The same as geometry.
    observations: Vec<PoseObservation>,
}

/// What a search for a pose starts from.
enum Start<'a> {
    Matches,
    /// The attitude is one of these.
    Attitudes(&'a [UnitQuaternion<f64>]),
}

impl Relocalizer {
    /// # Errors
    /// If the configuration of the search for vanishing points cannot be used.
    pub fn new(config: &SlamConfig) -> Result<Self, ConfigError> {
        let finder = || VanishingFinder::new(&config.primitives, config.seed);
        Ok(Self {
            finder: config.features.global_primitives.then(finder).transpose()?,
            config: config.relocalization.clone(),
            primitives: config.primitives.clone(),
            places: KeyframeIndex::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
            n_candidates: 0,
            vanishing: None,
            near: None,
            seed: config.seed,
        })
    }

    /// Enters the keyframes that are new in the map and drops those that are gone.
    pub fn update(&mut self, map: &Map) {
        self.places.update(map);
    }

    /// Begins as if nothing had been looked for, and looks near a place only.
    pub fn begin_anew(&mut self, near: Option<(Vector3<f64>, f64)>) {
        self.rng = ChaCha8Rng::seed_from_u64(self.seed);
        (self.vanishing, self.near) = (None, near);
    }

    /// Places that were tried for the last frame.
    pub fn n_candidates(&self) -> usize {
        self.n_candidates
    }

    /// The keyframes that look most like a frame, best first. A submap may be left out.
    pub fn candidates(&mut self, view: &View, map: &Map, except: Option<SubmapId>) -> Vec<KeyframeId> {
        let near = self.near;
        let is_near = |keyframe: &Keyframe| {
            near.is_none_or(|(place, radius)| (keyframe.camera_from_world.center() - place).norm() <= radius)
        };
        let is_wanted = |id| {
            map.keyframe(id).is_some_and(|keyframe| Some(keyframe.submap) != except && is_near(keyframe))
        };
        let candidates =
            self.places.most_similar(&view.features.descriptors, self.config.max_candidates, is_wanted);
        self.n_candidates = candidates.len();
        candidates.iter().map(|candidate| candidate.keyframe).collect()
    }

    /// The frame with a pose and matches, if the place of a [candidate](Self::candidates) fits it: by its
    /// points, or, where few are matched, by those and the directions that both show.
    pub fn try_place(&mut self, view: &View, keyframe: &Keyframe, map: &Map) -> Option<TrackedFrame> {
        let matches = Matches::of(view, keyframe, map, self.config.n_matched_neighbors);
        if matches.known.len() >= self.config.min_matches {
            let placed = self.place(view, keyframe, &matches, &Start::Matches, map);
            if placed.is_some() {
                return placed;
            }
        }
        if matches.known.len() < self.config.min_matches_with_directions {
            return None;
        }
        let attitudes = self.attitudes(view, keyframe, map);
        if attitudes.is_empty() {
            return None;
        }
        self.place(view, keyframe, &matches, &Start::Attitudes(&attitudes), map)
    }

    fn place(
        &mut self,
        view: &View,
        keyframe: &Keyframe,
        matches: &Matches,
        start: &Start<'_>,
        map: &Map,
    ) -> Option<TrackedFrame> {
        let min_first_inliers = match start {
            Start::Matches => self.config.min_first_inliers,
            Start::Attitudes(_) => self.config.min_first_inliers_with_directions,
        };
        let report = self.search_pose(&matches.observations, start)?;
        if report.n_inliers < min_first_inliers {
            return None;
        }
        let mut frame = TrackedFrame::blank(view, report.model, keyframe.id, keyframe.submap);
        for ((feature_idx, id), _) in matches.known.iter().zip(&report.inliers).filter(|(_, inlier)| **inlier)
        {
            frame.points[*feature_idx] = Some(*id);
        }
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

    /// The attitudes, in the world of a keyframe, under which the frame shows its vanishing points where
    /// primitives are.
    fn attitudes(&mut self, view: &View, keyframe: &Keyframe, map: &Map) -> Vec<UnitQuaternion<f64>> {
        let Some(finder) = &mut self.finder else { return Vec::new() };
        self.vanishing.take_if(|(sequence, _)| *sequence != view.sequence);
        let (_, seen) = self.vanishing.get_or_insert_with(|| {
            let found = finder.find(&view.features, &[]);
            (view.sequence, found.iter().map(|vanishing| vanishing.direction).collect())
        });
        let in_submap = map.primitives().filter(|primitive| primitive.submap == keyframe.submap);
        let known: Vec<Vector3<f64>> = in_submap.map(|primitive| *primitive.direction.as_vector()).collect();
        rotation_hypotheses(&known, seen, ATTITUDE_TOLERANCE_DEG.to_radians(), MAX_ATTITUDES)
    }

    /// A pose that many matches agree with.
    fn search_pose(
        &mut self,
        observations: &[PoseObservation],
        start: &Start<'_>,
    ) -> Option<RansacReport<Pose>> {
        let config = RansacConfig { max_iterations: self.config.max_iterations, ..RansacConfig::default() };
        match start {
            Start::Matches => ransac_pose(observations, &config, &mut self.rng),
            Start::Attitudes(attitudes) => {
                ransac_pose_with_rotations(observations, attitudes, &config, &mut self.rng)
            }
        }
    }

    /// Looks for what the recognized keyframe and its neighbors see, around where the pose puts it.
    fn search_around(&self, frame: &mut TrackedFrame, keyframe: &Keyframe, map: &Map) {
        let mut seen: BTreeSet<PointId> = frame.points.iter().flatten().copied().collect();
        let features = frame.features.clone();
        let neighbors = keyframe.covisible().iter().take(N_NEIGHBORS).filter_map(|(id, _)| map.keyframe(*id));
        for neighbor in std::iter::once(keyframe).chain(neighbors) {
            let wanted: Vec<(usize, PointId)> =
                neighbor.observed_points().filter(|(_, id)| seen.insert(*id)).collect();
            let expected = wanted.iter().filter_map(|(keypoint_idx, id)| {
                let point = map.point(*id)?;
                let keypoint = &neighbor.features.keypoints[*keypoint_idx];
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

impl Matches {
    fn of(view: &View, keyframe: &Keyframe, map: &Map, n_neighbors: usize) -> Self {
        let features = &view.features;
        let focal_px = features.pinhole.mean_focal_px();
        let (known, observations) = match_place(keyframe, features, map, n_neighbors)
            .into_iter()
            .filter_map(|(feature_idx, id)| {
                let observation = PoseObservation {
                    bearing: features.pinhole.bearing(&features.undistorted[feature_idx]),
                    point: map.point(id)?.position,
                    sigma_rad: features.sigma_px(feature_idx) / focal_px,
                };
                Some(((feature_idx, id), observation))
            })
            .unzip();
        Self { known, observations }
    }
}
