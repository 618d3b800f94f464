//! Loop closing and map merging: loops within a submap are closed, submaps that meet are merged.
//! [method: Loop detection and correction] Each new keyframe is compared with the map by its descriptors
//! ([`detection`]). A place that looks alike must be confirmed by geometry: a similarity that carries the new
//! keyframe's surroundings onto the place ([`alignment`]), with which the keyframe and its neighbors find
//! the place's points ([`verification`]). Then the map is corrected ([`correction`], [`essential_graph`]).

mod alignment;
mod correction;
mod detection;
mod essential_graph;
#[cfg(test)]
mod tests;
mod verification;

pub use essential_graph::{KeyframeTies, essential_edges};

use crate::config::SlamConfig;
use crate::continuity;
use crate::map::{KeyframeId, Map, PointId, SubmapId, median_depth};
use crate::report::MapEvent;
use detection::Detector;
use geometry::Similarity;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Shift as a share of the scene's depth, turn in radians, and logarithm of the scale below which a
/// correction is only a matter of joining landmarks: what bundle adjustment does to a map anyway.
const NEGLIGIBLE: (f64, f64, f64) = (0.01, 0.005, 0.01);

/// A place that a keyframe was found to show.
#[derive(Clone, Debug)]
pub(crate) struct Recognition {
    /// The new keyframe.
    pub current: KeyframeId,
    /// The keyframe of the place.
    pub matched: KeyframeId,
    /// Takes the world around the new keyframe to where the place says it is.
    pub place_from_current: Similarity,
    /// What keyframes at the place see.
    pub place: Place,
    /// Points of the place found in the new keyframe.
    pub n_matches: usize,
}

/// The surroundings of a recognized keyframe.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    /// The recognized keyframe and its neighbors, strongest ties first.
    pub keyframes: Vec<KeyframeId>,
    /// What they see, in the order of the ids.
    pub points: Vec<PointId>,
}

/// What a correction did, and to which submap.
pub(crate) struct Closed {
    pub event: MapEvent,
    pub submap: SubmapId,
    /// Whether anything moved, so that bundle adjustment of the whole submap is worth its time.
    pub moved: bool,
}

/// Recognizes places and corrects the map.
pub(crate) struct LoopCloser {
    config: SlamConfig,
    detector: Detector,
    rng: ChaCha8Rng,
}

impl LoopCloser {
    pub fn new(config: &SlamConfig) -> Self {
        Self {
            config: config.clone(),
            detector: Detector::default(),
            rng: ChaCha8Rng::seed_from_u64(config.seed),
        }
    }

    /// Looks for the place a new keyframe shows, and corrects the map if it is found.
    pub fn close(&mut self, map: &mut Map, id: KeyframeId) -> Option<Closed> {
        let recognition = self.recognize(map, id)?;
        let current = map.keyframe(recognition.current)?.submap;
        let matched = map.keyframe(recognition.matched)?.submap;
        if current == matched {
            Some(self.close_loop(map, &recognition, current))
        } else if !self.can_merge(map, &recognition, current, matched) {
            tracing::info!(keyframe = %id, matched = %recognition.matched, "looks like a place out of reach: not merged");
            None
        } else {
            Some(self.merge(map, &recognition, current, matched))
        }
    }

    /// Looks for the place a keyframe shows among keyframes of some kind, changing nothing.
    pub fn recognize_among(
        &mut self,
        map: &Map,
        id: KeyframeId,
        is_wanted: impl Fn(&Map, KeyframeId) -> bool,
    ) -> Option<Recognition> {
        let candidates =
            self.detector.candidates_among(map, id, &self.config.loops, |other| is_wanted(map, other));
        self.confirmed(map, id, candidates)
    }

    /// Merges the submaps of two keyframes one of which was recognized in the other.
    pub fn join(&mut self, map: &mut Map, recognition: &Recognition) -> Option<Closed> {
        let current = map.keyframe(recognition.current)?.submap;
        let matched = map.keyframe(recognition.matched)?.submap;
        (current != matched).then(|| self.merge(map, recognition, current, matched))
    }

