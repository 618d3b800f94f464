//! Calibrations of Basalt, as TUM-VI has them: the first camera of `value0`.

use std::path::Path;

use geometry::{Camera, CameraModel, CameraParameters};
use serde_json::Value;

use super::checked_camera;
use crate::files::{FileError, TextFile};

/// Its models with the names of their coefficients, in our order.
const MODELS: [(&str, CameraModel, &[&str]); 6] = [
    ("pinhole", CameraModel::Pinhole, &[]),
    ("pinhole-radtan8", CameraModel::Radtan, &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]),
    ("kb4", CameraModel::KannalaBrandt, &["k1", "k2", "k3", "k4"]),
    ("ds", CameraModel::DoubleSphere, &["xi", "alpha"]),
    ("eucm", CameraModel::ExtendedUnified, &["alpha", "beta"]),
    ("ucm", CameraModel::ExtendedUnified, &["alpha"]),
];

/// The first camera of such a file; `None` of any other.
pub(super) fn read(path: &Path, file: &TextFile) -> Result<Option<Camera>, FileError> {
    let Ok(value) = serde_json::from_str::<Value>(file.text()) else { return Ok(None) };
    let Some(rig) = value.get("value0") else { return Ok(None) };
    let refuse = |message: String| FileError::content(path, message);
    let camera = rig.pointer("/intrinsics/0").ok_or_else(|| refuse("there is no `intrinsics`".into()))?;
    let name = camera.get("camera_type").and_then(Value::as_str).unwrap_or_default();
    let Some((_, model, coefficients)) = MODELS.iter().find(|(known, ..)| *known == name) else {
        let known = MODELS.map(|(name, ..)| name).join(", ");
        return Err(refuse(format!("camera_type `{name}` is not supported: {known}")));
    };
    let number = |name: &str| {
        let value = camera.get("intrinsics").and_then(|numbers| numbers.get(name)).and_then(Value::as_f64);
        value.ok_or_else(|| refuse(format!("the first camera has no number `{name}`")))
    };
    let side = |idx: usize| {
        let length = rig.pointer(&format!("/resolution/0/{idx}")).and_then(Value::as_u64);
        length
            .and_then(|length| u32::try_from(length).ok())
            .ok_or_else(|| refuse("there is no `resolution`".into()))
    };
    let mut distortion = coefficients.iter().map(|name| number(name)).collect::<Result<Vec<f64>, _>>()?;
    if name == "ucm" {
        distortion.push(1.0);
    }
    let parameters = CameraParameters {
        model: *model,
        width: side(0)?,
        height: side(1)?,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
        distortion,
    };
    checked_camera(path, parameters).map(Some)
}

#[cfg(test)]
mod tests {
    use super::super::read_calibration;
    use super::*;

    #[test]
    fn basalts_cameras_are_read_and_others_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("calibration.json");
        let read = |camera: &str| {
            let text = format!(
                r#"{{"value0": {{"T_imu_cam": [], "intrinsics": [{camera}], "resolution": [[512, 512], [512, 512]]}}}}"#
            );
            std::fs::write(&file, text).unwrap();
            read_calibration(&file)
                .map(|camera| camera.parameters().clone())
                .map_err(|error| error.to_string())
        };
        let numbers = r#""fx": 158.28, "fy": 158.27, "cx": 254.97, "cy": 256.35"#;
        let ds =
            format!(r#"{{"camera_type": "ds", "intrinsics": {{{numbers}, "xi": -0.172, "alpha": 0.593}}}}"#);
        let camera = read(&ds).unwrap();
        assert_eq!((camera.model, camera.fx, camera.width), (CameraModel::DoubleSphere, 158.28, 512));
        assert_eq!(camera.distortion, [-0.172, 0.593]);
        let ucm = format!(r#"{{"camera_type": "ucm", "intrinsics": {{{numbers}, "alpha": 0.593}}}}"#);
        assert_eq!(read(&ucm).unwrap().distortion, [0.593, 1.0]);
        assert!(read(&ucm.replace("ucm", "ftheta")).unwrap_err().contains("`ftheta` is not supported"));
        assert!(read(&ds.replace("xi", "psi")).unwrap_err().contains("no number `xi`"));
    }
}
