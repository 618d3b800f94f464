//! `rgb.txt` with `calib.json`, and `groundtruth.txt` if there is one.
//!
//! `calib.json` is one object: `model` (`pinhole`, `radtan`, `kannala-brandt`, `fov`), `width`, `height`,
//! `fx`, `fy`, `cx`, `cy`, and the coefficients as `dist`.

use std::path::Path;

use geometry::{Camera, CameraModel, CameraParameters};
use serde::Deserialize;

use super::{Content, checked_camera, listing};
use crate::Trajectory;
use crate::files::{FileError, TextFile};

const LIST: &str = "rgb.txt";
const CALIBRATION: &str = "calib.json";
const GROUND_TRUTH: &str = "groundtruth.txt";

pub(super) fn is_recording(root: &Path) -> bool {
    root.join(LIST).is_file() && root.join(CALIBRATION).is_file()
}

pub(super) fn read(root: &Path) -> Result<Content, FileError> {
    Ok(Content {
        camera: read_calibration(&root.join(CALIBRATION))?,
        frames: listing::read(root, &root.join(LIST))?,
        ground_truth: ground_truth(root)?,
    })
}

/// The trajectory in `groundtruth.txt`, if there is such a file.
pub(super) fn ground_truth(root: &Path) -> Result<Option<Trajectory>, FileError> {
    let path = root.join(GROUND_TRUTH);
    if path.is_file() { Trajectory::read(&path).map(Some) } else { Ok(None) }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Calibration {
    #[serde(default)]
    model: Model,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default, alias = "distortion")]
    dist: Vec<f64>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Model {
    #[default]
    Pinhole,
    #[serde(alias = "radial-tangential", alias = "brown-conrady")]
    Radtan,
    #[serde(alias = "equidistant", alias = "kannala_brandt")]
    KannalaBrandt,
    Fov,
}

/// Reads a file `calib.json`: the camera as one JSON object.
///
/// # Errors
/// A [`FileError`] that names what is wrong with it.
pub fn read_calibration(path: &Path) -> Result<Camera, FileError> {
    let file = TextFile::read(path)?;
    let calibration: Calibration = serde_json::from_str(file.text()).map_err(|e| FileError::Line {
        path: path.to_owned(),
        line: e.line(),
        message: e.to_string(),
    })?;
    let model = match calibration.model {
        Model::Pinhole => CameraModel::Pinhole,
        Model::Radtan => CameraModel::Radtan,
        Model::KannalaBrandt => CameraModel::KannalaBrandt,
        Model::Fov => CameraModel::Fov,
    };
    let Calibration { width, height, fx, fy, cx, cy, dist, .. } = calibration;
    checked_camera(path, CameraParameters { model, width, height, fx, fy, cx, cy, distortion: dist })
}
