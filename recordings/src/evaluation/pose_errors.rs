//! How wrong each pose is, which a mean over all of them can hide.

use geometry::Pose;
use geometry::nalgebra::{UnitQuaternion, Vector3};

use super::{Alignment, associate};
use crate::Trajectory;

/// A pose is wrong if its attitude is off by more than this, degrees: far beyond what blur and a poor truth
/// explain.
const WRONG_ATTITUDE_DEG: f64 = 5.0;
/// Or its position by more than this share of the path.
const WRONG_POSITION_SHARE: f64 = 0.05;

/// The errors of one estimated pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// When, nanoseconds.
    pub timestamp_ns: i64,
    /// Distance of the positions after alignment by a similarity, as a share of the true path.
    pub position_share: f64,
    /// Angle between the attitudes after alignment by their mean difference: positions of a small or straight
    /// path do not tell how it is turned.
    pub attitude_deg: f64,
}

impl PoseError {
    /// Whether it is off by more than 5 degrees or 5 % of the path.
    #[must_use]
    pub fn is_wrong(&self) -> bool {
        self.attitude_deg > WRONG_ATTITUDE_DEG || self.position_share > WRONG_POSITION_SHARE
    }
}

/// The errors of the estimated poses that have a true one within `max_dt_ns`, in the order of time. None
/// where too few have, or they lie on one line.
#[must_use]
pub fn pose_errors(truth: &Trajectory, estimate: &Trajectory, max_dt_ns: i64) -> Vec<PoseError> {
    let pairs: Vec<(i64, Pose, Pose)> = associate(truth, estimate, max_dt_ns)
        .into_iter()
        .map(|m| {
            let (of_truth, of_estimate) = (truth.poses()[m.truth_idx], estimate.poses()[m.estimate_idx]);
            (of_estimate.timestamp_ns, of_truth.world_from_camera, of_estimate.world_from_camera)
        })
        .collect();
    let positions = |of: fn(&(i64, Pose, Pose)) -> Vector3<f64>| pairs.iter().map(of).collect::<Vec<_>>();
    let true_positions = positions(|(_, truth, _)| truth.translation);
    let estimated_positions = positions(|(_, _, estimate)| estimate.translation);
    let Some(truth_from_estimate) = (pairs.len() >= 3)
        .then(|| Alignment::Sim3.truth_from_estimate(&true_positions, &estimated_positions))
        .flatten()
    else {
        return Vec::new();
    };
    let path: f64 = true_positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let turn =
        mean_rotation(pairs.iter().map(|(_, truth, estimate)| truth.rotation * estimate.rotation.inverse()));
    let error = |(timestamp_ns, truth, estimate): &(i64, Pose, Pose)| PoseError {
        timestamp_ns: *timestamp_ns,
        position_share: (truth.translation - truth_from_estimate * estimate.translation).norm() / path,
        attitude_deg: truth.rotation.angle_to(&(turn * estimate.rotation)).to_degrees(),
    };
    pairs.iter().map(error).collect()
}

/// The rotation whose quaternion is nearest to all of them.
fn mean_rotation(rotations: impl Iterator<Item = UnitQuaternion<f64>>) -> UnitQuaternion<f64> {
    let sum = rotations.map(|rotation| rotation.into_inner()).reduce(|sum, quaternion| {
        // A quaternion and its negative are the same rotation.
        sum + if sum.dot(&quaternion) < 0.0 { -quaternion } else { quaternion }
    });
    sum.map_or_else(UnitQuaternion::identity, UnitQuaternion::from_quaternion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StampedPose;
    use geometry::so3;

    /// A circle of a hundred frames, of which those in `turned` look `aside_deg` to the side.
    fn circle(turned: std::ops::Range<i32>, aside_deg: f64) -> Trajectory {
        let pose = |i: i32| {
            let angle = 0.05 * f64::from(i);
            let aside = if turned.contains(&i) { aside_deg.to_radians() } else { 0.0 };
            let rotation = so3::exp(&Vector3::new(0.0, 0.0, angle + aside));
            let world_from_camera = Pose::new(rotation, Vector3::new(angle.cos(), angle.sin(), 0.0));
            StampedPose { timestamp_ns: i64::from(i), world_from_camera }
        };
        Trajectory::new((0..100).map(pose).collect())
    }

    #[test]
    fn the_frames_that_are_turned_are_the_wrong_ones() {
        let errors = pose_errors(&circle(0..0, 0.0), &circle(40..45, 20.0), 0);
        let wrong: Vec<i64> =
            errors.iter().filter(|error| error.is_wrong()).map(|error| error.timestamp_ns).collect();
        assert_eq!(wrong, [40, 41, 42, 43, 44]);
        assert!(errors.iter().all(|error| error.position_share < 1e-9));
    }

    #[test]
    fn an_estimate_in_a_frame_of_its_own_has_no_errors() {
        let truth = circle(0..0, 0.0);
        let turn = Pose::new(so3::exp(&Vector3::new(0.3, -2.0, 1.1)), Vector3::new(1.0, 2.0, 3.0));
        let turned =
            |pose: &StampedPose| StampedPose { world_from_camera: turn * pose.world_from_camera, ..*pose };
        let estimate = Trajectory::new(truth.poses().iter().map(turned).collect());
        let errors = pose_errors(&truth, &estimate, 0);
        assert_eq!(errors.len(), 100);
        assert!(errors.iter().all(|error| error.attitude_deg < 1e-5 && error.position_share < 1e-9));
    }

    #[test]
    fn a_frame_that_was_misplaced_is_wrong() {
        let truth = circle(0..0, 0.0);
        let mut poses = truth.poses().to_vec();
        poses[7].world_from_camera.translation.z += 0.5;
        let errors = pose_errors(&truth, &Trajectory::new(poses), 0);
        assert_eq!(errors.iter().filter(|error| error.is_wrong()).count(), 1);
        assert!(errors[7].is_wrong() && errors[7].attitude_deg < 1e-6);
    }

    #[test]
    fn nothing_is_said_of_a_straight_path() {
        let straight = |i: i64| StampedPose {
            timestamp_ns: i,
            world_from_camera: Pose::new(UnitQuaternion::identity(), Vector3::new(i as f64, 0.0, 0.0)),
        };
        let trajectory = Trajectory::new((0..9).map(straight).collect());
        assert_eq!(pose_errors(&trajectory, &trajectory, 0), []);
    }
}
