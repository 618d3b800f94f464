//! `cameras.txt` of COLMAP: `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]` on each line.
//!
//! Its pixels have their centers at halves, ours at integers.

use std::path::Path;

use geometry::{Camera, CameraModel, CameraParameters};

use super::checked_camera;
use crate::files::{FileError, Line, TextFile};

/// Names of the models, numbers of parameters, and whether there is one focal length for both directions.
const MODELS: [(&str, CameraModel, usize, bool); 9] = [
    ("SIMPLE_PINHOLE", CameraModel::Pinhole, 3, true),
    ("PINHOLE", CameraModel::Pinhole, 4, false),
    ("SIMPLE_RADIAL", CameraModel::Radtan, 4, true),
    ("RADIAL", CameraModel::Radtan, 5, true),
    ("OPENCV", CameraModel::Radtan, 8, false),
    ("FULL_OPENCV", CameraModel::Radtan, 12, false),
    ("OPENCV_FISHEYE", CameraModel::KannalaBrandt, 8, false),
    ("RADIAL_FISHEYE", CameraModel::KannalaBrandt, 5, true),
    ("FOV", CameraModel::Fov, 5, false),
];

/// Whether a line is a camera.
pub(super) fn is_camera(line: &Line<'_>) -> bool {
    let words = line.words();
    words.len() >= 7
        && words[0].parse::<u64>().is_ok()
        && words[1].bytes().all(|c| c.is_ascii_uppercase() || c == b'_')
        && words[2..].iter().all(|word| word.parse::<f64>().is_ok())
}

pub(super) fn read(path: &Path, file: &TextFile) -> Result<Camera, FileError> {
    let mut cameras = file.lines();
    let line = cameras.next().ok_or_else(|| file.error("there is no camera in it"))?;
    if let Some(second) = cameras.next() {
        return Err(second.error("there is a second camera; keep the line of the one that is meant"));
    }
    let words = line.words();
    let found = MODELS.iter().find(|(name, ..)| *name == words[1]);
    let Some((name, model, n_parameters, is_square)) = found else {
        let names = MODELS.map(|(name, ..)| name).join(", ");
        return Err(line.error(format!("the model {} is not supported: {names} are", words[1])));
    };
    let side = |word: &str| word.parse().map_err(|_| line.error(format!("`{word}` is no image's side")));
    let (width, height) = (side(words[2])?, side(words[3])?);
    let mut parameters = Vec::new();
    for word in &words[4..] {
        parameters.push(line.numbers::<1>(&[word])?[0]);
    }
    if parameters.len() != *n_parameters {
        return Err(line.error(format!("{name} has {n_parameters} parameters, not {}", parameters.len())));
    }
    if *is_square {
        parameters.insert(1, parameters[0]);
    }
    let mut distortion = parameters.split_off(4);
    let wanted = model.coefficient_counts().iter().find(|n| **n >= distortion.len());
    distortion.resize(*wanted.unwrap_or(&distortion.len()), 0.0);
    let [fx, fy, cx, cy] = [parameters[0], parameters[1], parameters[2] - 0.5, parameters[3] - 0.5];
    checked_camera(path, CameraParameters { model: *model, width, height, fx, fy, cx, cy, distortion })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(text: &str) -> Result<CameraParameters, String> {
        let path = Path::new("cameras.txt");
        read(path, &TextFile::from_text(path, text))
            .map(|camera| camera.parameters().clone())
            .map_err(|e| e.to_string())
    }

    #[test]
    fn models_become_ours_and_centers_move_by_half_a_pixel() {
        let pinhole = camera("# c\n1 PINHOLE 640 480 500 510 320 240\n").unwrap();
        assert_eq!((pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy), (500.0, 510.0, 319.5, 239.5));
        let radial = camera("1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n").unwrap();
        assert_eq!((radial.fx, radial.fy), (500.0, 500.0));
        assert_eq!(radial.distortion, [0.01, 0.0, 0.0, 0.0]);
        let fisheye = camera("7 OPENCV_FISHEYE 640 480 300 300 320 240 0.01 0 0 0\n").unwrap();
        assert_eq!(fisheye.model, CameraModel::KannalaBrandt);
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let refused = camera("1 THIN_PRISM_FISHEYE 640 480 1 1 1 1 0 0 0 0 0 0 0 0\n").unwrap_err();
        assert!(refused.contains("cameras.txt:1") && refused.contains("THIN_PRISM_FISHEYE"), "{refused}");
        let refused = camera("1 PINHOLE 640 480 500 510 320\n").unwrap_err();
        assert!(refused.contains("4 parameters, not 3"), "{refused}");
        let refused =
            camera("1 PINHOLE 640 480 500 510 320 240\n2 PINHOLE 640 480 500 510 320 240\n").unwrap_err();
        assert!(refused.contains("cameras.txt:2") && refused.contains("second camera"), "{refused}");
    }
}
