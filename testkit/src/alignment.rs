//! Poses and maps beside the true world.

use std::collections::BTreeMap;

use geometry::nalgebra::Vector3;
use geometry::{Pose, Similarity};
use recordings::{Evaluation, EvaluationError, EvaluationOptions, StampedPose, Trajectory};
use slam::Map;
use slam::map::SubmapId;
use synthetic::Sequence;

/// Nanoseconds between frames of consecutive numbers, so that evaluation matches them by their numbers alone.
const NS_PER_NUMBER: i64 = 1_000_000_000;

/// Compares `world_from_camera` by frame number with the truth after alignment by a similarity.
///
/// # Errors
/// If there are too few poses or they do not determine the similarity.
pub fn evaluate(
    estimate: &BTreeMap<u64, Pose>,
    truth: impl Fn(u64) -> Pose,
) -> Result<Evaluation, EvaluationError> {
    let stamped = |number: u64, world_from_camera| StampedPose {
        timestamp_ns: number as i64 * NS_PER_NUMBER,
        world_from_camera,
    };
    let true_poses = estimate.keys().map(|number| stamped(*number, truth(*number)));
    let poses = estimate.iter().map(|(number, pose)| stamped(*number, *pose));
    recordings::evaluate(
        &Trajectory::new(true_poses.collect()),
        &Trajectory::new(poses.collect()),
        &EvaluationOptions::default(),
    )
}

/// The submap with the most keyframes.
pub fn largest_submap(map: &Map) -> Option<SubmapId> {
    let mut sizes: BTreeMap<SubmapId, usize> = BTreeMap::new();
    map.keyframes().for_each(|keyframe| *sizes.entry(keyframe.submap).or_default() += 1);
    sizes.into_iter().max_by_key(|(_, size)| *size).map(|(submap, _)| submap)
}

/// Takes the map's largest submap to the true world: a similarity over the keyframes' positions, whose
/// numbers are those of the sequence's frames. `None` if there are too few of them or they lie on a straight
/// line.
pub fn truth_from_map(map: &Map, sequence: &Sequence) -> Option<Similarity> {
    let submap = largest_submap(map)?;
    let keyframes = || map.keyframes().filter(|keyframe| keyframe.submap == submap);
    let estimate: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| keyframe.camera_from_world.center()).collect();
    let truth: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| sequence.camera_from_world(keyframe.sequence as usize).center()).collect();
    Similarity::from_correspondences(&estimate, &truth, true)
}
