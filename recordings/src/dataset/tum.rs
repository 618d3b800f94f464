//! TUM RGB-D [Sturm et al., IROS 2012]: `rgb.txt`, `groundtruth.txt`, and no calibration file.

use std::path::Path;

use geometry::{CameraModel, CameraParameters};

use super::options::Reading;
use super::{Content, folder, listing};
use crate::calibration::checked_camera;
use crate::files::{FileError, TextFile};

const LIST: &str = folder::LIST;

/// The calibrations of the color images published with the data set: `fx fy cx cy`, then `k1 k2 p1 p2 k3`.
/// The images of Freiburg 3 are published undistorted.
const CALIBRATIONS: [(&str, [f64; 4], &[f64]); 3] = [
    ("freiburg1", [517.3, 516.5, 318.6, 255.3], &[0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    ("freiburg2", [520.9, 521.0, 325.1, 249.7], &[0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
    ("freiburg3", [535.4, 539.2, 320.1, 247.6], &[]),
];

pub(super) fn is_recording(root: &Path) -> bool {
    root.join(LIST).is_file() && calibration(root).is_some()
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let list = root.join(LIST);
    let frames = listing::read(root, &list, reading)?;
    let camera = reading.camera(&frames, || match calibration(root) {
        Some(parameters) => checked_camera(&list, parameters),
        None => Err(FileError::content(
            root,
            "neither the folder's name nor the comments of rgb.txt say freiburg1, freiburg2 or freiburg3",
        )),
    })?;
    Ok(Content { camera, frames, ground_truth: folder::ground_truth(root)? })
}

/// The calibration of the camera named by the folder, or by the comments with which `rgb.txt` begins.
fn calibration(root: &Path) -> Option<CameraParameters> {
    let folder_name = root.file_name()?.to_string_lossy().to_lowercase();
    let comments = || {
        let file = TextFile::read(&root.join(LIST)).ok()?;
        Some(file.text().lines().take_while(|line| line.starts_with('#')).collect::<String>().to_lowercase())
    };
    let of = |text: &str| CALIBRATIONS.iter().find(|(name, ..)| text.contains(name));
    let (_, [fx, fy, cx, cy], distortion) = of(&folder_name).or_else(|| of(&comments()?))?;
    let model = if distortion.is_empty() { CameraModel::Pinhole } else { CameraModel::Radtan };
    Some(CameraParameters {
        model,
        width: 640,
        height: 480,
        fx: *fx,
        fy: *fy,
        cx: *cx,
        cy: *cy,
        distortion: distortion.to_vec(),
    })
}
