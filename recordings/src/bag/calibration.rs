//! The calibration in a message `CameraInfo`.

use geometry::{Camera, CameraModel, CameraParameters};

use super::container::RosMessage;
use super::fields::{Fields, header_time_ns};

/// Most coefficients of distortion that a model has.
const MAX_COEFFICIENTS: usize = 16;

/// The camera of a message, or why there is none. Images that are rectified, as the topic's name says, have
/// the projection's pinhole and no distortion.
pub(super) fn decode(message: &RosMessage, is_rectified: bool) -> Result<Camera, String> {
    let mut fields = Fields::of(&message.data, message.encoding);
    header_time_ns(&mut fields)?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    let name = fields.text()?;
    let distortion = fields.numbers(MAX_COEFFICIENTS)?;
    let intrinsics = numbers::<9>(&mut fields)?;
    // The rotation that rectifies.
    numbers::<9>(&mut fields)?;
    let projection = numbers::<12>(&mut fields)?;
    let is_straight = is_rectified || distortion.iter().all(|k| *k == 0.0);
    let [fx, fy, cx, cy] = if is_rectified {
        [projection[0], projection[5], projection[2], projection[6]]
    } else {
        [intrinsics[0], intrinsics[4], intrinsics[2], intrinsics[5]]
    };
    if fx == 0.0 {
        return Err("it is not calibrated, its focal length is zero".to_owned());
    }
    let model = match name {
        _ if is_straight => CameraModel::Pinhole,
        "plumb_bob" | "rational_polynomial" => CameraModel::Radtan,
        "equidistant" | "fisheye" => CameraModel::KannalaBrandt,
        "fov" => CameraModel::Fov,
        "eucm" => CameraModel::ExtendedUnified,
        "ds" => CameraModel::DoubleSphere,
        other => return Err(format!("its distortion model `{other}` is not supported")),
    };
    let distortion = if is_straight { Vec::new() } else { distortion };
    let parameters = CameraParameters { model, width, height, fx, fy, cx, cy, distortion };
    Camera::new(parameters).map_err(|refused| refused.message)
}

fn numbers<const N: usize>(fields: &mut Fields<'_>) -> Result<[f64; N], String> {
    let mut numbers = [0.0; N];
    for number in &mut numbers {
        *number = fields.f64()?;
    }
    Ok(numbers)
}
