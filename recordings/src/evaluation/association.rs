//! Which estimated pose belongs to which true one.

use std::collections::BTreeSet;

use crate::Trajectory;

/// A true pose and the estimated pose of the same image, by their places in the trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Match {
    /// Index into the true poses.
    pub truth_idx: usize,
    /// Index into the estimated poses.
    pub estimate_idx: usize,
}

/// Pairs each estimated pose with the true pose nearest in time, if within `max_dt_ns`: closest pairs first,
/// each pose used once. In the order of time.
pub fn associate(truth: &Trajectory, estimate: &Trajectory, max_dt_ns: i64) -> Vec<Match> {
    let mut candidates = Vec::with_capacity(2 * estimate.len());
    for (estimate_idx, pose) in estimate.poses().iter().enumerate() {
        let after = truth.poses().partition_point(|p| p.timestamp_ns < pose.timestamp_ns);
        for truth_idx in [after.checked_sub(1), Some(after)].into_iter().flatten() {
            let Some(nearby) = truth.poses().get(truth_idx) else { continue };
            let dt_ns = nearby.timestamp_ns.abs_diff(pose.timestamp_ns);
            if dt_ns <= max_dt_ns.max(0).unsigned_abs() {
                candidates.push((dt_ns, Match { truth_idx, estimate_idx }));
            }
        }
    }
    candidates.sort_unstable();
    let (mut used_truth, mut used_estimate) = (BTreeSet::new(), BTreeSet::new());
    let mut matches = Vec::new();
    for (_, candidate) in candidates {
        if !used_truth.contains(&candidate.truth_idx) && used_estimate.insert(candidate.estimate_idx) {
            used_truth.insert(candidate.truth_idx);
            matches.push(candidate);
        }
    }
    matches.sort_unstable();
    matches
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StampedPose;
    use geometry::Pose;

    fn at(timestamps_ns: &[i64]) -> Trajectory {
        let pose = |&timestamp_ns| StampedPose { timestamp_ns, world_from_camera: Pose::identity() };
        Trajectory::new(timestamps_ns.iter().map(pose).collect())
    }

    fn pairs(truth: &[i64], estimate: &[i64], max_dt_ns: i64) -> Vec<(usize, usize)> {
        let matches = associate(&at(truth), &at(estimate), max_dt_ns);
        matches.into_iter().map(|m| (m.truth_idx, m.estimate_idx)).collect()
    }

    #[test]
    fn nearest_within_the_limit_wins() {
        assert_eq!(pairs(&[0, 10, 20], &[1, 11, 26], 5), [(0, 0), (1, 1)]);
        assert_eq!(pairs(&[0, 10, 20], &[1, 11, 26], 6), [(0, 0), (1, 1), (2, 2)]);
        assert_eq!(pairs(&[], &[1], 6), []);
        assert_eq!(pairs(&[1], &[], 6), []);
    }

    #[test]
    fn a_pose_is_used_once_and_the_closest_pair_comes_first() {
        // Both estimates are nearest to 10; the closer one takes it and the other falls back to 0.
        assert_eq!(pairs(&[0, 10], &[7, 9], 8), [(0, 0), (1, 1)]);
        assert_eq!(pairs(&[0, 10], &[7, 9], 5), [(1, 1)]);
    }
}
