//! A wall with a smooth pattern, seen from two places.

use super::Aligner;
use crate::config::AlignmentConfig;
use geometry::nalgebra::{UnitQuaternion, Vector2, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose};
use std::sync::Arc;
use vision::GrayImage;

/// Distance of the wall.
const DEPTH: f64 = 3.0;

fn camera(distortion: Vec<f64>) -> Camera {
    let model = if distortion.is_empty() { CameraModel::Pinhole } else { CameraModel::Radtan };
    Camera::new(CameraParameters {
        model,
        width: 320,
        height: 240,
        fx: 260.0,
        fy: 260.0,
        cx: 159.5,
        cy: 119.5,
        distortion,
    })
    .unwrap()
}

/// Blobs of several sizes, none of which repeats within the view.
fn pattern(x: f64, y: f64) -> f64 {
    128.0
        + 40.0 * (1.3 * x + 0.4).sin() * (1.7 * y).cos()
        + 30.0 * (5.1 * x + 2.3 * y).sin()
        + 25.0 * (3.7 * y - 8.3 * x * (0.2 * y).cos()).cos()
}

fn view(camera: &Camera, camera_from_world: &Pose, contrast: f64, brightness: f64) -> Arc<GrayImage> {
    let world_from_camera = camera_from_world.inverse();
    let image = GrayImage::from_fn(camera.width(), camera.height(), |x, y| {
        let ray = camera.unproject(&Vector2::new(f64::from(x), f64::from(y))).unwrap();
        let (center, ray) = (world_from_camera.translation, world_from_camera.rotation * ray);
        let hit = center + ray * ((DEPTH - center.z) / ray.z);
        (contrast * pattern(hit.x, hit.y) + brightness).clamp(0.0, 255.0) as u8
    });
    Arc::new(image)
}

fn positions(camera: &Camera) -> Vec<Vector3<f64>> {
    let pixels = (0..120).map(|i| Vector2::new(f64::from(25 + 27 * (i % 11)), f64::from(20 + 20 * (i / 11))));
    pixels.map(|pixel| camera.unproject(&pixel).unwrap()).map(|ray| ray * (DEPTH / ray.z)).collect()
}

fn motion(turn_deg: [f64; 3], shift: [f64; 3]) -> Pose {
    let turn = Vector3::from(turn_deg).map(f64::to_radians);
    Pose { rotation: UnitQuaternion::from_scaled_axis(turn), translation: Vector3::from(shift) }
}

#[test]
fn finds_motions_far_from_the_expected_one() {
    for (name, distortion, truth, contrast, brightness) in [
        ("none", vec![], motion([0.0; 3], [0.0; 3]), 1.0, 0.0),
        ("small", vec![], motion([0.5, -0.7, 0.2], [0.02, 0.01, -0.03]), 1.0, 0.0),
        ("a quick turn", vec![], motion([4.0, 13.0, 1.0], [0.05, -0.02, 0.04]), 1.0, 0.0),
        ("darker", vec![], motion([-3.0, 6.0, -1.0], [0.05, 0.0, 0.0]), 0.8, 10.0),
        ("distorted", vec![-0.25, 0.07, 0.0, 0.0], motion([2.0, -8.0, 0.0], [0.0, 0.05, 0.0]), 1.0, 0.0),
    ] {
        let camera = camera(distortion);
        let (first, second) =
            (view(&camera, &Pose::identity(), 1.0, 0.0), view(&camera, &truth, contrast, brightness));
        let aligner = Aligner::new(camera.clone(), AlignmentConfig::default());
        let found = aligner
            .align(&first, &second, &positions(&camera), &Pose::identity())
            .unwrap_or_else(|| panic!("{name}: not found"));
        let error = found * truth.inverse();
        // A turn and a shift along a wall look nearly alike: what matters is where things are seen.
        let worst_px = positions(&camera)
            .iter()
            .filter_map(|position| {
                let [seen, wanted] = [found, truth].map(|pose| camera.project(&pose.transform(position)));
                Some((seen? - wanted?).norm())
            })
            .fold(0.0, f64::max);
        assert!(worst_px < 1.0, "{name}: off by {worst_px:.2} px");
        assert!(
            error.rotation.angle().to_degrees() < 1.0,
            "{name}: {:.2} deg",
            error.rotation.angle().to_degrees()
        );
    }
}

#[test]
fn does_not_find_what_is_not_there() {
    let camera = camera(vec![]);
    let first = view(&camera, &Pose::identity(), 1.0, 0.0);
    let elsewhere = view(&camera, &motion([0.0, 0.0, 90.0], [40.0, -17.0, 0.0]), 1.0, 0.0);
    let plain = Arc::new(GrayImage::from_fn(320, 240, |_, _| 128));
    let noise = Arc::new(GrayImage::from_fn(320, 240, |x, y| {
        ((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761) >> 24) as u8
    }));
    let aligner = Aligner::new(camera.clone(), AlignmentConfig::default());
    for (name, second) in [("elsewhere", elsewhere), ("noise", noise)] {
        let found = aligner.align(&first, &second, &positions(&camera), &Pose::identity());
        assert!(found.is_none(), "{name}: {found:?}");
    }
    // A gray image has nothing to be found in, and nothing to align.
    for (first, second, positions) in [
        (&plain, &first, positions(&camera)),
        (&first, &plain, positions(&camera)),
        (&first, &first, Vec::new()),
    ] {
        let found = aligner.align(first, second, &positions, &Pose::identity());
        assert!(found.is_none_or(|pose| pose.translation.iter().all(|value| value.is_finite())));
    }
}
