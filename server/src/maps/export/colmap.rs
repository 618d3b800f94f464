//! COLMAP's sparse model as text <https://colmap.github.io/format.html>.
//!
//! Poses are camera_from_world there as in the map, with the same axes. Pixels are not: COLMAP's origin is
//! the corner of the top-left pixel, the map's its center, so everything in pixels moves by half a pixel.

use super::{ColmapPart, Export};
use crate::error::{ApiError, ErrorCode};
use crate::options::working_camera;
use geometry::{CameraModel, CameraParameters};
use slam::map::{CameraId, KeyframeId};
use std::collections::BTreeMap;
use std::fmt::Write;
use store::SessionRecord;

/// From the center of the top-left pixel to its corner, pixels.
pub(super) const HALF_PIXEL: f64 = 0.5;

/// COLMAP's mark for an error that was not computed.
const NO_ERROR: &str = "-1";

pub(super) async fn write(export: &mut Export, part: ColmapPart) -> Result<(), ApiError> {
    match part {
        ColmapPart::Cameras => {
            let mut lines = camera_line(OWN_CAMERA, &export.camera())?;
            for (id, camera) in &export.cameras.cameras {
                lines.push_str(&camera_line(number_of(*id), camera)?);
            }
            let head = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
            export.out.write(head).await?;
            export.out.write(&lines).await
        }
        ColmapPart::Images => write_images(export).await,
        ColmapPart::Points3D => write_points(export).await,
    }
}

/// COLMAP's number of the map's own camera.
const OWN_CAMERA: u32 = 1;

/// COLMAP's number of one that was added.
fn number_of(camera: CameraId) -> u32 {
    OWN_CAMERA + camera.0
}

fn camera_line(number: u32, camera: &CameraParameters) -> Result<String, ApiError> {
    let CameraParameters { model, width, height, fx, fy, cx, cy, distortion } = camera;
    let mut coefficients = distortion.clone();
    let name = match model {
        CameraModel::Pinhole => "PINHOLE",
        CameraModel::Radtan if distortion.len() <= 4 => {
            coefficients.resize(4, 0.0);
            "OPENCV"
        }
        CameraModel::Radtan => {
            coefficients.resize(8, 0.0);
            "FULL_OPENCV"
        }
        CameraModel::KannalaBrandt => "OPENCV_FISHEYE",
        CameraModel::Fov => "FOV",
        CameraModel::ExtendedUnified | CameraModel::DoubleSphere => {
            let sentence = format!("COLMAP has no model for a lens such as {}", model.name());
            return Err(ApiError::new(ErrorCode::InvalidArgument, sentence));
        }
    };
    let (cx, cy) = (cx + HALF_PIXEL, cy + HALF_PIXEL);
    let mut line = format!("{number} {name} {width} {height} {fx} {fy} {cx} {cy}");
    for coefficient in coefficients {
        let _ = write!(line, " {coefficient}");
    }
    line.push('\n');
    Ok(line)
}

/// Which point each keypoint sees, by keyframe.
type SeenPoints = BTreeMap<KeyframeId, BTreeMap<u32, u64>>;

async fn read_seen_points(export: &mut Export) -> Result<SeenPoints, ApiError> {
    let (mut seen_points, mut after) = (SeenPoints::new(), None);
    loop {
        let points = export.snapshot.points_after(after, export.submap).await?;
        let Some(last) = points.last() else { return Ok(seen_points) };
        after = Some(last.id);
        for point in &points {
            for seen in &point.observations {
                seen_points.entry(seen.keyframe).or_default().insert(seen.feature_idx, point.id.get());
            }
        }
    }
}

