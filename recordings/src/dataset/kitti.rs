//! KITTI odometry [Geiger et al., CVPR 2012]: `image_0/000000.png…` (the left gray
//! camera; 1 the right, 2 and 3 the color cameras), `times.txt`, `calib.txt`, and the true
//! poses in `poses.txt` or, as published, in `../../poses/NN.txt` for the sequence in the folder `NN`.

use std::path::{Path, PathBuf};

use geometry::nalgebra::{Matrix3, UnitQuaternion, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose};

use super::options::Reading;
use super::{Content, FrameFile, image_size, listing};
use crate::Trajectory;
use crate::calibration::checked_camera;
use crate::files::{FileError, Line, TextFile};

/// The cameras, by the folders of their images.
const CAMERAS: [&str; 4] = ["image_0", "image_1", "image_2", "image_3"];
const TIMES: &str = "times.txt";
const CALIBRATION: &str = "calib.txt";

/// Endings of the images: as published, and as people save space.
const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

pub(super) fn is_recording(root: &Path) -> bool {
    camera_idx(root).is_some() && root.join(TIMES).is_file()
}

/// The first camera whose images are there.
fn camera_idx(root: &Path) -> Option<usize> {
    CAMERAS.iter().position(|images| root.join(images).is_dir())
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let camera_idx = camera_idx(root).ok_or_else(|| {
        FileError::content(
            root,
            format!("there is none of the folders {} beside {TIMES}", CAMERAS.join(", ")),
        )
    })?;
    let (frames, times_ns) = read_frames(root, CAMERAS[camera_idx], reading)?;
    let first = frames.first().ok_or_else(|| FileError::content(&root.join(TIMES), "there are no times"))?;
    let size = image_size(&first.path)?;
    let calibration = root.join(CALIBRATION);
    let projection = || Projection::read(&calibration, camera_idx);
    let camera = reading.camera(&frames, || projection()?.camera(size))?;
    let ground_truth = match ground_truth_file(root) {
        Some(path) => {
            let truth = Trajectory::read_kitti(&path, &times_ns)?;
            // The poses are those of the left gray camera.
            let is_left_gray = camera_idx == 0;
            Some(if is_left_gray { truth } else { truth.compose(&projection()?.gray_from_camera()) })
        }
        None => None,
    };
    Ok(Content { camera, frames, ground_truth })
}

/// The frames, and the times of all lines: truth has a line for each.
fn read_frames(
    root: &Path,
    images: &str,
    reading: &Reading<'_>,
) -> Result<(Vec<FrameFile>, Vec<i64>), FileError> {
    let times = TextFile::read(&root.join(TIMES))?;
    let (mut frames, mut timestamps_ns) = (Vec::new(), Vec::new());
    for (frame_idx, line) in times.lines().enumerate() {
        let timestamp_ns = line.seconds_ns(line.text)?;
        timestamps_ns.push(timestamp_ns);
        match image_of(root, images, frame_idx, &line) {
            Ok(path) => frames.push((line, FrameFile { timestamp_ns, path })),
            Err(error) => reading.bad_line(error)?,
        }
    }
    Ok((listing::in_order(frames, reading)?, timestamps_ns))
}

fn image_of(root: &Path, images: &str, frame_idx: usize, line: &Line<'_>) -> Result<PathBuf, FileError> {
    let named = |ending: &str| root.join(images).join(format!("{frame_idx:06}.{ending}"));
    match ENDINGS.iter().map(|ending| named(ending)).find(|path| path.is_file()) {
        Some(path) => Ok(path),
        None => listing::existing(line, named(ENDINGS[0])),
    }
}

/// What `calib.txt` says of a camera: a 3x4 projection matrix in rows; the images are rectified.
struct Projection {
    path: PathBuf,
    matrix: [f64; 12],
}

impl Projection {
    fn read(path: &Path, camera_idx: usize) -> Result<Self, FileError> {
        let file = TextFile::read(path)?;
        let name = format!("P{camera_idx}:");
        let row = file.lines().find_map(|line| Some((line, line.text.strip_prefix(name.as_str())?)));
        let (line, numbers) = row.ok_or_else(|| file.error(format!("there is no line `{name}`")))?;
        let matrix = line.numbers(&numbers.split_whitespace().collect::<Vec<_>>())?;
        Ok(Self { path: path.to_owned(), matrix })
    }

    fn camera(&self, (width, height): (u32, u32)) -> Result<Camera, FileError> {
        let p = &self.matrix;
        let (fx, fy, cx, cy) = (p[0], p[5], p[2], p[6]);
        let model = CameraModel::Pinhole;
        let parameters = CameraParameters { model, width, height, fx, fy, cx, cy, distortion: Vec::new() };
        checked_camera(&self.path, parameters)
    }

    /// Where the camera is, seen from the left gray one: `P = K [I | t]`.
    fn gray_from_camera(&self) -> Pose {
        let p = &self.matrix;
        let k = Matrix3::new(p[0], p[1], p[2], p[4], p[5], p[6], p[8], p[9], p[10]);
        let t =
            k.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * Vector3::new(p[3], p[7], p[11]));
        Pose::new(UnitQuaternion::identity(), -t)
    }
}

fn ground_truth_file(root: &Path) -> Option<PathBuf> {
    let published = || {
        let sequence = root.file_name()?.to_str()?;
        Some(root.parent()?.parent()?.join("poses").join(format!("{sequence}.txt")))
    };
    [Some(root.join("poses.txt")), published()].into_iter().flatten().find(|path| path.is_file())
}
