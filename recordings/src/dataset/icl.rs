//! ICL-NUIM [Handa et al., ICRA 2014] in its form compatible with TUM RGB-D: `rgb/`, `associations.txt`
//! (`number depth/number.png number rgb/number.png`) and the true poses in a file `*.gt.freiburg`.
//!
//! The scenes were rendered by a left-handed program: its camera has `fy = -480`, its `y` axis up. We use
//! `fy = 480`, `y` down, and mirror the true poses with it: with `S = diag(1, -1, 1)`, a pose `(R, t)`
//! becomes `(S R S, S t)`. An unmirrored ground truth cannot be matched by any proper rotation.

use std::path::{Path, PathBuf};

use geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use geometry::{CameraModel, CameraParameters, Pose};

use super::options::Reading;
use super::{Content, FrameFile, folder, listing};
use crate::calibration::checked_camera;
use crate::files::{FileError, Line, TextFile};
use crate::units::TimeUnit;
use crate::{StampedPose, Trajectory};

const IMAGES: &str = "rgb";
const LIST: &str = "rgb.txt";
const ASSOCIATIONS: &str = "associations.txt";
const GROUND_TRUTH_SUFFIX: &str = ".gt.freiburg";

/// The sequences are numbered at this rate.
const FRAMES_PER_SECOND: i64 = 30;

pub(super) fn is_recording(root: &Path) -> bool {
    root.join(IMAGES).is_dir()
        && (root.join(ASSOCIATIONS).is_file() || matches!(mirrored_ground_truth_file(root), Ok(Some(_))))
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let parameters = CameraParameters {
        model: CameraModel::Pinhole,
        width: 640,
        height: 480,
        fx: 481.2,
        fy: 480.0,
        cx: 319.5,
        cy: 239.5,
        distortion: Vec::new(),
    };
    let frames = if root.join(LIST).is_file() {
        listing::read(root, &root.join(LIST), reading)?
    } else if root.join(ASSOCIATIONS).is_file() {
        associated_frames(root, reading)?
    } else {
        numbered_frames(&root.join(IMAGES))?
    };
    let ground_truth = match mirrored_ground_truth_file(root)? {
        Some(path) => Some(mirrored_trajectory(&path)?),
        None => folder::ground_truth(root)?,
    };
    let camera = reading.camera(&frames, || checked_camera(root, parameters))?;
    Ok(Content { camera, frames, ground_truth })
}

/// Time of the frame of that number, nanoseconds.
fn frame_time_ns(number: i64) -> Option<i64> {
    Some(number.checked_mul(1_000_000_000)? / FRAMES_PER_SECOND)
}

fn associated_frames(root: &Path, reading: &Reading<'_>) -> Result<Vec<FrameFile>, FileError> {
    let file = TextFile::read(&root.join(ASSOCIATIONS))?;
    let mut frames = Vec::new();
    for line in file.lines() {
        match associated_frame(root, &line) {
            Ok(frame) => frames.push((line, frame)),
            Err(error) => reading.bad_line(error)?,
        }
    }
    listing::in_order(frames, reading)
}

fn associated_frame(root: &Path, line: &Line<'_>) -> Result<FrameFile, FileError> {
    let words = line.words();
    // Either of the two files may come first.
    let image = words.iter().position(|word| word.starts_with("rgb/"));
    let Some(image) = image.filter(|position| *position > 0) else {
        return Err(line.error("`number depth/number.png number rgb/number.png` expected"));
    };
    let number = words[image - 1].parse().ok().and_then(frame_time_ns);
    let timestamp_ns =
        number.ok_or_else(|| line.error(format!("`{}` is not the number of a frame", words[image - 1])))?;
    Ok(FrameFile { timestamp_ns, path: listing::existing(line, root.join(words[image]))? })
}

/// The images named by a number alone, in the order of their numbers.
fn numbered_frames(folder: &Path) -> Result<Vec<FrameFile>, FileError> {
    let mut frames = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|source| FileError::io(folder, source))? {
        let path = entry.map_err(|source| FileError::io(folder, source))?.path();
        let number = path.file_stem().and_then(|stem| stem.to_str()?.parse().ok());
        if let Some(timestamp_ns) = number.and_then(frame_time_ns) {
            frames.push(FrameFile { timestamp_ns, path });
        }
    }
    frames.sort_by_key(|frame| frame.timestamp_ns);
    Ok(frames)
}

fn mirrored_ground_truth_file(root: &Path) -> Result<Option<PathBuf>, FileError> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(root).map_err(|source| FileError::io(root, source))? {
        let path = entry.map_err(|source| FileError::io(root, source))?.path();
        if path.to_string_lossy().ends_with(GROUND_TRUTH_SUFFIX) {
            found.push(path);
        }
    }
    found.sort();
    match found.len() {
        0 | 1 => Ok(found.pop()),
        _ => Err(FileError::content(root, format!("there is more than one file *{GROUND_TRUTH_SUFFIX}"))),
    }
}

fn mirrored_trajectory(path: &Path) -> Result<Trajectory, FileError> {
    let in_renderer_frame = Trajectory::read_as(path, Some(TimeUnit::Seconds))?.trajectory;
    let poses = in_renderer_frame.poses().iter().map(|pose| StampedPose {
        // Written as seconds, the numbers of frames were read as such.
        timestamp_ns: pose.timestamp_ns / FRAMES_PER_SECOND,
        world_from_camera: mirrored(&pose.world_from_camera),
    });
    Ok(Trajectory::new(poses.collect()))
}

/// `(S R S, S t)` with `S = diag(1, -1, 1)`.
fn mirrored(pose: &Pose) -> Pose {
    let (q, t) = (pose.rotation.coords, pose.translation);
    Pose::new(
        UnitQuaternion::from_quaternion(Quaternion::new(q.w, -q.x, q.y, -q.z)),
        Vector3::new(t.x, -t.y, t.z),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::Matrix3;

    #[test]
    fn mirroring_is_conjugation_by_the_mirror() {
        let s = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        let pose = Pose::new(rotation, Vector3::new(1.0, 2.0, 3.0));
        let result = mirrored(&pose);
        let expected = s * pose.rotation_matrix() * s;
        assert!((result.rotation_matrix() - expected).norm() < 1e-12);
        assert_eq!(result.translation, Vector3::new(1.0, -2.0, 3.0));
    }
}
