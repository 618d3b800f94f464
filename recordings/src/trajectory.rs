//! Stamped camera poses, and the files they are exchanged in.

use std::fmt::Write as _;
use std::path::Path;

use geometry::Pose;
use geometry::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::files::{FileError, Line, TextFile};
use crate::time::format_seconds;

/// A quaternion or rotation matrix further than this from unit length or orthonormality is a mistake in the
/// file, not rounding: published trajectories keep at least four digits.
const MAX_ROTATION_ERROR: f64 = 1e-2;

/// Where a camera was at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time of the image, nanoseconds.
    pub timestamp_ns: i64,
    /// Maps camera coordinates (x right, y down, z forward) to the world's.
    pub world_from_camera: Pose,
}

/// Camera poses in the order of their times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Sorts the poses by time; those of one time keep their order.
    pub fn new(mut poses: Vec<StampedPose>) -> Self {
        poses.sort_by_key(|pose| pose.timestamp_ns);
        Self { poses }
    }

    /// The poses in the order of their times.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The same camera seen from a body: every pose times `source_from_camera`.
    #[must_use]
    pub fn compose(&self, source_from_camera: &Pose) -> Self {
        let poses = self.poses.iter().map(|pose| StampedPose {
            world_from_camera: pose.world_from_camera * source_from_camera,
            ..*pose
        });
        Self { poses: poses.collect() }
    }

    /// Reads a trajectory file: TUM (`t tx ty tz qx qy qz qw`, seconds) or EuRoC
    /// (`t,px,py,pz,qw,qx,qy,qz[,…]`, nanoseconds), told apart by the commas.
    ///
    /// # Errors
    /// A [`FileError`] that names the line.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let file = TextFile::read(path)?;
        let is_csv = file.lines().next().is_some_and(|line| line.text.contains(','));
        if is_csv { euroc_trajectory(&file) } else { tum_trajectory(&file) }
    }

    /// Reads the text of a TUM file: `t tx ty tz qx qy qz qw` on each line, `#` before comments.
    ///
    /// # Errors
    /// A [`FileError`] that names the line.
    pub fn parse_tum(text: &str) -> Result<Self, FileError> {
        tum_trajectory(&TextFile::from_text(Path::new("trajectory"), text))
    }

    /// Reads a KITTI pose file, the upper three rows of `world_from_camera` on each line, for images taken at
    /// `timestamps_ns`.
    ///
    /// # Errors
    /// A [`FileError`] that names the line, or says that the number of poses is not that of the times.
    pub fn read_kitti(path: &Path, timestamps_ns: &[i64]) -> Result<Self, FileError> {
        let file = TextFile::read(path)?;
        let poses = file.lines().map(|line| kitti_pose(&line)).collect::<Result<Vec<_>, _>>()?;
        if poses.len() != timestamps_ns.len() {
            return Err(file.error(format!("{} poses for {} images", poses.len(), timestamps_ns.len())));
        }
        let stamped = timestamps_ns.iter().zip(poses);
        Ok(Self::new(
            stamped
                .map(|(&timestamp_ns, world_from_camera)| StampedPose { timestamp_ns, world_from_camera })
                .collect(),
        ))
    }

    /// The trajectory as a TUM file, nine decimals in times and twelve digits in numbers.
    pub fn to_tum(&self) -> String {
        let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
        for pose in &self.poses {
            let t = &pose.world_from_camera.translation;
            let q = pose.world_from_camera.rotation.coords;
            let time = format_seconds(pose.timestamp_ns);
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "{time} {:.12} {:.12} {:.12} {:.12} {:.12} {:.12} {:.12}",
                t.x, t.y, t.z, q.x, q.y, q.z, q.w
            );
        }
        text
    }
}

fn tum_trajectory(file: &TextFile) -> Result<Trajectory, FileError> {
    let pose = |line: Line<'_>| {
        let fields = line.words();
        if fields.len() == 12 {
            return Err(line.error("this is a KITTI trajectory, which has no times; use TUM or EuRoC format"));
        }
        if fields.len() < 8 {
            return Err(
                line.error(format!("`t tx ty tz qx qy qz qw` expected, {} fields found", fields.len()))
            );
        }
        let [tx, ty, tz, qx, qy, qz, qw] = line.numbers(&fields[1..8])?;
        Ok(StampedPose {
            timestamp_ns: line.seconds_ns(fields[0])?,
            world_from_camera: checked_pose(
                &line,
                Quaternion::new(qw, qx, qy, qz),
                Vector3::new(tx, ty, tz),
            )?,
        })
    };
    Ok(Trajectory::new(file.lines().map(pose).collect::<Result<_, _>>()?))
}

