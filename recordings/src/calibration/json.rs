//! `calib.json`: one object with `model` (`pinhole`, `radtan`, `kannala-brandt`, `fov`, `eucm`,
//! `double-sphere`), `width`, `height`,
//! `fx`, `fy`, `cx`, `cy`, and the coefficients as `dist`.

use std::path::Path;

use geometry::{Camera, CameraModel, CameraParameters};
use serde::Deserialize;

use super::{basalt, checked_camera};
use crate::files::{FileError, TextFile};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Calibration {
    model: Option<Model>,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default, alias = "distortion")]
    dist: Vec<f64>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Model {
    Pinhole,
    #[serde(alias = "radial-tangential", alias = "brown-conrady", alias = "plumb_bob", alias = "opencv")]
    Radtan,
    #[serde(alias = "equidistant", alias = "kannala_brandt", alias = "opencv_fisheye")]
    KannalaBrandt,
    Fov,
    #[serde(alias = "extended-unified")]
    Eucm,
    /// The unified model, with one coefficient.
    #[serde(alias = "unified")]
    Ucm,
    #[serde(alias = "ds", alias = "double_sphere")]
    DoubleSphere,
}

pub(super) fn read(path: &Path, file: &TextFile) -> Result<Camera, FileError> {
    if let Some(camera) = basalt::read(path, file)? {
        return Ok(camera);
    }
    let calibration: Calibration = serde_json::from_str(file.text()).map_err(|e| FileError::Line {
        path: path.to_owned(),
        line: e.line(),
        message: e.to_string(),
    })?;
    let is_straight = calibration.dist.iter().all(|k| *k == 0.0);
    let model = match calibration.model {
        None | Some(Model::Pinhole) if is_straight => CameraModel::Pinhole,
        None => {
            let message = "`dist` has coefficients, but `model` does not say whose: \"radtan\" (OpenCV's \
                           calibrateCamera) or \"kannala-brandt\" (its fisheye)";
            return Err(FileError::content(path, message));
        }
        Some(Model::Pinhole) => CameraModel::Pinhole,
        Some(Model::Radtan) if is_straight => CameraModel::Pinhole,
        Some(Model::Radtan) => CameraModel::Radtan,
        Some(Model::KannalaBrandt) => CameraModel::KannalaBrandt,
        Some(Model::Fov) => CameraModel::Fov,
        Some(Model::Eucm | Model::Ucm) => CameraModel::ExtendedUnified,
        Some(Model::DoubleSphere) => CameraModel::DoubleSphere,
    };
    let Calibration { width, height, fx, fy, cx, cy, dist, .. } = calibration;
    let distortion = match calibration.model {
        _ if model == CameraModel::Pinhole && is_straight => Vec::new(),
        Some(Model::Ucm) if dist.len() == 1 => vec![dist[0], 1.0],
        _ => dist,
    };
    checked_camera(path, CameraParameters { model, width, height, fx, fy, cx, cy, distortion })
}
