//! Errors of segments as the benchmark of KITTI odometry has them [Geiger et al., CVPR 2012].

use geometry::{Pose, so3};
use serde::{Deserialize, Serialize};

/// Lengths of the segments along the true path, meters.
const LENGTHS_M: [f64; 8] = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0];

/// A segment begins at each tenth pose, a second of the benchmark's camera.
const STEP: usize = 10;

/// Mean errors over all segments of 100 to 800 m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentErrors {
    /// Translation, percent of the length.
    pub t_rel_percent: f64,
    /// Rotation, degrees per 100 m.
    pub r_rel_deg_per_100m: f64,
    /// Segments.
    pub n_segments: usize,
}

/// The errors of matched poses, the estimate brought to the true scale; `None` if the path is shorter than
/// the shortest segment.
pub(super) fn segment_errors(truth: &[Pose], estimate: &[Pose], scale: f64) -> Option<SegmentErrors> {
    let mut distances = Vec::with_capacity(truth.len());
    let mut distance = 0.0;
    for (i, pose) in truth.iter().enumerate() {
        if i > 0 {
            distance += (pose.translation - truth[i - 1].translation).norm();
        }
        distances.push(distance);
    }
    let (mut translation, mut rotation, mut n_segments) = (0.0, 0.0, 0);
    for first in (0..truth.len()).step_by(STEP) {
        for length in LENGTHS_M {
            let end = distances[first] + length;
            let last = first + distances[first..].partition_point(|distance| *distance <= end);
            if last == truth.len() {
                break;
            }
            let motion = |poses: &[Pose], scale: f64| {
                let motion = poses[first].inverse() * poses[last];
                Pose::new(motion.rotation, scale * motion.translation)
            };
            let error = motion(estimate, scale).inverse() * motion(truth, 1.0);
            translation += error.translation.norm() / length;
            rotation += so3::log(&error.rotation).norm().to_degrees() / length;
            n_segments += 1;
        }
    }
    let mean = |sum: f64| 100.0 * sum / n_segments as f64;
    (n_segments > 0).then(|| SegmentErrors {
        t_rel_percent: mean(translation),
        r_rel_deg_per_100m: mean(rotation),
        n_segments,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::{UnitQuaternion, Vector3};

    /// A straight drive at one meter a frame.
    fn drive(n: i32, scale: f64) -> Vec<Pose> {
        let pose =
            |i: i32| Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, scale * f64::from(i)));
        (0..n).map(pose).collect()
    }

    #[test]
    fn a_wrong_scale_is_its_percentage() {
        let errors = segment_errors(&drive(1000, 1.0), &drive(1000, 1.02), 1.0).unwrap();
        // A segment ends at the first pose beyond its length: here it is one meter longer.
        assert!((errors.t_rel_percent - 2.0).abs() < 0.02, "{errors:?}");
        assert!(errors.r_rel_deg_per_100m < 1e-9);
        // From 0, 10, … the segments of each length that fit below 999 m: 90 of 100 m, 80 of 200 m, …
        assert_eq!(errors.n_segments, 90 + 80 + 70 + 60 + 50 + 40 + 30 + 20);
    }

    #[test]
    fn a_steady_turn_is_degrees_per_hundred_meters() {
        let truth = drive(500, 1.0);
        let turned: Vec<Pose> = (0..500)
            .map(|i| {
                let angle = (0.01 * f64::from(i)).to_radians();
                Pose::new(so3::exp(&Vector3::new(0.0, angle, 0.0)), truth[i as usize].translation)
            })
            .collect();
        let errors = segment_errors(&truth, &turned, 1.0).unwrap();
        assert!((errors.r_rel_deg_per_100m - 1.0).abs() < 0.02, "{errors:?}");
    }

    #[test]
    fn a_short_path_has_no_segments() {
        assert_eq!(segment_errors(&drive(100, 1.0), &drive(100, 1.0), 1.0), None);
        assert_eq!(segment_errors(&[], &[], 1.0), None);
    }
}