fn euroc_trajectory(file: &TextFile) -> Result<Trajectory, FileError> {
    let pose = |line: Line<'_>| {
        let cells = line.cells();
        if cells.len() < 8 {
            return Err(
                line.error(format!("`t,px,py,pz,qw,qx,qy,qz` expected, {} fields found", cells.len()))
            );
        }
        let [tx, ty, tz, qw, qx, qy, qz] = line.numbers(&cells[1..8])?;
        Ok(StampedPose {
            timestamp_ns: line.integer_ns(cells[0])?,
            world_from_camera: checked_pose(
                &line,
                Quaternion::new(qw, qx, qy, qz),
                Vector3::new(tx, ty, tz),
            )?,
        })
    };
    Ok(Trajectory::new(file.lines().map(pose).collect::<Result<_, _>>()?))
}

fn checked_pose(
    line: &Line<'_>,
    rotation: Quaternion<f64>,
    translation: Vector3<f64>,
) -> Result<Pose, FileError> {
    if (rotation.norm() - 1.0).abs() > MAX_ROTATION_ERROR {
        return Err(line.error(format!("the quaternion has length {:.4}, not one", rotation.norm())));
    }
    Ok(Pose::new(UnitQuaternion::from_quaternion(rotation), translation))
}

fn kitti_pose(line: &Line<'_>) -> Result<Pose, FileError> {
    let m: [f64; 12] = line.numbers(&line.words())?;
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let pose = pose_of_matrix(&rotation, Vector3::new(m[3], m[7], m[11]));
    pose.ok_or_else(|| line.error("the first three columns are not a rotation"))
}

/// The pose of a rotation matrix that is orthonormal but for rounding; `None` if it is not.
pub(crate) fn pose_of_matrix(rotation: &Matrix3<f64>, translation: Vector3<f64>) -> Option<Pose> {
    let off = (rotation.transpose() * rotation - Matrix3::identity()).norm();
    if !(off <= MAX_ROTATION_ERROR && rotation.determinant() > 0.0) {
        return None;
    }
    Some(Pose::new(UnitQuaternion::from_matrix(rotation), translation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tum_file_comes_back_as_written() {
        let text = "# a comment\n\n1403715285.262142976 1 -2 3.5 0.5 0.5 0.5 0.5\n1403715285.062142976 0 0 0 0 0 0 1\n";
        let trajectory = Trajectory::parse_tum(text).unwrap();
        assert_eq!(trajectory.poses()[0].timestamp_ns, 1_403_715_285_062_142_976);
        assert_eq!(trajectory.poses()[1].world_from_camera.translation, Vector3::new(1.0, -2.0, 3.5));
        let again = Trajectory::parse_tum(&trajectory.to_tum()).unwrap();
        assert_eq!(again, trajectory);
    }

    #[test]
    fn euroc_and_tum_agree() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data.csv");
        std::fs::write(&path, "#timestamp, p_x\n1500000000,1,2,3,0.5,0.5,-0.5,0.5,9,9\n").unwrap();
        let tum = Trajectory::parse_tum("1.5 1 2 3 0.5 -0.5 0.5 0.5").unwrap();
        assert_eq!(Trajectory::read(&path).unwrap(), tum);
    }

    #[test]
    fn errors_name_the_line() {
        let message = |text: &str| Trajectory::parse_tum(text).unwrap_err().to_string();
        assert_eq!(
            message("# c\n0 0 0 0 0 0 0 1\n1 0 0 nan 0 0 0 1"),
            "trajectory:3: `nan` is not a finite number"
        );
        assert_eq!(
            message("0 0 0 0 0 0 1"),
            "trajectory:1: `t tx ty tz qx qy qz qw` expected, 7 fields found"
        );
        assert!(message("0 0 0 0 0 0 0 0").contains("quaternion"));
        assert!(message("1 0 0 0 0 1 0 0 0 0 1 0").contains("KITTI"));
    }

    #[test]
    fn kitti_rows_are_rotation_and_translation() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("00.txt");
        std::fs::write(&path, "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 4 0 1 0 5 -1 0 0 6\n").unwrap();
        let trajectory = Trajectory::read_kitti(&path, &[0, 100]).unwrap();
        let moved = trajectory.poses()[1].world_from_camera * Vector3::new(0.0, 0.0, 1.0);
        assert!((moved - Vector3::new(5.0, 5.0, 6.0)).norm() < 1e-12);
        assert!(
            Trajectory::read_kitti(&path, &[0]).unwrap_err().to_string().contains("2 poses for 1 images")
        );
    }
}
