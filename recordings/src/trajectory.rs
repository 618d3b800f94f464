//! Stamped camera poses, and the files they are exchanged in.

use std::fmt::Write as _;
use std::path::Path;

use geometry::Pose;
use geometry::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::files::{FileError, Line, TextFile};
use crate::time::{decimal_nano, format_seconds};
use crate::units::{self, TimeUnit};

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
        let read = Self::read_as(path, None)?;
        if !read.has_times {
            let message = "this is a KITTI trajectory, which has no times; use TUM or EuRoC format";
            return Err(FileError::content(path, message));
        }
        Ok(read.trajectory)
    }

    /// As [`read`](Self::read), times in a unit that is known, or told by their size. Says what was left out,
    /// and reads KITTI's files as well, whose poses get the times of a camera of 10 Hz.
    ///
    /// # Errors
    /// A [`FileError`] that names the line.
    pub fn read_as(path: &Path, unit: Option<TimeUnit>) -> Result<ReadTrajectory, FileError> {
        read_rows(&TextFile::read(path)?, unit)
    }

    /// Reads the text of a TUM file: `t tx ty tz qx qy qz qw` on each line, `#` before comments.
    ///
    /// # Errors
    /// A [`FileError`] that names the line.
    pub fn parse_tum(text: &str) -> Result<Self, FileError> {
        Ok(read_rows(&TextFile::from_text(Path::new("trajectory"), text), None)?.trajectory)
    }

    /// Reads a KITTI pose file, the upper three rows of `world_from_camera` on each line, for images taken at
    /// `timestamps_ns`.
    ///
    /// # Errors
    /// A [`FileError`] that names the line, or says that the number of poses is not that of the times.
    pub fn read_kitti(path: &Path, timestamps_ns: &[i64]) -> Result<Self, FileError> {
        let file = TextFile::read(path)?;
        let lines: Vec<Line<'_>> = file.lines().collect();
        if lines.len() != timestamps_ns.len() {
            return Err(file.error(format!("{} poses for {} images", lines.len(), timestamps_ns.len())));
        }
        let mut poses = Vec::with_capacity(lines.len());
        for (&timestamp_ns, line) in timestamps_ns.iter().zip(&lines) {
            if let Some(world_from_camera) = kitti_pose(line)? {
                poses.push(StampedPose { timestamp_ns, world_from_camera });
            }
        }
        Ok(Self::new(poses))
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

/// A trajectory as it was in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadTrajectory {
    /// Its poses.
    pub trajectory: Trajectory,
    /// The unit its times are in.
    pub unit: TimeUnit,
    /// Rows that say that there is no pose: with numbers that are none, or a quaternion of zeros.
    pub n_without_pose: usize,
    /// Whether it has times; KITTI's files have not.
    pub has_times: bool,
}

impl ReadTrajectory {
    /// What the user should know of how it was read from `path`.
    pub fn remarks(&self, path: &Path) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.n_without_pose > 0 {
            let message = format!(
                "{} rows have no pose and are skipped (not a number, or a quaternion of zeros)",
                self.n_without_pose
            );
            remarks.push(FileError::content(path, message).to_string());
        }
        remarks
    }
}

/// Where the columns of a file are.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Columns {
    /// Time, position, quaternion with the real part last.
    RealLast,
    /// The same with the real part first.
    RealFirst,
    /// The upper three rows of a matrix.
    Matrix,
}

/// Time between the poses of KITTI's files, nanoseconds.
const KITTI_INTERVAL_NS: i64 = 100_000_000;

