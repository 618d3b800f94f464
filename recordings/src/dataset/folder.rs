//! `rgb.txt` with `calib.json`, and `groundtruth.txt` if there is one.

use std::path::Path;

use super::options::Reading;
use super::{CALIBRATION, Content, listing};
use crate::Trajectory;
use crate::calibration::read_calibration;
use crate::files::FileError;

/// The list of images.
pub(super) const LIST: &str = "rgb.txt";
const GROUND_TRUTH: &str = "groundtruth.txt";

pub(super) fn is_recording(root: &Path, has_camera: bool) -> bool {
    root.join(LIST).is_file() && (has_camera || root.join(CALIBRATION).is_file())
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let frames = listing::read(root, &root.join(LIST), reading)?;
    let camera = reading.camera(&frames, || read_calibration(&root.join(CALIBRATION)))?;
    Ok(Content { camera, frames, ground_truth: ground_truth(root)? })
}

/// The trajectory in `groundtruth.txt`, if there is such a file.
pub(super) fn ground_truth(root: &Path) -> Result<Option<Trajectory>, FileError> {
    let path = root.join(GROUND_TRUTH);
    if path.is_file() { Trajectory::read(&path).map(Some) } else { Ok(None) }
}
