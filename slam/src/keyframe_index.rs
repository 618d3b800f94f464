//! Place recognition (image retrieval): which keyframes of the map look like an image.

use crate::map::{KeyframeId, Map};
use std::collections::BTreeSet;
use vision::Descriptor;
use vision::place::PlaceIndex;

/// An index of a map's keyframes by their descriptors, kept in step with the map.
#[derive(Debug, Default)]
pub(crate) struct KeyframeIndex {
    index: PlaceIndex,
    known: BTreeSet<KeyframeId>,
}

/// A keyframe that looks like the image asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SimilarKeyframe {
    pub keyframe: KeyframeId,
    /// The higher the more alike; comparable between answers for the same image.
    pub score: f32,
    /// Descriptors that voted for the keyframe.
    pub n_votes: u32,
}

impl KeyframeIndex {
    /// Enters the keyframes that are new in the map and drops those that are gone.
    pub fn update(&mut self, map: &Map) {
        let gone: Vec<KeyframeId> =
            self.known.iter().copied().filter(|id| map.keyframe(*id).is_none()).collect();
        for id in gone {
            self.known.remove(&id);
            self.index.remove(id.get());
        }
        for keyframe in map.keyframes() {
            if self.known.insert(keyframe.id) {
                self.index.insert(keyframe.id.get(), &keyframe.features.descriptors);
            }
        }
    }

    /// The `n` most similar among the keyframes that are wanted, best first.
    pub fn most_similar(
        &self,
        descriptors: &[Descriptor],
        n: usize,
        is_wanted: impl Fn(KeyframeId) -> bool,
    ) -> Vec<SimilarKeyframe> {
        let is_wanted = |id| KeyframeId::new(id).is_some_and(&is_wanted);
        let found = self.index.query_where(descriptors, n, is_wanted);
        found
            .into_iter()
            .filter_map(|candidate| {
                Some(SimilarKeyframe {
                    keyframe: KeyframeId::new(candidate.image_id)?,
                    score: candidate.score,
                    n_votes: candidate.n_votes,
                })
            })
            .collect()
    }
}
