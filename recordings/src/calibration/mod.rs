//! Calibrations as programs write them: our `calib.json`, `sensor.yaml` of EuRoC, camchains of Kalibr,
//! matrices of OpenCV and ROS, `cameras.txt` of COLMAP, calibrations of Basalt.

mod basalt;
mod colmap;
mod json;
mod yaml;

use std::path::Path;

use geometry::{Camera, CameraParameters};

use crate::files::{FileError, TextFile};

pub(crate) use yaml::{Rig, read_rig};

/// Reads the calibration of a camera, told by what is in the file: JSON like `calib.json`, YAML of EuRoC,
/// Kalibr, OpenCV or ROS, or COLMAP's `cameras.txt`.
///
/// # Errors
/// A [`FileError`] that names what is wrong with it.
pub fn read_calibration(path: &Path) -> Result<Camera, FileError> {
    let file = TextFile::read(path)?;
    let is_yaml = path
        .extension()
        .is_some_and(|ending| ["yaml", "yml"].iter().any(|yaml| ending.eq_ignore_ascii_case(yaml)));
    if is_yaml || file.text().starts_with("%YAML") {
        return Ok(yaml::rig(path, &file)?.camera);
    }
    match file.lines().next() {
        Some(line) if colmap::is_camera(&line) => colmap::read(path, &file),
        _ => json::read(path, &file),
    }
}

/// Checks a calibration that was read from `path`.
pub(crate) fn checked_camera(path: &Path, parameters: CameraParameters) -> Result<Camera, FileError> {
    Camera::new(parameters).map_err(|refused| FileError::content(path, refused.message))
}
