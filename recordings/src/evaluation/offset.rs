//! Whether an estimate has another clock than the truth: the constant offset between their times under which
//! the positions agree best.

use geometry::Similarity;
use geometry::nalgebra::Vector3;

use crate::Trajectory;

/// Poses of the estimate that are compared; more say no more.
const MAX_POSES: usize = 200;

/// Offsets that are tried before the best is refined.
const MAX_TRIALS: usize = 4000;

/// The share of the shorter trajectory that must have a counterpart: with few, anything agrees.
const MIN_OVERLAP: f64 = 0.5;

/// Rounds of refinement, each with a third of the step: from a tenth of a second to microseconds.
const N_REFINEMENTS: usize = 12;

/// An offset is worth a word if the error without it is this many times greater.
const MIN_GAIN: f64 = 2.0;

/// Positions that agree no better than this, as a share of their spread, agree by chance.
const MAX_RELATIVE_ERROR: f64 = 0.1;

/// What the times of an estimate should be shifted by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeOffset {
    /// To be added to the times of the estimate, nanoseconds.
    pub offset_ns: i64,
    /// How many times smaller the error of the positions becomes; infinite if nothing fits without.
    pub gain: f64,
}

/// The offset that brings the estimate onto the truth, if it does much better than none.
pub fn find_offset(truth: &Trajectory, estimate: &Trajectory) -> Option<TimeOffset> {
    let search = Search::new(truth, estimate)?;
    let without = search.error(0).unwrap_or(f64::INFINITY);
    let (mut best_ns, mut best, mut step_ns) = search.coarse()?;
    for _ in 0..N_REFINEMENTS {
        step_ns = (step_ns / 3).max(1);
        for candidate in [best_ns - 2 * step_ns, best_ns - step_ns, best_ns + step_ns, best_ns + 2 * step_ns]
        {
            if let Some(error) = search.error(candidate).filter(|error| *error < best) {
                (best_ns, best) = (candidate, error);
            }
        }
    }
    let gain = without / best.max(f64::MIN_POSITIVE);
    (best < MAX_RELATIVE_ERROR && gain >= MIN_GAIN && best_ns.abs() >= search.least_ns)
        .then_some(TimeOffset { offset_ns: best_ns, gain })
}

struct Search {
    truth: Vec<(i64, Vector3<f64>)>,
    estimate: Vec<(i64, Vector3<f64>)>,
    /// A gap in the truth that is not interpolated over.
    max_gap_ns: i64,
    /// Less than a fifth of the time between poses is no offset of clocks.
    least_ns: i64,
}

impl Search {
    fn new(truth: &Trajectory, estimate: &Trajectory) -> Option<Self> {
        let positions = |trajectory: &Trajectory, every: usize| -> Vec<_> {
            let poses = trajectory.poses().iter().step_by(every);
            poses.map(|pose| (pose.timestamp_ns, pose.world_from_camera.translation)).collect()
        };
        let estimate = positions(estimate, estimate.len().div_ceil(MAX_POSES).max(1));
        let truth = positions(truth, 1);
        if truth.len() < 3 || estimate.len() < 3 {
            return None;
        }
        let mut gaps: Vec<i64> = truth.windows(2).map(|pair| pair[1].0.saturating_sub(pair[0].0)).collect();
        gaps.sort_unstable();
        let gap_ns = gaps[gaps.len() / 2].max(1);
        Some(Self { truth, estimate, max_gap_ns: gap_ns.saturating_mul(5), least_ns: gap_ns / 5 })
    }

    /// The best of offsets evenly spaced, its error, and their spacing.
    fn coarse(&self) -> Option<(i64, f64, i64)> {
        let span = |poses: &[(i64, Vector3<f64>)]| poses[poses.len() - 1].0.saturating_sub(poses[0].0);
        let shorter = span(&self.truth).min(span(&self.estimate));
        let overlap = (MIN_OVERLAP * shorter as f64) as i64;
        let first =
            self.truth[0].0.saturating_sub(self.estimate[self.estimate.len() - 1].0).saturating_add(overlap);
        let last =
            self.truth[self.truth.len() - 1].0.saturating_sub(self.estimate[0].0).saturating_sub(overlap);
        let range = last.checked_sub(first).filter(|range| *range >= 0)?;
        let step_ns = (range / MAX_TRIALS as i64).max(self.max_gap_ns / 10).max(1);
        let candidates = (0..=range / step_ns).map(|i| first + i * step_ns);
        let tried = candidates.filter_map(|offset_ns| Some((offset_ns, self.error(offset_ns)?)));
        let (offset_ns, error) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((offset_ns, error, step_ns))
    }

