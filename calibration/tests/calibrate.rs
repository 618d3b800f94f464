//! Cameras of every model from exact and from noisy corners, and what is said of views that do not suffice.

use calibration::{Board, CalibrationConfig, CalibrationError, Finding, Verdict, View, calibrate};
use geometry::nalgebra::{Vector2, Vector3, Vector6};
use geometry::{Camera, CameraModel, CameraParameters, Pose};

fn board() -> Board {
    Board::new(9, 6, 0.025).unwrap()
}

fn camera(model: CameraModel, focal: f64, distortion: &[f64]) -> Camera {
    let parameters = CameraParameters::of_focal_length(640, 480, focal);
    let (cx, cy, fy) = (326.0, 233.0, 1.01 * focal);
    Camera::new(CameraParameters { model, distortion: distortion.to_vec(), cx, cy, fy, ..parameters })
        .unwrap()
}

/// Views from all sides, so that all of the image is covered; `tilt` scales how far the board is tilted.
fn views(camera: &Camera, n: usize, tilt: f64, noise_px: f64) -> Vec<View> {
    let board = board();
    let mut state = 1u64;
    let mut noise = move || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        noise_px * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0)
    };
    let wide = 300.0 / camera.parameters().fx;
    (0..400)
        .filter_map(|k| {
            let t = f64::from(k);
            let rotation = Pose::exp(&Vector6::new(
                tilt * (1.7 * t).sin(),
                tilt * (2.3 * t).cos(),
                0.4 * t,
                0.0,
                0.0,
                0.0,
            ));
            let middle = Vector3::new(
                0.35 * wide * (0.9 * t).sin(),
                0.26 * wide * (1.4 * t).cos(),
                0.28 + 0.1 * (0.6 * t).sin(),
            );
            let pose = Pose {
                translation: middle - rotation.transform(&Vector3::new(0.1, 0.0625, 0.0)),
                ..rotation
            };
            let corners: Option<Vec<Vector2<f64>>> =
                board.corners().map(|corner| camera.project(&pose.transform(&corner))).collect();
            let corners = corners?;
            let is_seen = corners.iter().all(|pixel| camera.contains(pixel));
            let corners = corners.iter().map(|pixel| pixel + Vector2::new(noise(), noise())).collect();
            is_seen.then_some(View { corners })
        })
        .take(n)
        .collect()
}

#[test]
fn every_model_comes_back() {
    for (model, focal, coefficients) in [
        (CameraModel::Pinhole, 520.0, &[][..]),
        (CameraModel::Radtan, 430.0, &[-0.28, 0.07, 0.0004, -0.0003]),
        (CameraModel::KannalaBrandt, 280.0, &[0.01, -0.02, 0.006, -0.001]),
        (CameraModel::Fov, 400.0, &[0.9]),
        (CameraModel::ExtendedUnified, 270.0, &[0.6, 1.1]),
        (CameraModel::DoubleSphere, 230.0, &[-0.2, 0.6]),
    ] {
        let truth = camera(model, focal, coefficients);
        let config = CalibrationConfig { model, ..CalibrationConfig::default() };
        let exact = calibrate(&board(), &views(&truth, 24, 0.9, 0.0), (640, 480), &config).unwrap();
        assert!(exact.rms_px < 1e-3, "{model:?}: {} px", exact.rms_px);
        let noisy = calibrate(&board(), &views(&truth, 24, 0.9, 0.1), (640, 480), &config).unwrap();
        assert!((noisy.rms_px - 0.14).abs() < 0.02, "{model:?}: {} px", noisy.rms_px);
        let (tilt_deg, coverage) = (noisy.tilt_deg, noisy.coverage);
        assert!(tilt_deg > 40.0 && coverage > 0.7, "{model:?}: {tilt_deg} degrees, {coverage}");
        // What matters is where rays go, and standard deviations say how far that is known.
        let found = Camera::new(noisy.camera.clone()).unwrap();
        for x in [40.0, 200.0, 330.0, 600.0] {
            for y in [30.0, 240.0, 450.0] {
                let pixel = Vector2::new(x, y);
                let off = truth.unproject(&pixel).unwrap().angle(&found.unproject(&pixel).unwrap());
                assert!(off < 4e-3, "{model:?} at {x}, {y}: {off}");
            }
        }
        let off = (noisy.camera.cx - 326.0) / noisy.sigmas[2];
        assert!(off.abs() < 4.0 && noisy.sigmas[2] < 2.0, "{model:?}: {off} standard deviations");
    }
}

#[test]
fn a_board_that_always_lies_alike_and_few_views_are_told() {
    let truth = camera(CameraModel::Pinhole, 520.0, &[]);
    let config = CalibrationConfig { model: CameraModel::Pinhole, ..CalibrationConfig::default() };
    let flat = calibrate(&board(), &views(&truth, 20, 0.03, 0.1), (640, 480), &config).unwrap();
    assert!(
        flat.findings.iter().any(|finding| matches!(finding, Finding::OneTilt(_))),
        "{:?}",
        flat.findings
    );
    assert_eq!(flat.verdict(), Verdict::Poor);
    let few = calibrate(&board(), &views(&truth, 5, 0.9, 0.1), (640, 480), &config).unwrap();
    assert!(few.findings.iter().any(|finding| matches!(finding, Finding::FewViews(5))), "{:?}", few.findings);
    assert!(few.findings.iter().all(|finding| !finding.to_string().is_empty()));
    assert_eq!(few.verdict(), Verdict::Poor);
    let none = calibrate(&board(), &views(&truth, 2, 0.9, 0.1), (640, 480), &config);
    assert_eq!(none, Err(CalibrationError::TooFewViews { found: 2, required: 3 }));
}

#[test]
fn corners_of_the_image_without_a_board_are_named() {
    let truth = camera(CameraModel::Pinhole, 520.0, &[]);
    let config = CalibrationConfig { model: CameraModel::Pinhole, ..CalibrationConfig::default() };
    let mut seen = views(&truth, 60, 0.9, 0.1);
    seen.retain(|view| view.corners.iter().all(|pixel| pixel.x < 420.0));
    let found = calibrate(&board(), &seen, (640, 480), &config).unwrap();
    let corners = found.findings.iter().find_map(|finding| match finding {
        Finding::CornersNotCovered(corners) => Some(corners.clone()),
        _ => None,
    });
    assert!(corners.is_some_and(|corners| corners.contains(&"top right")), "{:?}", found.findings);
}

#[test]
fn a_view_that_does_not_fit_is_left_out() {
    let truth = camera(CameraModel::Pinhole, 520.0, &[]);
    let config = CalibrationConfig { model: CameraModel::Pinhole, ..CalibrationConfig::default() };
    let mut seen = views(&truth, 24, 0.9, 0.1);
    // A board that was bent.
    for (idx, corner) in seen[4].corners.iter_mut().enumerate() {
        corner.y += 4.0 * (idx as f64 * 0.7).sin();
    }
    let found = calibrate(&board(), &seen, (640, 480), &config).unwrap();
    assert!(found.findings.contains(&Finding::ViewsLeftOut(vec![4])), "{:?}", found.findings);
    let (fx, sigma) = (found.camera.fx, found.sigmas[0]);
    assert!((fx - 520.0).abs() < 4.0 * sigma && sigma < 6.0, "{fx} ± {sigma}");
}

#[test]
fn boards_that_cannot_be_are_refused() {
    assert!(Board::new(2, 6, 0.02).is_err());
    assert!(Board::new(9, 600, 0.02).is_err());
    assert!(Board::new(9, 6, 0.0).is_err());
    assert!(Board::new(9, 6, f64::NAN).is_err());
}
