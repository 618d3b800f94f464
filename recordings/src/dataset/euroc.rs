//! EuRoC, or ASL [Burri et al., IJRR 2016]: `mav0/cam0/{data.csv, sensor.yaml, data/}` and the true poses of
//! the body in `mav0/state_groundtruth_estimate0/data.csv`. TUM-VI keeps them in `mav0/mocap0/data.csv`, and
//! the calibration in `dso/camchain.yaml`.

use std::path::{Path, PathBuf};

use super::options::Reading;
use super::{CALIBRATION, Content, listing};
use crate::Trajectory;
use crate::calibration::{Rig, read_calibration, read_rig};
use crate::files::FileError;
use crate::units::TimeUnit;

/// Folders with the true poses of the body, the better first.
const GROUND_TRUTHS: [&str; 2] = ["state_groundtruth_estimate0", "mocap0"];

/// Where the calibration may be, seen from the vehicle's folder.
const CALIBRATIONS: [&str; 6] = [
    "cam0/sensor.yaml",
    "cam0/camchain.yaml",
    "camchain.yaml",
    "../camchain.yaml",
    "../dso/camchain.yaml",
    "../../dso/camchain.yaml",
];

pub(super) fn is_recording(root: &Path) -> bool {
    vehicle_folder(root).is_some()
}

pub(super) fn read(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let vehicle =
        vehicle_folder(root).ok_or_else(|| FileError::content(root, "there is no mav0/cam0/data.csv"))?;
    let list = vehicle.join("cam0/data.csv");
    let unit = Some(TimeUnit::Nanoseconds);
    let frames = listing::read_in(&vehicle.join("cam0/data"), &list, unit, reading)?;
    let mut body_from_camera = None;
    let camera = reading.camera(&frames, || {
        let rig = read_vehicle(root, &vehicle)?;
        body_from_camera = rig.body_from_camera;
        Ok(rig.camera)
    })?;
    let truth = GROUND_TRUTHS.iter().map(|name| vehicle.join(name).join("data.csv")).find(|p| p.is_file());
    let ground_truth = match (truth, body_from_camera) {
        (Some(path), Some(body_from_camera)) => {
            let read = Trajectory::read_as(&path, unit)?;
            read.remarks(&path).into_iter().for_each(|remark| reading.remark(remark));
            Some(read.trajectory.compose(&body_from_camera))
        }
        (Some(path), None) => {
            let message =
                "it is not used: the calibration does not say where the camera is on the body (T_BS)";
            reading.remark(FileError::content(&path, message).to_string());
            None
        }
        (None, _) => None,
    };
    Ok(Content { camera, frames, ground_truth })
}

/// The calibration, wherever it is.
fn read_vehicle(root: &Path, vehicle: &Path) -> Result<Rig, FileError> {
    let places = CALIBRATIONS.map(|place| vehicle.join(place));
    if let Some(path) = places.iter().find(|path| path.is_file()) {
        return read_rig(path);
    }
    let given = [root, vehicle].map(|place| place.join(CALIBRATION)).into_iter().find(|path| path.is_file());
    match given {
        Some(path) => Ok(Rig { camera: read_calibration(&path)?, body_from_camera: None }),
        None => {
            let message = "there is no such file, nor a camchain.yaml of Kalibr: the camera is not known";
            Err(FileError::content(&places[0], message))
        }
    }
}

/// The folder of the vehicle: `mav0` in `root`, or `root` itself.
fn vehicle_folder(root: &Path) -> Option<PathBuf> {
    [root.join("mav0"), root.to_owned()].into_iter().find(|folder| folder.join("cam0/data.csv").is_file())
}