    fn recognize(&mut self, map: &Map, id: KeyframeId) -> Option<Recognition> {
        let candidates = self.detector.candidates(map, id, &self.config.loops);
        self.confirmed(map, id, candidates)
    }

    /// The first candidate that geometry confirms.
    fn confirmed(&mut self, map: &Map, id: KeyframeId, candidates: Vec<KeyframeId>) -> Option<Recognition> {
        candidates.into_iter().find_map(|matched| {
            let place = Place::around(map, matched, id, self.config.loops.n_window_neighbors)?;
            let aligned = alignment::align(map, id, &place, &self.config, &mut self.rng)?;
            let n_matches = verification::verify(map, id, &place, &aligned, &self.config)?;
            Some(Recognition { current: id, matched, place_from_current: aligned, place, n_matches })
        })
    }

    fn close_loop(&self, map: &mut Map, recognition: &Recognition, submap: SubmapId) -> Closed {
        let moved = !is_negligible(map, recognition);
        if moved {
            correction::close_loop(map, recognition, &self.config);
        } else {
            correction::join_landmarks(map, &recognition.place, recognition.current, &self.config);
        }
        let event = MapEvent::LoopClosed {
            keyframe: recognition.current,
            matched: recognition.matched,
            n_matches: recognition.n_matches,
            scale: recognition.place_from_current.scale,
        };
        Closed { event, submap, moved }
    }

    /// Whether the camera can have gone from the one submap to the other as a merger would have it.
    fn can_merge(&self, map: &Map, recognition: &Recognition, current: SubmapId, matched: SubmapId) -> bool {
        let place_from_current = recognition.place_from_current;
        let (older, newer, older_from_newer) = if current > matched {
            (matched, current, place_from_current)
        } else {
            (current, matched, place_from_current.inverse())
        };
        recognition.n_matches >= self.config.continuity.n_beyond_doubt
            || continuity::can_follow(map, older, newer, &older_from_newer, &self.config.continuity)
    }

    fn merge(
        &self,
        map: &mut Map,
        recognition: &Recognition,
        current: SubmapId,
        matched: SubmapId,
    ) -> Closed {
        // The older submap's frame of reference survives.
        let (absorbed, surviving) = (current.max(matched), current.min(matched));
        correction::merge(map, recognition, absorbed, surviving, &self.config);
        let event = MapEvent::SubmapsMerged {
            keyframe: recognition.current,
            matched: recognition.matched,
            absorbed,
            surviving,
            n_matches: recognition.n_matches,
        };
        Closed { event, submap: surviving, moved: true }
    }
}

impl Place {
    fn around(map: &Map, matched: KeyframeId, current: KeyframeId, n_neighbors: usize) -> Option<Self> {
        let center = map.keyframe(matched)?;
        let neighbors = center.covisible().iter().take(n_neighbors).map(|(id, _)| *id);
        let keyframes: Vec<KeyframeId> = std::iter::once(matched).chain(neighbors).collect();
        let seen = keyframes
            .iter()
            .filter_map(|id| map.keyframe(*id))
            .flat_map(|keyframe| keyframe.observed_points());
        let points: BTreeSet<PointId> = seen
            .map(|(_, id)| id)
            .filter(|id| map.point(*id).is_some_and(|point| point.observation_in(current).is_none()))
            .collect();
        Some(Self { keyframes, points: points.into_iter().collect() })
    }
}

fn is_negligible(map: &Map, recognition: &Recognition) -> bool {
    let Some(current) = map.keyframe(recognition.current) else { return true };
    let Some(depth) = median_depth(map, current) else { return false };
    let similarity = &recognition.place_from_current;
    let center = current.camera_from_world.center();
    let (max_shift, max_turn, max_log_scale) = NEGLIGIBLE;
    (similarity.transform(&center) - center).norm() < max_shift * depth
        && similarity.rotation.angle() < max_turn
        && similarity.scale.ln().abs() < max_log_scale
}
