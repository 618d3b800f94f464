//! Calibrations in YAML: EuRoC's `sensor.yaml`, Kalibr's camchain, the files of OpenCV and ROS.

use std::path::Path;

use geometry::nalgebra::{Matrix3, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose};

use super::checked_camera;
use crate::files::{FileError, TextFile};
use crate::trajectory::pose_of_matrix;
use crate::yaml::{Node, Yaml};

/// Kalibr's models with spheres: what comes before the focal lengths in `intrinsics` is theirs.
const SPHERES: [&str; 3] = ["ds", "eucm", "omni"];
/// What the model without a sphere is called.
const PINHOLES: [&str; 3] = ["pinhole", "perspective", "opencv"];

/// A camera and, where the file has it, its place on the body whose poses are the truth.
pub(crate) struct Rig {
    pub camera: Camera,
    pub body_from_camera: Option<Pose>,
}

/// Reads a file in YAML.
pub(crate) fn read_rig(path: &Path) -> Result<Rig, FileError> {
    rig(path, &TextFile::read(path)?)
}

pub(super) fn rig(path: &Path, file: &TextFile) -> Result<Rig, FileError> {
    let yaml = Yaml::parse(path, file)?;
    // A camchain has its cameras under their names.
    let camera = yaml.root().get(&["cam0"]).unwrap_or(yaml.root());
    let reader = Reader { path, yaml: &yaml, camera };
    Ok(Rig { camera: reader.camera()?, body_from_camera: reader.body_from_camera()? })
}

struct Reader<'a> {
    path: &'a Path,
    yaml: &'a Yaml,
    camera: &'a Node,
}