fn read_rows(file: &TextFile, unit: Option<TimeUnit>) -> Result<ReadTrajectory, FileError> {
    let mut lines: Vec<Line<'_>> = file.lines().collect();
    if lines.len() > 1 && lines[0].fields().first().is_some_and(|word| is_word(word)) {
        lines.remove(0);
    }
    let columns = columns(file, lines.first());
    let mut rows = Vec::with_capacity(lines.len());
    for line in &lines {
        rows.push((line, line.fields()));
    }
    if columns == Columns::Matrix {
        return matrices(&rows);
    }
    let times: Vec<&str> = rows.iter().filter_map(|(_, fields)| fields.first().copied()).collect();
    // EuRoC's are integers, of nanoseconds.
    let is_euroc = columns == Columns::RealFirst && times.iter().all(|time| time.parse::<i64>().is_ok());
    let recognized = || if is_euroc { TimeUnit::Nanoseconds } else { units::of_poses(&times) };
    let unit = unit.unwrap_or_else(recognized);
    let mut poses = Vec::with_capacity(rows.len());
    let mut n_without_pose = 0;
    for (line, fields) in &rows {
        let timestamp_ns = time_of(line, fields, unit)?;
        match pose_of(line, fields, columns)? {
            Some(world_from_camera) => poses.push(StampedPose { timestamp_ns, world_from_camera }),
            None => n_without_pose += 1,
        }
    }
    Ok(ReadTrajectory { trajectory: Trajectory::new(poses), unit, n_without_pose, has_times: true })
}

/// Whether it is a word of a head, and no number, nor what stands for one.
fn is_word(field: &str) -> bool {
    decimal_nano(field).is_none() && field.parse::<f64>().is_err()
}

/// What the head says of the order, else what the separator says.
fn columns(file: &TextFile, first: Option<&Line<'_>>) -> Columns {
    if first.is_some_and(|line| line.fields().len() == 12 && !line.text.contains(',')) {
        return Columns::Matrix;
    }
    let head = file.text().lines().next().unwrap_or_default().to_lowercase();
    let place = |names: [&str; 3]| names.iter().find_map(|name| head.find(name));
    let (real, imaginary) = (place(["qw", "q_w", "q_rs_w"]), place(["qx", "q_x", "q_rs_x"]));
    match real.zip(imaginary) {
        Some((real, imaginary)) if real < imaginary => Columns::RealFirst,
        Some(_) => Columns::RealLast,
        None if first.is_some_and(|line| line.text.contains([',', ';'])) => Columns::RealFirst,
        None => Columns::RealLast,
    }
}

fn time_of(line: &Line<'_>, fields: &[&str], unit: TimeUnit) -> Result<i64, FileError> {
    let field = fields.first().copied().unwrap_or_default();
    let nano = decimal_nano(field).ok_or_else(|| line.error(format!("`{field}` is not a time")))?;
    let out_of_range =
        || line.error(format!("`{field}` is not a time in {unit} that can be counted in nanoseconds"));
    unit.to_ns(nano, None).ok_or_else(out_of_range)
}

fn pose_of(line: &Line<'_>, fields: &[&str], columns: Columns) -> Result<Option<Pose>, FileError> {
    if fields.len() < 8 {
        let expected = match columns {
            Columns::RealFirst => "t,px,py,pz,qw,qx,qy,qz",
            _ => "t tx ty tz qx qy qz qw",
        };
        return Err(line.error(format!("`{expected}` expected, {} fields found", fields.len())));
    }
    let mut numbers = [0.0; 7];
    for (number, field) in numbers.iter_mut().zip(&fields[1..8]) {
        *number = field.parse().map_err(|_| line.error(format!("`{field}` is not a number")))?;
    }
    let [tx, ty, tz, a, b, c, d] = numbers;
    let rotation = match columns {
        Columns::RealFirst => Quaternion::new(a, b, c, d),
        _ => Quaternion::new(d, a, b, c),
    };
    if numbers.iter().any(|number: &f64| !number.is_finite()) || rotation.norm() < NO_ROTATION {
        return Ok(None);
    }
    checked_pose(line, rotation, Vector3::new(tx, ty, tz)).map(Some)
}

/// A quaternion as short as this stands for no rotation.
const NO_ROTATION: f64 = 1e-9;

