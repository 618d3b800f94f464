//! `transforms.json`, from which nerfstudio, instant-ngp and programs for Gaussian splats begin.
//!
//! Poses are world_from_camera with the axes of OpenGL: the camera looks along its negative z axis, y is up.
//! Pixels are COLMAP's, whose origin is the corner of the top-left pixel.

use super::Export;
use super::colmap::HALF_PIXEL;
use crate::error::{ApiError, ErrorCode};
use geometry::nalgebra::{Matrix4, Vector4};
use geometry::{CameraModel, CameraParameters, Pose};
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// Where the images of the keyframes are expected, beside the file.
const IMAGES: &str = "images";

/// What the points are expected to be called, beside the file.
const POINTS: &str = "sparse_pc.ply";

pub(super) async fn write(export: &mut Export) -> Result<(), ApiError> {
    let head = Value::Object(camera_fields(&export.camera())?).to_string();
    // The frames follow as the last field.
    let mut text = format!(
        "{},\n\"ply_file_path\":\"{POINTS}\",\n\"frames\":[",
        head.strip_suffix('}').unwrap_or(&head)
    );
    let (mut after, mut separator) = (None, "\n");
    while let Some(records) = export.keyframes_after(&mut after).await? {
        for record in records.iter().filter(|record| record.has_image) {
            let name = export.image_name(record).await?;
            let camera_from_world = export.units.scaled(&record.camera_from_world);
            let mut frame = match export.cameras.of(record.id) {
                // Its fields go before those of the whole.
                Some((_, camera)) => camera_fields(camera)?,
                None => Map::new(),
            };
            frame.insert("file_path".to_owned(), format!("{IMAGES}/{name}").into());
            let matrix = rows(&opengl(&camera_from_world.inverse()));
            frame.insert("transform_matrix".to_owned(), json!(matrix));
            let frame = Value::Object(frame);
            let _ = write!(text, "{separator}{frame}");
            separator = ",\n";
        }
        export.out.write(&text).await?;
        text.clear();
    }
    export.out.write(&text).await?;
    export.out.write("\n]}\n").await
}

/// Nerfstudio's names of the intrinsics, for the lenses that it knows.
fn camera_fields(camera: &CameraParameters) -> Result<Map<String, Value>, ApiError> {
    let CameraParameters { model, width, height, fx, fy, cx, cy, distortion } = camera;
    let coefficient = |idx: usize| distortion.get(idx).copied().unwrap_or(0.0);
    let names: &[(&str, usize)] = match model {
        CameraModel::Pinhole => &[],
        CameraModel::Radtan if distortion.len() <= 5 => {
            &[("k1", 0), ("k2", 1), ("p1", 2), ("p2", 3), ("k3", 4)]
        }
        CameraModel::KannalaBrandt => &[("k1", 0), ("k2", 1), ("k3", 2), ("k4", 3)],
        _ => {
            let sentence = "transforms.json has no words for this lens: it knows pinhole, radtan of up to five \
                            coefficients and kannala-brandt. Undistort the images, or take COLMAP's model";
            return Err(ApiError::new(ErrorCode::InvalidArgument, sentence));
        }
    };
    let name = if *model == CameraModel::KannalaBrandt { "OPENCV_FISHEYE" } else { "OPENCV" };
    let Value::Object(mut fields) = json!({
        "camera_model": name, "w": width, "h": height, "fl_x": fx, "fl_y": fy,
        "cx": cx + HALF_PIXEL, "cy": cy + HALF_PIXEL,
    }) else {
        return Err(ApiError::internal("an object is no object"));
    };
    fields.extend(names.iter().map(|(name, idx)| ((*name).to_owned(), coefficient(*idx).into())));
    Ok(fields)
}

/// The same pose of a camera whose y axis points up and whose z axis points backwards.
fn opengl(world_from_camera: &Pose) -> Matrix4<f64> {
    let mut matrix = Matrix4::identity();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(world_from_camera.rotation.to_rotation_matrix().matrix());
    matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&world_from_camera.translation);
    matrix * Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, -1.0, 1.0))
}

fn rows(matrix: &Matrix4<f64>) -> [[f64; 4]; 4] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::{UnitQuaternion, Vector3};

    fn camera(model: CameraModel, distortion: &[f64]) -> CameraParameters {
        let distortion = distortion.to_vec();
        CameraParameters { model, width: 64, height: 48, fx: 50.0, fy: 51.0, cx: 31.5, cy: 23.0, distortion }
    }

    #[test]
    fn a_lens_is_named_or_refused() {
        let fields = camera_fields(&camera(CameraModel::Radtan, &[0.1, 0.2, 0.3, 0.4])).unwrap();
        assert_eq!(
            (&fields["camera_model"], &fields["cx"], &fields["cy"]),
            (&json!("OPENCV"), &json!(32.0), &json!(23.5))
        );
        assert_eq!((&fields["k2"], &fields["p1"], &fields["k3"]), (&json!(0.2), &json!(0.3), &json!(0.0)));
        let fields = camera_fields(&camera(CameraModel::KannalaBrandt, &[0.1, 0.2, 0.3, 0.4])).unwrap();
        assert_eq!((&fields["camera_model"], &fields["k4"]), (&json!("OPENCV_FISHEYE"), &json!(0.4)));
        assert!(camera_fields(&camera(CameraModel::Fov, &[0.9])).is_err());
        assert!(camera_fields(&camera(CameraModel::Radtan, &[0.1; 8])).is_err());
    }

    #[test]
    fn the_camera_looks_along_its_negative_z_axis() {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.7);
        let pose = Pose::new(turned, Vector3::new(1.0, 2.0, 3.0));
        let in_opengl = opengl(&pose) * Vector4::new(0.3, -0.4, -5.0, 1.0);
        let in_ours = pose.rotation * Vector3::new(0.3, 0.4, 5.0) + pose.translation;
        assert!((in_opengl.xyz() - in_ours).norm() < 1e-12);
    }
}
