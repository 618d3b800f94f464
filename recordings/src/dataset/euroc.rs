//! EuRoC, or ASL [Burri et al., IJRR 2016]: `mav0/cam0/{data.csv, sensor.yaml, data/}` and the true poses of
//! the body in `mav0/state_groundtruth_estimate0/data.csv`. TUM-VI keeps them in `mav0/mocap0/data.csv`.

use std::path::{Path, PathBuf};

use geometry::nalgebra::{Matrix3, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose};

use super::{Content, FrameFile, checked_camera, listing};
use crate::Trajectory;
use crate::files::{FileError, TextFile};
use crate::trajectory::pose_of_matrix;

/// Folders with the true poses of the body, the better first.
const GROUND_TRUTHS: [&str; 2] = ["state_groundtruth_estimate0", "mocap0"];

pub(super) fn is_recording(root: &Path) -> bool {
    vehicle_folder(root).is_some()
}

pub(super) fn read(root: &Path) -> Result<Content, FileError> {
    let vehicle =
        vehicle_folder(root).ok_or_else(|| FileError::content(root, "there is no mav0/cam0/data.csv"))?;
    let sensor = Sensor::read(&vehicle.join("cam0/sensor.yaml"))?;
    let ground_truth =
        GROUND_TRUTHS.iter().map(|name| vehicle.join(name).join("data.csv")).find(|p| p.is_file());
    let ground_truth = match ground_truth {
        Some(path) => Some(Trajectory::read(&path)?.compose(&sensor.body_from_camera)),
        None => None,
    };
    Ok(Content { camera: sensor.camera, frames: read_frames(&vehicle.join("cam0"))?, ground_truth })
}

/// The folder of the vehicle: `mav0` in `root`, or `root` itself.
fn vehicle_folder(root: &Path) -> Option<PathBuf> {
    [root.join("mav0"), root.to_owned()].into_iter().find(|folder| folder.join("cam0/data.csv").is_file())
}

fn read_frames(camera_folder: &Path) -> Result<Vec<FrameFile>, FileError> {
    let list = TextFile::read(&camera_folder.join("data.csv"))?;
    let mut frames: Vec<FrameFile> = Vec::new();
    for line in list.lines() {
        let cells = line.cells();
        let [timestamp, name] = cells[..] else {
            return Err(line.error("`timestamp,filename` expected"));
        };
        let timestamp_ns = line.integer_ns(timestamp)?;
        listing::check_order(&line, frames.last(), timestamp_ns)?;
        let path = listing::existing(&line, camera_folder.join("data").join(name))?;
        frames.push(FrameFile { timestamp_ns, path });
    }
    Ok(frames)
}

/// What `sensor.yaml` says of a camera.
struct Sensor {
    camera: Camera,
    /// `T_BS`.
    body_from_camera: Pose,
}

impl Sensor {
    fn read(path: &Path) -> Result<Self, FileError> {
        let yaml = Yaml(TextFile::read(path)?);
        let [width, height] = yaml.list("resolution")?;
        let [fx, fy, cx, cy] = yaml.list("intrinsics")?;
        let distortion = yaml.list_of_any_length("distortion_coefficients")?;
        let model = match yaml.word("distortion_model")? {
            _ if distortion.iter().all(|k| *k == 0.0) => CameraModel::Pinhole,
            "radial-tangential" | "radtan" | "plumb_bob" => CameraModel::Radtan,
            "equidistant" => CameraModel::KannalaBrandt,
            other => return Err(yaml.0.error(format!("distortion_model `{other}` is not supported"))),
        };
        let distortion = if model == CameraModel::Pinhole { Vec::new() } else { distortion };
        let side = |length: f64| if length.fract() == 0.0 { length as u32 } else { 0 };
        let parameters =
            CameraParameters { model, width: side(width), height: side(height), fx, fy, cx, cy, distortion };
        let m: [f64; 16] = yaml.list_after("data", "T_BS")?;
        let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
        let body_from_camera = pose_of_matrix(&rotation, Vector3::new(m[3], m[7], m[11]))
            .ok_or_else(|| yaml.0.error("T_BS is not a rigid motion"))?;
        Ok(Self { camera: checked_camera(path, parameters)?, body_from_camera })
    }
}

/// The little of YAML that the files of the data set use: `key: word` and `key: [number, …]`, a list perhaps
/// over several lines.
struct Yaml(TextFile);

impl Yaml {
    /// What follows `key:`, at the start of a line but for blanks, after the first mention of `section`.
    fn after(&self, key: &str, section: &str) -> Result<&str, FileError> {
        let text = self.0.text();
        let start = if section.is_empty() { 0 } else { self.position(text, section)? };
        let found = self.position(&text[start..], key)?;
        Ok(text[start + found + key.len() + 1..].trim_start_matches([' ', '\t']))
    }

    fn position(&self, text: &str, key: &str) -> Result<usize, FileError> {
        let mut line_start = 0;
        for line in text.split_inclusive('\n') {
            let content = line.trim_start();
            if content.strip_prefix(key).is_some_and(|rest| rest.starts_with(':')) {
                return Ok(line_start + line.len() - content.len());
            }
            line_start += line.len();
        }
        Err(self.0.error(format!("there is no `{key}:`")))
    }

    fn word(&self, key: &str) -> Result<&str, FileError> {
        let line = self.after(key, "")?.lines().next().unwrap_or_default();
        Ok(line.split('#').next().unwrap_or_default().trim().trim_matches(['"', '\'']))
    }

    fn list<const N: usize>(&self, key: &str) -> Result<[f64; N], FileError> {
        self.list_after(key, "")
    }

    fn list_after<const N: usize>(&self, key: &str, section: &str) -> Result<[f64; N], FileError> {
        let numbers = self.numbers(key, section)?;
        let n_found = numbers.len();
        numbers.try_into().map_err(|_| self.0.error(format!("`{key}` must have {N} numbers, not {n_found}")))
    }

    fn list_of_any_length(&self, key: &str) -> Result<Vec<f64>, FileError> {
        self.numbers(key, "")
    }

    fn numbers(&self, key: &str, section: &str) -> Result<Vec<f64>, FileError> {
        let list = self.after(key, section)?.strip_prefix('[').and_then(|rest| rest.split_once(']'));
        let (list, _) = list.ok_or_else(|| self.0.error(format!("`{key}` must be a list in brackets")))?;
        let fields = list.split(',').map(str::trim).filter(|field| !field.is_empty());
        fields
            .map(|field| {
                field
                    .parse()
                    .ok()
                    .filter(|x: &f64| x.is_finite())
                    .ok_or_else(|| self.0.error(format!("`{field}` in `{key}` is not a finite number")))
            })
            .collect()
    }
}
