//! Between the messages of the contract and the domain's types.

use geometry::{CameraModel, CameraParameters};
use proto::v1;

/// A calibration as it is sent.
pub fn camera_message(camera: &CameraParameters) -> v1::Camera {
    let model = match camera.model {
        CameraModel::Pinhole => v1::CameraModel::Pinhole,
        CameraModel::Radtan => v1::CameraModel::Radtan,
        CameraModel::KannalaBrandt => v1::CameraModel::KannalaBrandt,
        CameraModel::Fov => v1::CameraModel::Fov,
        CameraModel::ExtendedUnified => v1::CameraModel::ExtendedUnified,
        CameraModel::DoubleSphere => v1::CameraModel::DoubleSphere,
    };
    let CameraParameters { width, height, fx, fy, cx, cy, ref distortion, .. } = *camera;
    v1::Camera { model: model.into(), width, height, fx, fy, cx, cy, distortion: distortion.clone() }
}