fn matrices(rows: &[(&Line<'_>, Vec<&str>)]) -> Result<ReadTrajectory, FileError> {
    let mut poses = Vec::with_capacity(rows.len());
    let mut n_without_pose = 0;
    for (idx, (line, _)) in rows.iter().enumerate() {
        let timestamp_ns = KITTI_INTERVAL_NS.saturating_mul(i64::try_from(idx).unwrap_or(i64::MAX));
        match kitti_pose(line)? {
            Some(world_from_camera) => poses.push(StampedPose { timestamp_ns, world_from_camera }),
            None => n_without_pose += 1,
        }
    }
    let trajectory = Trajectory::new(poses);
    Ok(ReadTrajectory { trajectory, unit: TimeUnit::Frames, n_without_pose, has_times: false })
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

/// The pose of a line; `None` if it says that there is none.
fn kitti_pose(line: &Line<'_>) -> Result<Option<Pose>, FileError> {
    let words = line.words();
    if words.iter().any(|word| word.parse().is_ok_and(|number: f64| !number.is_finite())) {
        return Ok(None);
    }
    let m: [f64; 12] = line.numbers(&words)?;
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let pose = pose_of_matrix(&rotation, Vector3::new(m[3], m[7], m[11]));
    pose.map(Some).ok_or_else(|| line.error("the first three columns are not a rotation"))
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
        assert_eq!(message("# c\n0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1"), "trajectory:3: `x` is not a number");
        assert_eq!(
            message("0 0 0 0 0 0 1"),
            "trajectory:1: `t tx ty tz qx qy qz qw` expected, 7 fields found"
        );
        assert!(message("0 0 0 0 0 0 0 2").contains("quaternion has length 2"));
        assert!(message("1 0 0 0 0 1 0 0 0 0 1 x").contains("`x` is not a finite number"));
    }

    fn read(bytes: &[u8]) -> ReadTrajectory {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses");
        std::fs::write(&path, bytes).unwrap();
        Trajectory::read_as(&path, None).unwrap()
    }

    #[test]
    fn rows_without_a_pose_are_skipped_and_counted() {
        let found =
            read(b"0 nan nan nan nan nan nan nan\n1 1 2 3 0 0 0 1\n2 0 0 0 0 0 0 0\n3 -inf 0 0 0 0 0 1\n");
        assert_eq!((found.trajectory.len(), found.n_without_pose), (1, 3));
        assert!(found.remarks(Path::new("a"))[0].contains("3 rows"));
        let found = read(b"1 0 0 nan 0 1 0 nan 0 0 1 nan\n1 0 0 4 0 1 0 5 0 0 1 6\n");
        assert_eq!((found.trajectory.len(), found.n_without_pose, found.has_times), (1, 1, false));
        assert_eq!(
            found.trajectory.poses()[0].timestamp_ns,
            KITTI_INTERVAL_NS,
            "the place of the row counts"
        );
    }

    #[test]
    fn marks_heads_and_units_are_seen_through() {
        let expected = read(b"1403715285.262142976 1 2 3 0.5 -0.5 0.5 0.5\n").trajectory;
        for text in [
            "\u{FEFF}1403715285.262142976 1 2 3 0.5 -0.5 0.5 0.5\r\n",
            "timestamp tx ty tz qx qy qz qw\n1403715285.262142976 1 2 3 0.5 -0.5 0.5 0.5\n",
            "1403715285262142976 1 2 3 0.5 -0.5 0.5 0.5\n",
            "1403715285262142976.000000 1 2 3 0.5 -0.5 0.5 0.5\n",
            "1.403715285262142976e18 1 2 3 0.5 -0.5 0.5 0.5\n",
            "1.403715285262142976e+18\t1\t2\t3\t0.5\t-0.5\t0.5\t0.5\n",
            "time,x,y,z,qx,qy,qz,qw\n1403715285.262142976,1,2,3,0.5,-0.5,0.5,0.5\n",
            "time;x;y;z;q_w;q_x;q_y;q_z\n1403715285262142976;1;2;3;0.5;0.5;-0.5;0.5\n",
            "#timestamp,p_x\n1403715285262142976,1,2,3,0.5,0.5,-0.5,0.5,9,9\n",
        ] {
            assert_eq!(read(text.as_bytes()).trajectory, expected, "{text}");
        }
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