impl Reader<'_> {
    fn camera(&self) -> Result<Camera, FileError> {
        let (width, height) = self.size()?;
        let distortion = self.distortion()?;
        match self.word(&["camera_model"]) {
            Some((model, node)) if SPHERES.contains(&model.as_str()) => {
                return self.sphere(&model, node, (width, height), &distortion);
            }
            Some((model, node)) if !PINHOLES.contains(&model.as_str()) => {
                return Err(self.unsupported("camera_model", &model, node));
            }
            _ => {}
        }
        let [fx, fy, cx, cy] = self.intrinsics()?;
        let model = self.model(&distortion)?;
        let distortion = if model == CameraModel::Pinhole { Vec::new() } else { distortion };
        checked_camera(self.path, CameraParameters { model, width, height, fx, fy, cx, cy, distortion })
    }

    /// `ds` (`ξ α`), `eucm` (`α β`) or `omni` (`ξ`), followed by focal lengths and principal point.
    fn sphere(
        &self,
        name: &str,
        node: &Node,
        (width, height): (u32, u32),
        distortion: &[f64],
    ) -> Result<Camera, FileError> {
        if distortion.iter().any(|k| *k != 0.0) {
            let message = format!(
                "camera_model `{name}` with a distortion beside it is not supported: calibrate with ds, eucm or \
                 equidistant distortion"
            );
            return Err(self.yaml.error(node, message));
        }
        let (numbers, node) = self.numbers(&["intrinsics"])?.ok_or_else(|| self.missing("intrinsics"))?;
        let (model, lens, pinhole) = match (name, &numbers[..]) {
            ("ds", [xi, alpha, pinhole @ ..]) => (CameraModel::DoubleSphere, vec![*xi, *alpha], pinhole),
            ("eucm", [alpha, beta, pinhole @ ..]) => {
                (CameraModel::ExtendedUnified, vec![*alpha, *beta], pinhole)
            }
            // Mei's ξ, whose focal lengths are 1 + ξ times as long.
            ("omni", [xi, pinhole @ ..]) => {
                (CameraModel::ExtendedUnified, vec![xi / (1.0 + xi), 1.0], pinhole)
            }
            _ => (CameraModel::Pinhole, Vec::new(), &[][..]),
        };
        let [fx, fy, cx, cy] = *pinhole else {
            let message = format!("`intrinsics` of the model {name} cannot have {} numbers", numbers.len());
            return Err(self.yaml.error(node, message));
        };
        let by = if name == "omni" { 1.0 + numbers[0] } else { 1.0 };
        let (fx, fy, distortion) = (fx / by, fy / by, lens);
        checked_camera(self.path, CameraParameters { model, width, height, fx, fy, cx, cy, distortion })
    }

    fn word(&self, names: &[&str]) -> Option<(String, &Node)> {
        let node = self.camera.get(names)?;
        Some((node.word()?.to_lowercase(), node))
    }

    fn numbers(&self, names: &[&str]) -> Result<Option<(Vec<f64>, &Node)>, FileError> {
        let Some(node) = self.camera.get(names) else { return Ok(None) };
        Ok(Some((self.yaml.numbers(names[0], node)?, node)))
    }

    fn missing(&self, name: &str) -> FileError {
        self.yaml.error(self.camera, format!("there is no `{name}:`"))
    }

    fn size(&self) -> Result<(u32, u32), FileError> {
        let side = |length: f64| if length.fract() == 0.0 { length as u32 } else { 0 };
        if let Some((numbers, node)) = self.numbers(&["resolution"])? {
            let [width, height] = numbers[..] else {
                let message = format!("`resolution` must have 2 numbers, not {}", numbers.len());
                return Err(self.yaml.error(node, message));
            };
            return Ok((side(width), side(height)));
        }
        let one = |names: &[&str]| match self.numbers(names)? {
            Some((numbers, _)) => Ok(numbers.first().map(|length| side(*length))),
            None => Ok(None),
        };
        let width = one(&["image_width", "image_Width", "width"])?;
        let height = one(&["image_height", "image_Height", "height"])?;
        width.zip(height).ok_or_else(|| self.missing("resolution"))
    }

    /// `fu, fv, cu, cv`, of a list or of the matrix.
    fn intrinsics(&self) -> Result<[f64; 4], FileError> {
        if let Some((numbers, node)) = self.numbers(&["intrinsics"])? {
            return numbers.clone().try_into().map_err(|_| {
                let message = format!("`intrinsics` must have 4 numbers, not {}", numbers.len());
                self.yaml.error(node, message)
            });
        }
        let matrix = ["camera_matrix", "cameraMatrix", "camera_Matrix", "Camera_Matrix", "K"];
        match self.numbers(&matrix)? {
            Some((k, _)) if k.len() == 9 => Ok([k[0], k[4], k[2], k[5]]),
            Some((k, node)) => Err(self
                .yaml
                .error(node, format!("the camera's matrix must have 9 numbers, not {}", k.len()))),
            None => Err(self.missing("intrinsics")),
        }
    }

    fn distortion(&self) -> Result<Vec<f64>, FileError> {
        let names = [
            "distortion_coefficients",
            "distortion_coeffs",
            "dist_coeffs",
            "distCoeffs",
            "Distortion_Coefficients",
            "D",
        ];
        Ok(self.numbers(&names)?.map_or_else(Vec::new, |(numbers, _)| numbers))
    }

    fn model(&self, distortion: &[f64]) -> Result<CameraModel, FileError> {
        if distortion.iter().all(|k| *k == 0.0) {
            return Ok(CameraModel::Pinhole);
        }
        // OpenCV's files do not name the model; its fisheye is told by hand.
        let Some((model, node)) = self.word(&["distortion_model"]) else { return Ok(CameraModel::Radtan) };
        match model.as_str() {
            "radial-tangential" | "radtan" | "plumb_bob" | "rational_polynomial" => Ok(CameraModel::Radtan),
            "equidistant" | "fisheye" | "kannala-brandt" | "kannala_brandt" => Ok(CameraModel::KannalaBrandt),
            "fov" => Ok(CameraModel::Fov),
            other => Err(self.unsupported("distortion_model", other, node)),
        }
    }

    fn unsupported(&self, name: &str, model: &str, node: &Node) -> FileError {
        let message = format!(
            "{name} `{model}` is not supported: calibrate with radial-tangential, equidistant or fov distortion \
             of a pinhole, or with ds or eucm"
        );
        self.yaml.error(node, message)
    }

    /// `T_BS`, or the inverse of Kalibr's `T_cam_imu`.
    fn body_from_camera(&self) -> Result<Option<Pose>, FileError> {
        if let Some((m, node)) = self.numbers(&["T_BS", "T_imu_cam"])? {
            return self.rigid("T_BS", &m, node).map(Some);
        }
        match self.numbers(&["T_cam_imu"])? {
            Some((m, node)) => Ok(Some(self.rigid("T_cam_imu", &m, node)?.inverse())),
            None => Ok(None),
        }
    }

    fn rigid(&self, name: &str, m: &[f64], node: &Node) -> Result<Pose, FileError> {
        let pose = (m.len() == 16).then(|| {
            let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
            pose_of_matrix(&rotation, Vector3::new(m[3], m[7], m[11]))
        });
        pose.flatten().ok_or_else(|| self.yaml.error(node, format!("{name} is not a rigid motion")))
    }
}
