//! The map beside the true world.

use geometry::Similarity;
use geometry::nalgebra::Vector3;
use slam::Map;
use slam::map::SubmapId;
use std::collections::BTreeMap;
use synthetic::Sequence;

/// The submap with the most key frames.
pub fn largest_submap(map: &Map) -> Option<SubmapId> {
    let mut sizes: BTreeMap<SubmapId, usize> = BTreeMap::new();
    map.keyframes().for_each(|keyframe| *sizes.entry(keyframe.submap).or_default() += 1);
    sizes.into_iter().max_by_key(|(_, size)| *size).map(|(submap, _)| submap)
}

/// Takes the map's largest submap to the true world: a similarity over the key frames' positions. `None` if there are too
/// few of them or they lie on a straight line.
pub fn truth_from_map(map: &Map, sequence: &Sequence) -> Option<Similarity> {
    let submap = largest_submap(map)?;
    let keyframes = || map.keyframes().filter(|keyframe| keyframe.submap == submap);
    let estimate: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| keyframe.camera_from_world.centre()).collect();
    let truth: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| sequence.camera_from_world(keyframe.sequence as usize).centre()).collect();
    Similarity::from_correspondences(&estimate, &truth, true)
}
