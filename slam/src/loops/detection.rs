//! Loop detection: keyframes that look like a new one and are not covisible with it.

use crate::config::LoopConfig;
use crate::keyframe_index::KeyframeIndex;
use crate::map::{KeyframeId, Map};
use std::collections::BTreeSet;

/// Indexes the keyframes' descriptors and finds those that are alike.
#[derive(Debug, Default)]
pub(super) struct Detector {
    places: KeyframeIndex,
}

impl Detector {
    /// Keyframes that look like the given one but are not around it, most similar first.
    pub fn candidates(&mut self, map: &Map, id: KeyframeId, config: &LoopConfig) -> Vec<KeyframeId> {
        self.candidates_among(map, id, config, |_| true)
    }

    /// As [`Self::candidates`], among the keyframes that are wanted.
    pub fn candidates_among(
        &mut self,
        map: &Map,
        id: KeyframeId,
        config: &LoopConfig,
        is_wanted: impl Fn(KeyframeId) -> bool,
    ) -> Vec<KeyframeId> {
        self.places.update(map);
        let Some(keyframe) = map.keyframe(id) else { return Vec::new() };
        let around = surroundings(map, id);
        let descriptors = &keyframe.features.descriptors;
        // How alike two views of the same place are depends on the place: the keyframes next to this one
        // tell.
        let is_neighbor = |other| other != id && around.contains(&other);
        let familiar =
            self.places.most_similar(descriptors, 1, is_neighbor).first().map_or(0.0, |place| place.score);
        let is_elsewhere = |other| other != id && !around.contains(&other) && is_wanted(other);
        let likely = self.places.most_similar(descriptors, config.max_candidates, is_elsewhere);
        likely
            .into_iter()
            .filter(|place| {
                place.n_votes >= config.min_votes && place.score >= config.min_score_share * familiar
            })
            .map(|place| place.keyframe)
            .collect()
    }
}

/// A keyframe, those that share points with it, and those that share points with these.
pub(super) fn surroundings(map: &Map, id: KeyframeId) -> BTreeSet<KeyframeId> {
    let neighbors = |id: &KeyframeId| {
        map.keyframe(*id)
            .into_iter()
            .flat_map(|keyframe| keyframe.covisible().iter().map(|(other, _)| *other))
    };
    let near: BTreeSet<KeyframeId> = std::iter::once(id).chain(neighbors(&id)).collect();
    near.iter().copied().chain(near.iter().flat_map(neighbors)).collect()
}
