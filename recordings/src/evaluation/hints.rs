//! What may be wrong with a file whose figures are bad, told by what would make them good.

use geometry::Pose;
use geometry::nalgebra::{Quaternion, UnitQuaternion};

use super::{Evaluation, EvaluationOptions, evaluate};
use crate::{StampedPose, Trajectory};

/// Rotations further off than this are not explained by a poor estimate alone, degrees.
const SUSPICIOUS_DEG: f64 = 10.0;

/// An explanation must take out all but this share of the error.
const EXPLAINED_SHARE: f64 = 0.25;

/// Sentences about what may be wrong.
pub fn hints(
    truth: &Trajectory,
    estimate: &Trajectory,
    options: &EvaluationOptions,
    evaluation: &Evaluation,
) -> Vec<String> {
    let mut hints = Vec::new();
    if evaluation.rot_rmse_deg > SUSPICIOUS_DEG {
        let rotation_error = |truth: &Trajectory, estimate: &Trajectory| {
            evaluate(truth, estimate, options).map_or(f64::INFINITY, |evaluation| evaluation.rot_rmse_deg)
        };
        for (name, error_deg) in [
            ("estimate", rotation_error(truth, &with_real_part_first(estimate))),
            ("ground truth", rotation_error(&with_real_part_first(truth), estimate)),
        ] {
            if error_deg < EXPLAINED_SHARE * evaluation.rot_rmse_deg {
                hints.push(format!(
                    "the rotations are off by {:.0} degrees, and by {error_deg:.2} if the quaternions of the {name} have \
                     w first; `qx qy qz qw` is expected",
                    evaluation.rot_rmse_deg
                ));
            }
        }
    }
    if evaluation.matched < evaluation.poses / 2 {
        hints.push(format!(
            "{} of {} estimated poses have a true one at their time: the figures speak of these alone (--max-dt allows \
             more)",
            evaluation.matched, evaluation.poses
        ));
    }
    hints
}

/// The poses as if each quaternion had been written with its real part first and read with it last.
fn with_real_part_first(trajectory: &Trajectory) -> Trajectory {
    let poses = trajectory.poses().iter().map(|pose| {
        let read = pose.world_from_camera.rotation.coords;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(read.x, read.y, read.z, read.w));
        let world_from_camera = Pose::new(rotation, pose.world_from_camera.translation);
        StampedPose { world_from_camera, ..*pose }
    });
    Trajectory::new(poses.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Vector3;
    use geometry::so3;

    fn path() -> Trajectory {
        let pose = |i: i32| {
            let t = 0.05 * f64::from(i);
            let rotation = so3::exp(&Vector3::new(0.4 + 0.1 * t, 0.9 - 0.3 * t, 0.2 * t.sin()));
            let world_from_camera = Pose::new(rotation, Vector3::new(t.cos(), t.sin(), 0.3 * t));
            StampedPose { timestamp_ns: i64::from(i) * 50_000_000, world_from_camera }
        };
        Trajectory::new((0..100).map(pose).collect())
    }

    /// The poses as a file with the real part first is read.
    fn misread(trajectory: &Trajectory) -> Trajectory {
        let poses = trajectory.poses().iter().map(|pose| {
            let q = pose.world_from_camera.rotation.coords;
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.z, q.w, q.x, q.y));
            let world_from_camera = Pose::new(rotation, pose.world_from_camera.translation);
            StampedPose { world_from_camera, ..*pose }
        });
        Trajectory::new(poses.collect())
    }

    fn said(truth: &Trajectory, estimate: &Trajectory) -> String {
        let options = EvaluationOptions::default();
        let evaluation = evaluate(truth, estimate, &options).unwrap();
        hints(truth, estimate, &options, &evaluation).join("; ")
    }

    #[test]
    fn quaternions_with_w_first_are_recognized_on_either_side() {
        let truth = path();
        assert_eq!(said(&truth, &truth), "");
        let hint = said(&truth, &misread(&truth));
        assert!(hint.contains("of the estimate have w first") && hint.contains("and by 0.00"), "{hint}");
        assert!(said(&misread(&truth), &truth).contains("of the ground truth have w first"));
    }

    #[test]
    fn a_rotation_that_is_simply_wrong_is_not_explained() {
        let truth = path();
        let poses = truth.poses().iter().zip(0..).map(|(pose, i)| {
            let turn = so3::exp(&Vector3::new(0.0, 0.3 * f64::from(i), 0.0));
            let world_from_camera =
                Pose::new(turn * pose.world_from_camera.rotation, pose.world_from_camera.translation);
            StampedPose { world_from_camera, ..*pose }
        });
        assert_eq!(said(&truth, &Trajectory::new(poses.collect())), "");
    }

    #[test]
    fn a_small_matched_share_is_told() {
        let truth = path();
        let few = Trajectory::new(truth.poses()[..30].to_vec());
        assert!(said(&few, &truth).contains("30 of 100 estimated poses"), "{}", said(&few, &truth));
    }
}