    /// Root mean square distance after alignment by a similarity, as a share of the spread of the truth.
    fn error(&self, offset_ns: i64) -> Option<f64> {
        let (mut true_positions, mut estimated) = (Vec::new(), Vec::new());
        for (timestamp_ns, position) in &self.estimate {
            if let Some(truth) = self.at(timestamp_ns.checked_add(offset_ns)?) {
                true_positions.push(truth);
                estimated.push(*position);
            }
        }
        if (true_positions.len() as f64) < MIN_OVERLAP * self.estimate.len() as f64
            || true_positions.len() < 3
        {
            return None;
        }
        let truth_from_estimate = Similarity::from_correspondences(&estimated, &true_positions, true)?;
        let pairs = true_positions.iter().zip(&estimated);
        let squared: f64 =
            pairs.map(|(truth, position)| (truth - truth_from_estimate * *position).norm_squared()).sum();
        let mean = true_positions.iter().sum::<Vector3<f64>>() / true_positions.len() as f64;
        let spread: f64 = true_positions.iter().map(|position| (position - mean).norm_squared()).sum();
        (spread > 0.0).then(|| (squared / spread).sqrt())
    }

    /// The true position at a time, between two poses.
    fn at(&self, timestamp_ns: i64) -> Option<Vector3<f64>> {
        let after = self.truth.partition_point(|(time, _)| *time < timestamp_ns);
        let (next_ns, next) = self.truth.get(after)?;
        if *next_ns == timestamp_ns {
            return Some(*next);
        }
        let (last_ns, last) = self.truth.get(after.checked_sub(1)?)?;
        let gap_ns = next_ns - last_ns;
        (gap_ns <= self.max_gap_ns).then(|| last.lerp(next, (timestamp_ns - last_ns) as f64 / gap_ns as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StampedPose;
    use geometry::{Pose, so3};

    /// A path that never repeats, at 20 Hz.
    fn path(shift_ns: i64, scale: f64, n: i32) -> Trajectory {
        let pose = |i: i32| {
            let t = 0.05 * f64::from(i);
            let position = Vector3::new(t.sin() + 0.2 * t, (1.7 * t).cos(), (0.6 * t).sin() * 0.5);
            let world_from_camera = Pose::new(so3::exp(&Vector3::new(0.1 * t, 0.0, 0.0)), scale * position);
            StampedPose { timestamp_ns: i64::from(i) * 50_000_000 + shift_ns, world_from_camera }
        };
        Trajectory::new((0..n).map(pose).collect())
    }

    #[test]
    fn an_offset_of_clocks_is_found() {
        let truth = path(1_403_715_285_000_000_000, 1.0, 400);
        for shift_ns in [2_000_000_000, -730_000_000, 17_000_000, -1_403_715_285_000_000_000] {
            let estimate = path(1_403_715_285_000_000_000 + shift_ns, 0.3, 300);
            let found = find_offset(&truth, &estimate).unwrap_or_else(|| panic!("{shift_ns}"));
            assert!((found.offset_ns + shift_ns).abs() < 1_000_000, "{shift_ns}: {found:?}");
        }
    }

    #[test]
    fn where_there_is_none_nothing_is_said() {
        let truth = path(0, 1.0, 400);
        assert_eq!(find_offset(&truth, &path(0, 2.0, 300)), None);
        assert_eq!(find_offset(&truth, &path(1_000_000, 2.0, 300)), None, "a millisecond at 20 Hz");
        assert_eq!(find_offset(&truth, &Trajectory::default()), None);
        let straight = |i: i64| StampedPose {
            timestamp_ns: i * 50_000_000,
            world_from_camera: Pose::new(so3::exp(&Vector3::zeros()), Vector3::new(i as f64, 0.0, 0.0)),
        };
        let straight = Trajectory::new((0..100).map(straight).collect());
        assert_eq!(find_offset(&straight, &straight), None);
    }
}