async fn write_images(export: &mut Export) -> Result<(), ApiError> {
    let head = "# Image list with two lines of data per image:\n\
                #   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
                #   POINTS2D[] as (X, Y, POINT3D_ID)\n";
    export.out.write(head).await?;
    let seen_points = read_seen_points(export).await?;
    let own_factors = full_from_working(export.snapshot.record())?;
    let mut after = None;
    while let Some(records) = export.keyframes_after(&mut after).await? {
        for record in &records {
            let pose = export.units.pose(&record.camera_from_world);
            let (id, name) = (record.id.get(), export.image_name(record).await?);
            let (camera, [factor_x, factor_y]) = match export.cameras.of(record.id) {
                None => (OWN_CAMERA, own_factors),
                Some((camera, _)) => {
                    let map = &export.snapshot.record().id;
                    let record = export.store.record_of_keyframe(map, record.id).await?;
                    (number_of(camera), full_from_working(&record)?)
                }
            };
            let mut text = format!(
                "{id} {} {} {} {} {} {} {} {camera} {name}\n",
                pose.qw, pose.qx, pose.qy, pose.qz, pose.tx, pose.ty, pose.tz
            );
            let seen = seen_points.get(&record.id);
            for (idx, [x, y]) in export.snapshot.keypoints(record.id).await?.into_iter().enumerate() {
                let x = (f64::from(x) + HALF_PIXEL) * factor_x;
                let y = (f64::from(y) + HALF_PIXEL) * factor_y;
                let separator = if idx == 0 { "" } else { " " };
                let _ = match seen.and_then(|seen| seen.get(&(idx as u32))) {
                    Some(point) => write!(text, "{separator}{x:.3} {y:.3} {point}"),
                    None => write!(text, "{separator}{x:.3} {y:.3} -1"),
                };
            }
            text.push('\n');
            export.out.write(&text).await?;
        }
    }
    Ok(())
}

/// Pixels of the camera per pixel of the working image that keypoints are measured in.
fn full_from_working(record: &SessionRecord) -> Result<[f64; 2], ApiError> {
    let working = working_camera(record)?;
    let factor = |full: u32, working: u32| f64::from(full) / f64::from(working);
    Ok([factor(record.camera.width, working.width()), factor(record.camera.height, working.height())])
}

async fn write_points(export: &mut Export) -> Result<(), ApiError> {
    let head = "# 3D point list with one line of data per point:\n\
                #   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
    export.out.write(head).await?;
    let mut after = None;
    loop {
        let points = export.snapshot.points_after(after, export.submap).await?;
        let Some(last) = points.last() else { return Ok(()) };
        after = Some(last.id);
        let grays = export.grays(&points).await?;
        let mut text = String::new();
        for (point, gray) in points.iter().zip(grays) {
            let [x, y, z] = export.units.position(&point.position);
            let _ = write!(text, "{} {x} {y} {z} {gray} {gray} {gray} {NO_ERROR}", point.id);
            for seen in &point.observations {
                let _ = write!(text, " {} {}", seen.keyframe, seen.feature_idx);
            }
            text.push('\n');
        }
        export.out.write(&text).await?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_named_and_moved_by_half_a_pixel() {
        let camera = |model, distortion: &[f64]| CameraParameters {
            model,
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 501.5,
            cx: 319.5,
            cy: 239.0,
            distortion: distortion.to_vec(),
        };
        let line = |model, distortion: &[f64]| camera_line(1, &camera(model, distortion)).unwrap();
        assert_eq!(line(CameraModel::Pinhole, &[]), "1 PINHOLE 640 480 500 501.5 320 239.5\n");
        let opencv = "1 OPENCV 640 480 500 501.5 320 239.5 0.1 -0.2 0 0.001\n";
        assert_eq!(line(CameraModel::Radtan, &[0.1, -0.2, 0.0, 0.001]), opencv);
        let full = line(CameraModel::Radtan, &[0.1, -0.2, 0.0, 0.001, 3.0]);
        assert_eq!(full, "1 FULL_OPENCV 640 480 500 501.5 320 239.5 0.1 -0.2 0 0.001 3 0 0 0\n");
        assert!(line(CameraModel::Fov, &[0.9]).starts_with("1 FOV "));
        assert!(line(CameraModel::KannalaBrandt, &[0.0; 4]).starts_with("1 OPENCV_FISHEYE "));
        assert!(camera_line(2, &camera(CameraModel::DoubleSphere, &[-0.2, 0.6])).is_err());
    }
}
