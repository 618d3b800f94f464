//! KITTI odometry [Geiger et al., CVPR 2012]: `image_0/000000.png…`, `times.txt`, `calib.txt`, and the true
//! poses in `poses.txt` or, as published, in `../../poses/NN.txt` for the sequence in the folder `NN`.

use std::path::{Path, PathBuf};

use geometry::{Camera, CameraModel, CameraParameters};

use super::{Content, FrameFile, checked_camera, image_size, listing};
use crate::Trajectory;
use crate::files::{FileError, TextFile};

const IMAGES: &str = "image_0";
const TIMES: &str = "times.txt";
const CALIBRATION: &str = "calib.txt";

pub(super) fn is_recording(root: &Path) -> bool {
    root.join(IMAGES).is_dir() && root.join(TIMES).is_file()
}

pub(super) fn read(root: &Path) -> Result<Content, FileError> {
    let frames = read_frames(root)?;
    let first = frames.first().ok_or_else(|| FileError::content(&root.join(TIMES), "there are no times"))?;
    let camera = read_calibration(&root.join(CALIBRATION), image_size(&first.path)?)?;
    let timestamps_ns: Vec<i64> = frames.iter().map(|frame| frame.timestamp_ns).collect();
    let ground_truth = match ground_truth_file(root) {
        Some(path) => Some(Trajectory::read_kitti(&path, &timestamps_ns)?),
        None => None,
    };
    Ok(Content { camera, frames, ground_truth })
}

fn read_frames(root: &Path) -> Result<Vec<FrameFile>, FileError> {
    let times = TextFile::read(&root.join(TIMES))?;
    let mut frames: Vec<FrameFile> = Vec::new();
    for (frame_idx, line) in times.lines().enumerate() {
        let timestamp_ns = line.seconds_ns(line.text)?;
        listing::check_order(&line, frames.last(), timestamp_ns)?;
        let path = root.join(IMAGES).join(format!("{frame_idx:06}.png"));
        frames.push(FrameFile { timestamp_ns, path: listing::existing(&line, path)? });
    }
    Ok(frames)
}

/// The left gray camera is `P0`, a 3x4 projection matrix in rows; the images are rectified.
fn read_calibration(path: &Path, (width, height): (u32, u32)) -> Result<Camera, FileError> {
    let file = TextFile::read(path)?;
    let row = file.lines().find_map(|line| Some((line, line.text.strip_prefix("P0:")?)));
    let (line, numbers) = row.ok_or_else(|| file.error("there is no line `P0:`"))?;
    let p: [f64; 12] = line.numbers(&numbers.split_whitespace().collect::<Vec<_>>())?;
    let parameters = CameraParameters {
        model: CameraModel::Pinhole,
        width,
        height,
        fx: p[0],
        fy: p[5],
        cx: p[2],
        cy: p[6],
        distortion: Vec::new(),
    };
    checked_camera(path, parameters)
}

fn ground_truth_file(root: &Path) -> Option<PathBuf> {
    let published = || {
        let sequence = root.file_name()?.to_str()?;
        Some(root.parent()?.parent()?.join("poses").join(format!("{sequence}.txt")))
    };
    [Some(root.join("poses.txt")), published()].into_iter().flatten().find(|path| path.is_file())
}
