//! Sim(3) alignment with a loop candidate: the similarity between what a keyframe sees and the candidate,
//! from points that are in the map twice.

use super::Place;
use crate::bundle::factors::{PlacedSighting, SimilarityReprojectionFactor};
use crate::config::SlamConfig;
use crate::map::{Keyframe, KeyframeId, Map, PointId};
use crate::matching::{PredictedView, Window, find_in_window, match_keyframe};
use geometry::nalgebra::Vector3;
use geometry::ransac::{Estimator, RansacConfig, ransac};
use geometry::{Pose, Similarity};
use optim::{Kernel, SingleOptions, UnaryGroup, chi2_95, optimize_single};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use vision::matching::STRICT_DISTANCE;

/// Largest squared error of a point in either view, in standard deviations: the 99 % point for two
/// dimensions.
pub(super) const MAX_SQUARED_ERROR: f64 = 9.21;
/// Keyframes of the place whose points are matched by descriptors alone.
const N_MATCHED_KEYFRAMES: usize = 6;
/// A place with fewer matches than this share of those needed is given up after its first keyframe.
const MIN_FIRST_SHARE: f64 = 0.4;

/// Which keypoint of the new keyframe sees which point of the place.
pub(super) type PlaceMatches = BTreeMap<usize, PointId>;

/// `place_from_current`, if enough points agree with one.
pub(super) fn align(
    map: &Map,
    current: KeyframeId,
    place: &Place,
    config: &SlamConfig,
    rng: &mut ChaCha8Rng,
) -> Option<Similarity> {
    let loops = &config.loops;
    let keyframe = map.keyframe(current)?;
    let pairs = Pairs::new(map, keyframe, place, &match_by_looks(map, keyframe, place, loops.min_matches)?);
    if pairs.0.len() < loops.min_matches {
        return None;
    }
    let search = RansacConfig {
        max_squared_residual: MAX_SQUARED_ERROR,
        max_iterations: loops.max_iterations,
        ..RansacConfig::default()
    };
    let found = ransac(&pairs, &search, rng)?;
    if found.n_inliers < loops.min_first_inliers {
        return None;
    }
    let mut similarity = found.model;
    for radius_px in [loops.search_radius_px, 0.5 * loops.search_radius_px] {
        let matches = find_place_points(map, keyframe, place, &similarity, radius_px, config);
        let (refined, n_inliers) = Pairs::new(map, keyframe, place, &matches).refine(&similarity);
        if n_inliers < loops.min_inliers || !refined.is_finite() {
            return None;
        }
        similarity = refined;
    }
    Some(similarity)
}

/// Matches by descriptors alone; `None` if the place does not look promising.
fn match_by_looks(map: &Map, keyframe: &Keyframe, place: &Place, min_matches: usize) -> Option<PlaceMatches> {
    let mut matches = PlaceMatches::new();
    for (position, id) in place.keyframes.iter().take(N_MATCHED_KEYFRAMES).enumerate() {
        let Some(other) = map.keyframe(*id) else { continue };
        for (feature_idx, point) in match_keyframe(other, &keyframe.features) {
            matches.entry(feature_idx).or_insert(point);
        }
        if position == 0 && (matches.len() as f64) < MIN_FIRST_SHARE * min_matches as f64 {
            return None;
        }
    }
    Some(matches)
}

/// Finds points of the place in a keyframe on the other side, where the similarity puts them.
pub(super) fn find_place_points(
    map: &Map,
    keyframe: &Keyframe,
    place: &Place,
    place_from_current: &Similarity,
    radius_px: f64,
    config: &SlamConfig,
) -> PlaceMatches {
    let camera_from_place = camera_from_place(keyframe, place_from_current);
    let center = camera_from_place.center();
    let features = &keyframe.features;
    let min_view_cosine = config.tracking.max_view_angle_deg.to_radians().cos();
    let mut matches = PlaceMatches::new();
    for point in place.points.iter().filter_map(|id| map.point(*id)) {
        let view = PredictedView::of(point, &camera_from_place, &center, features, min_view_cosine);
        let Some(view) = view else { continue };
        let window = Window {
            pixel: view.pixel,
            radius_px: radius_px * features.pyramid.scale(view.octave),
            octaves: view.octave.saturating_sub(1)..=view.octave + 1,
            ratio: None,
            max_distance: STRICT_DISTANCE,
        };
        let found = find_in_window(features, &point.descriptor, &window, |idx| matches.contains_key(&idx));
        if let Some(feature_idx) = found {
            matches.insert(feature_idx, point.id);
        }
    }
    matches
}

/// A keyframe's pose in the world of the place.
pub(super) fn camera_from_place(keyframe: &Keyframe, place_from_current: &Similarity) -> Pose {
    (Similarity::from_pose(&keyframe.camera_from_world) * place_from_current.inverse()).pose_part()
}

/// Points that are in the map twice: as the new keyframe's surroundings know them, and as the place does.
struct Pairs(Vec<SimilarityReprojectionFactor>);

impl Pairs {
    fn new(map: &Map, keyframe: &Keyframe, place: &Place, matches: &PlaceMatches) -> Self {
        let sighting = |keyframe: &Keyframe, feature_idx: usize, point: Vector3<f64>| PlacedSighting {
            pinhole: keyframe.features.pinhole,
            camera_from_world: keyframe.camera_from_world,
            point,
            observed_px: keyframe.features.undistorted[feature_idx],
            inverse_sigma: 1.0 / keyframe.features.sigma_px(feature_idx),
        };
        let pair = |(feature_idx, place_id): (&usize, &PointId)| {
            let own = map.point(keyframe.points[*feature_idx]?)?;
            let there = map.point(*place_id).filter(|point| point.id != own.id)?;
            let (seen_from, seen_as) = place
                .keyframes
                .iter()
                .find_map(|id| Some((map.keyframe(*id)?, there.observation_in(*id)?)))?;
            Some(SimilarityReprojectionFactor {
                target: sighting(seen_from, seen_as as usize, there.position),
                source: sighting(keyframe, *feature_idx, own.position),
            })
        };
        Self(matches.iter().filter_map(pair).collect())
    }

    /// The similarity that fits the pairs best, and how many agree with it.
    fn refine(self, initial: &Similarity) -> (Similarity, usize) {
        let mut group = UnaryGroup::new(Kernel::huber_95(4), chi2_95(4), self.0);
        let report = optimize_single::<Similarity, 7>(initial, &mut [&mut group], &SingleOptions::default());
        (report.value, report.n_inliers)
    }
}

impl Estimator for Pairs {
    type Model = Similarity;

    fn sample_size(&self) -> usize {
        3
    }

    fn n_data(&self) -> usize {
        self.0.len()
    }

    fn fit_sample(&self, sample: &[usize], models: &mut Vec<Similarity>) {
        models.extend(self.fit(sample));
    }

    fn squared_residual(&self, model: &Similarity, datum: usize) -> f64 {
        self.0[datum].squared_residuals(model).map_or(f64::INFINITY, |(target, source)| target.max(source))
    }

    fn refine(&self, _model: &Similarity, inliers: &[usize]) -> Option<Similarity> {
        self.fit(inliers)
    }
}

impl Pairs {
    fn fit(&self, indices: &[usize]) -> Option<Similarity> {
        let points = |side: fn(&SimilarityReprojectionFactor) -> Vector3<f64>| {
            indices.iter().map(|idx| side(&self.0[*idx])).collect::<Vec<_>>()
        };
        Similarity::from_correspondences(
            &points(|pair| pair.source.point),
            &points(|pair| pair.target.point),
            true,
        )
    }
}
