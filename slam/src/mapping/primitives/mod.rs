//! Global primitives: vanishing directions of keyframes, fused over all that share them.
//! [method: Global primitives]

mod association;
mod upkeep;

use crate::config::{ConfigError, SlamConfig};
use crate::map::{KeyframeId, Map};
use crate::vanishing::VanishingFinder;

/// Finds vanishing points in keyframes and makes and tends the primitives of a map.
pub(super) struct PrimitiveMapper {
    finder: VanishingFinder,
}

impl PrimitiveMapper {
    /// # Errors
    /// If the configuration of the search for vanishing points cannot be used.
    pub fn new(config: &SlamConfig) -> Result<Self, ConfigError> {
        Ok(Self { finder: VanishingFinder::new(&config.primitives, config.seed)? })
    }

    /// Takes in the segments of a keyframe that is in the map: finds its vanishing points, says which
    /// primitives they are, makes new ones of those that enough keyframes share, joins and retires.
    pub fn extend(&mut self, map: &mut Map, id: KeyframeId, config: &SlamConfig) {
        self.find(map, id);
        association::associate(map, id, &config.primitives);
        association::create(map, id, &config.primitives);
        upkeep::merge(map, id, &config.primitives);
        upkeep::retire(map, id, &config.primitives);
        upkeep::vote_for_lines(map, id, &config.primitives);
    }

    fn find(&mut self, map: &mut Map, id: KeyframeId) {
        let Some(keyframe) = map.keyframe(id) else { return };
        let known: Vec<_> = map
            .primitives()
            .filter(|primitive| primitive.submap == keyframe.submap)
            .map(|primitive| keyframe.camera_from_world.rotation * primitive.direction.as_vector())
            .collect();
        let found = self.finder.find(&keyframe.features, &known);
        map.set_vanishing(id, found);
    }
}
