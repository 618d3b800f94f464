//! Every camera model: projection against its inverse and its derivative, and what is refused.

mod support;

use geometry::nalgebra::{Vector2, Vector3};
use geometry::{Camera, CameraCorrection, CameraModel, CameraParameters, Pinhole};
use rand::Rng;
use support::{assert_close, generators, numeric_jacobian};

fn parameters(
    model: CameraModel,
    (width, height): (u32, u32),
    [fx, fy, cx, cy]: [f64; 4],
    d: &[f64],
) -> CameraParameters {
    CameraParameters { model, width, height, fx, fy, cx, cy, distortion: d.to_vec() }
}

/// Calibrations of real cameras: EuRoC, TUM RGB-D freiburg1, TUM-VI, TUM monoVO, a phone with OpenCV's
/// rational model.
fn all_parameters() -> Vec<CameraParameters> {
    use CameraModel::{DoubleSphere, ExtendedUnified, Fov, KannalaBrandt, Radtan};
    let euroc = [458.654, 457.296, 367.215, 248.375];
    vec![
        parameters(CameraModel::Pinhole, (640, 480), [500.0, 510.0, 320.0, 240.0], &[]),
        parameters(Radtan, (752, 480), euroc, &[-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
        parameters(
            Radtan,
            (640, 480),
            [517.3, 516.5, 318.6, 255.3],
            &[0.2624, -0.9531, -0.0054, 0.0026, 1.1633],
        ),
        parameters(
            Radtan,
            (1280, 720),
            [890.0, 891.0, 640.5, 361.0],
            &[0.45, -0.12, 0.0008, -0.0005, 0.02, 0.6, -0.05, 0.01],
        ),
        parameters(
            KannalaBrandt,
            (512, 512),
            [190.978, 190.973, 254.932, 256.897],
            &[0.0034823894, 0.00071503485, -0.0020532361, 0.00020293673],
        ),
        parameters(Fov, (1280, 1024), [715.0, 717.0, 640.0, 500.0], &[0.93]),
        parameters(Fov, (640, 480), [300.0, 300.0, 320.0, 240.0], &[1e-4]),
        parameters(
            DoubleSphere,
            (512, 512),
            [158.280, 158.274, 254.968, 256.346],
            &[-0.17213086, 0.59317177],
        ),
        parameters(ExtendedUnified, (640, 480), [270.0, 271.0, 318.0, 243.0], &[0.63, 1.04]),
        parameters(ExtendedUnified, (640, 480), [250.0, 250.0, 319.5, 239.5], &[0.0, 1.0]),
    ]
}

fn all_cameras() -> Vec<Camera> {
    all_parameters().into_iter().map(|p| Camera::new(p).expect("a calibration in use")).collect()
}

/// A grid over the image, its corners, and its principal point.
fn pixels(camera: &Camera) -> Vec<Vector2<f64>> {
    let (w, h) = (f64::from(camera.width()), f64::from(camera.height()));
    let mut pixels: Vec<_> = (0..=24)
        .flat_map(|i| (0..=24).map(move |j| (f64::from(i) / 24.0, f64::from(j) / 24.0)))
        .map(|(x, y)| Vector2::new(x * w - 0.5, y * h - 0.5))
        .collect();
    pixels.push(Vector2::new(camera.parameters().cx, camera.parameters().cy));
    pixels
}

#[test]
fn unprojection_inverts_projection_over_the_whole_image() {
    for camera in all_cameras() {
        for pixel in pixels(&camera) {
            let bearing = camera.unproject(&pixel).unwrap_or_else(|| panic!("{camera:?} at {pixel}"));
            assert!((bearing.norm() - 1.0).abs() < 1e-12);
            let back = camera.project(&(bearing * 3.7)).unwrap_or_else(|| panic!("{camera:?} at {pixel}"));
            let error = (back - pixel).norm();
            assert!(error < 1e-8, "{:?} at {pixel}: {error:e} px", camera.parameters().model);
        }
    }
}

#[test]
fn undistorted_pixels_come_back_and_stay_within_the_bounds() {
    for camera in all_cameras() {
        let (low, high) = camera.undistorted_bounds();
        let mut n_usable = 0;
        for pixel in pixels(&camera) {
            let Some(undistorted) = camera.undistort(&pixel) else {
                // Only the fisheyes see further than 80 degrees from their axes.
                assert!(matches!(
                    camera.parameters().model,
                    CameraModel::KannalaBrandt | CameraModel::ExtendedUnified | CameraModel::DoubleSphere
                ));
                assert!(camera.unproject(&pixel).unwrap().z < 80.0_f64.to_radians().cos() + 1e-12);
                continue;
            };
            n_usable += 1;
            let back = camera.distort(&undistorted).expect("inside the field");
            assert!((back - pixel).norm() < 1e-7, "{camera:?} at {pixel}");
            // Sampled on the border, so the bounds may be short by the sagitta between two samples.
            let slack = 1e-3 * (high - low).norm();
            assert!(undistorted.x >= low.x - slack && undistorted.x <= high.x + slack);
            assert!(undistorted.y >= low.y - slack && undistorted.y <= high.y + slack);
            let bearing = camera.unproject(&pixel).unwrap();
            assert_close(&camera.pinhole().bearing(&undistorted), &bearing, 1e-12, "bearing");
        }
        assert!(n_usable > 400, "{camera:?}: only {n_usable} of 626 pixels are usable");
        assert!(low.iter().chain(high.iter()).all(|x| x.is_finite()));
    }
}

#[test]
fn projection_jacobians_match_central_differences() {
    for (seed, mut rng) in generators("camera_jacobians", 50) {
        for camera in all_cameras() {
            let pixel = Vector2::new(
                rng.random_range(0.0..f64::from(camera.width())),
                rng.random_range(0.0..f64::from(camera.height())),
            );
            let mut point = camera.unproject(&pixel).unwrap() * rng.random_range(0.5..5.0);
            if seed == 0 {
                point = Vector3::new(0.0, 0.0, 2.0); // On the axis, where radial formulas divide by zero.
            }
            let (projected, jacobian) = camera.project_with_jacobian(&point).unwrap();
            assert_eq!(Some(projected), camera.project(&point));
            let numeric = numeric_jacobian(|p| camera.project(p).unwrap(), &point, 1e-6);
            assert_close(&jacobian, &numeric, 1e-7, &format!("seed {seed} {camera:?}"));
        }
        let pinhole = Pinhole { fx: 400.0, fy: 410.0, cx: 300.0, cy: 200.0 };
        let point = support::point_in_view(&mut rng);
        let (projected, jacobian) = pinhole.project_with_jacobian(&point);
        assert_close(&projected, &pinhole.project(&point), 1e-15, "pinhole");
        assert_close(&jacobian, &numeric_jacobian(|p| pinhole.project(p), &point, 1e-6), 1e-7, "pinhole");
    }
}

#[test]
fn known_values_of_each_model() {
    // Computed by hand from the definitions at x/z = 0.5, y/z = 0.
    let at = |model, d: &[f64]| {
        let p = parameters(model, (400, 300), [100.0, 100.0, 200.0, 150.0], d);
        Camera::new(p).unwrap().project(&Vector3::new(1.0, 0.0, 2.0)).unwrap()
    };
    let close =
        |found: Vector2<f64>, x: f64, y: f64| assert_close(&found, &Vector2::new(x, y), 1e-12, "known");
    close(at(CameraModel::Pinhole, &[]), 250.0, 150.0);
    // 0.5 (1 + 0.1/4 + 0.02/16) + 0.002 * 3/4; y: 0.001 / 4.
    close(
        at(CameraModel::Radtan, &[0.1, 0.02, 0.001, 0.002]),
        200.0 + 100.0 * (0.5 * 1.02625 + 0.0015),
        150.025,
    );
    let theta = 0.5_f64.atan();
    close(
        at(CameraModel::KannalaBrandt, &[0.01, 0.0, 0.0, 0.0]),
        200.0 + 100.0 * (theta + 0.01 * theta.powi(3)),
        150.0,
    );
    close(at(CameraModel::Fov, &[1.0]), 200.0 + 100.0 * (2.0 * 0.5 * 0.5_f64.tan()).atan(), 150.0);
    // d = sqrt(1.2 + 4); 1 / (0.6 d + 0.4 * 2).
    close(at(CameraModel::ExtendedUnified, &[0.6, 1.2]), 200.0 + 100.0 / (0.6 * 5.2_f64.sqrt() + 0.8), 150.0);
    let shifted = 2.0 - 0.2 * 5.0_f64.sqrt();
    close(
        at(CameraModel::DoubleSphere, &[-0.2, 0.6]),
        200.0 + 100.0 / (0.6 * (1.0 + shifted * shifted).sqrt() + 0.4 * shifted),
        150.0,
    );
}

#[test]
fn spheres_show_more_than_180_degrees_and_what_is_not_used_of_them_is_told() {
    let wide = parameters(
        CameraModel::DoubleSphere,
        (512, 512),
        [158.280, 158.274, 254.968, 256.346],
        &[-0.17213086, 0.59317177],
    );
    let camera = Camera::new(wide).unwrap();
    let behind = Vector3::new(1.0, 0.0, -0.05).normalize();
    let pixel = camera.project(&behind).expect("92.9 degrees from the axis");
    assert_close(&camera.unproject(&pixel).unwrap(), &behind, 1e-10, "behind the image plane");
    assert_eq!(camera.undistort(&pixel), None, "no pinhole sees it");
    assert!(camera.share_beyond_reach() > 0.05 && camera.folded_share() == 0.0);
    let warnings = camera.warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("80 degrees from the axis"), "{warnings:?}");
}

#[test]
fn calibrations_are_differentiated_by_their_numbers() {
    for parameters in all_parameters() {
        let camera = Camera::under_trial(parameters.clone());
        for point in
            [Vector3::new(0.3, -0.2, 1.1), Vector3::new(-0.9, 0.7, 2.0), Vector3::new(0.05, 0.4, 0.8)]
        {
            let found = camera.project_for_calibration(&point).unwrap();
            assert_close(&found.pixel, &camera.project(&point).unwrap(), 1e-10, "pixel");
            let n = 4 + parameters.distortion.len();
            assert_eq!(found.d_pixel_d_parameters.len(), n);
            for idx in 0..n {
                let at = |by: f64| {
                    let mut moved = parameters.clone();
                    let CameraParameters { fx, fy, cx, cy, distortion, .. } = &mut moved;
                    let mut numbers: Vec<&mut f64> = vec![fx, fy, cx, cy];
                    numbers.extend(distortion.iter_mut());
                    *numbers[idx] += by;
                    Camera::under_trial(moved).project(&point).unwrap()
                };
                let step = if idx < 4 { 1e-3 } else { 1e-5 };
                let expected = (at(step) - at(-step)) / (2.0 * step);
                let error = (found.d_pixel_d_parameters[idx] - expected).norm();
                assert!(error < 1e-5 * (1.0 + expected.norm()), "{:?} {idx}: {error:e}", parameters.model);
            }
        }
    }
}

#[test]
fn bounds_are_those_of_what_is_used() {
    let camera = Camera::new(all_parameters()[0].clone()).unwrap();
    let corners = [Vector2::new(99.5, 49.5), Vector2::new(300.5, 200.5)];
    let used = camera.with_used_box(Some(corners));
    assert_eq!(used.undistorted_bounds(), (corners[0], corners[1]));
    let (low, high) = used.scaled(2.0, 2.0).undistorted_bounds();
    assert_close(&low, &Vector2::new(199.5, 99.5), 1e-9, "low");
    assert_close(&high, &Vector2::new(601.5, 401.5), 1e-9, "high");
}

#[test]
fn points_behind_the_camera_or_outside_the_field_are_not_seen() {
    for camera in all_cameras() {
        assert_eq!(camera.project(&Vector3::new(0.1, 0.1, -1.0)), None);
        assert_eq!(camera.project(&Vector3::zeros()), None);
        assert_eq!(camera.project(&Vector3::repeat(f64::NAN)), None);
        assert!(camera.project_with_jacobian(&Vector3::new(0.1, 0.1, -1.0)).is_none());
        assert_eq!(camera.unproject(&Vector2::repeat(f64::NAN)), None);
        assert_eq!(camera.undistort(&Vector2::repeat(f64::NAN)), None);
        assert_eq!(camera.undistort(&Vector2::repeat(f64::INFINITY)), None);
    }
}

#[test]
fn a_distortion_that_folds_outside_the_image_does_not_bring_far_points_into_it() {
    // k1 < 0 alone folds at r = 1/sqrt(3 * 0.3): points beyond would land in the image again.
    let p = parameters(CameraModel::Radtan, (640, 480), [600.0, 600.0, 320.0, 240.0], &[-0.3, 0.0, 0.0, 0.0]);
    let camera = Camera::new(p).unwrap();
    assert!(camera.project(&Vector3::new(0.99, 0.0, 1.0)).is_some());
    assert_eq!((camera.folded_share(), camera.warnings()), (0.0, vec![]));
    assert_eq!(camera.project(&Vector3::new(1.8, 0.0, 1.0)), None);
}

#[test]
fn a_distortion_that_folds_in_the_corners_is_used_where_it_rises() {
    // As OpenCV fits it to a phone whose board never came to the corners.
    let p =
        parameters(CameraModel::Radtan, (640, 480), [400.0, 400.0, 319.5, 239.5], &[-0.25, 0.0, 0.0, 0.0]);
    let camera = Camera::new(p).unwrap();
    let share = camera.folded_share();
    assert!((0.01..0.3).contains(&share), "{share}");
    let warning = &camera.warnings()[0];
    assert!(warning.contains(&format!("{:.1} % of the image", 100.0 * share)), "{warning}");
    let mut n_without = 0;
    for x in 0..64 {
        for y in 0..48 {
            let pixel = Vector2::new(10.0 * f64::from(x) + 4.5, 10.0 * f64::from(y) + 4.5);
            match camera.unproject(&pixel) {
                Some(bearing) => {
                    assert!((camera.project(&bearing).unwrap() - pixel).norm() < 1e-6, "{pixel}")
                }
                None => n_without += 1,
            }
        }
    }
    assert!((f64::from(n_without) / (64.0 * 48.0) - share).abs() < 0.02, "{n_without}");
    assert!(camera.unproject(&Vector2::new(320.0, 240.0)).is_some());
    assert_eq!(camera.unproject(&Vector2::new(0.0, 0.0)), None);
    let (low, high) = camera.undistorted_bounds();
    assert!(low.iter().chain(high.iter()).all(|x| x.abs() < 5000.0), "{low} {high}");
}

#[test]
fn opencv_files_may_have_twelve_or_fourteen_coefficients() {
    let with = |distortion: &[f64]| {
        let p = parameters(CameraModel::Radtan, (640, 480), [500.0, 500.0, 319.5, 239.5], distortion);
        Camera::new(p).map_err(|error| error.message)
    };
    let mut long = vec![0.1, -0.05, 0.001, 0.002, 0.01, 0.0, 0.0, 0.0];
    let short = with(&long).unwrap();
    for n in [12, 14] {
        long.resize(n, 0.0);
        assert_eq!(with(&long).as_ref(), Ok(&short), "{n} coefficients");
    }
    for (i, name) in [(8, "thin prism"), (11, "thin prism"), (12, "tilted sensor"), (13, "tilted sensor")] {
        let mut used = long.clone();
        used[i] = 1e-3;
        let refused = with(&used).unwrap_err();
        assert!(refused.contains(name) && refused.contains(&format!("coefficient {i}")), "{refused}");
    }
}

#[test]
fn focal_lengths_in_millimeters_are_refused_with_what_would_be_right() {
    for focal in [3.6, 26.0, 0.8, 1e300] {
        let p = parameters(CameraModel::Pinhole, (640, 480), [focal, focal, 319.5, 239.5], &[]);
        let refused = Camera::new(p).unwrap_err();
        assert_eq!(refused.field, "fx");
        assert!(refused.message.contains("in pixels, between 32 and 640000"), "{refused}");
        assert_eq!(refused.message.contains("millimeters"), focal < 32.0, "{refused}");
        assert!(refused.message.len() < 300, "{refused}");
    }
}

#[test]
fn resizing_keeps_rays() {
    for camera in all_cameras() {
        let half = camera.scaled(0.5, 0.5);
        assert_eq!((half.width(), half.height()), (camera.width() / 2, camera.height() / 2));
        for pixel in pixels(&camera) {
            let smaller = (pixel + Vector2::repeat(0.5)) * 0.5 - Vector2::repeat(0.5);
            assert_close(
                &half.unproject(&smaller).unwrap(),
                &camera.unproject(&pixel).unwrap(),
                1e-10,
                "ray",
            );
        }
    }
}

#[test]
fn containment_includes_whole_pixels() {
    let camera = &all_cameras()[0];
    assert!(camera.contains(&Vector2::new(-0.5, -0.5)));
    assert!(camera.contains(&Vector2::new(639.49, 479.49)));
    assert!(!camera.contains(&Vector2::new(639.5, 100.0)));
    assert!(!camera.contains(&Vector2::new(100.0, -0.51)));
    assert!(!camera.contains(&Vector2::new(f64::NAN, 1.0)));
}

#[test]
fn wrong_calibrations_are_refused_by_field() {
    let good = || all_parameters().remove(1);
    let refused = |change: &dyn Fn(&mut CameraParameters)| {
        let mut p = good();
        change(&mut p);
        let error = Camera::new(p).expect_err("a wrong calibration");
        assert!(error.to_string().contains(error.field), "`{error}` does not name {}", error.field);
        error.field
    };
    assert_eq!(refused(&|p| p.width = 0), "width");
    assert_eq!(refused(&|p| p.height = 16_385), "height");
    assert_eq!(refused(&|p| p.fx = 0.0), "fx");
    assert_eq!(refused(&|p| p.fx = f64::NAN), "fx");
    assert_eq!(refused(&|p| p.fy = -1.0), "fy");
    assert_eq!(refused(&|p| p.fy = f64::INFINITY), "fy");
    assert_eq!(refused(&|p| p.cx = 752.0), "cx");
    assert_eq!(refused(&|p| p.cy = -0.6), "cy");
    assert_eq!(refused(&|p| p.cy = f64::NAN), "cy");
    assert_eq!(refused(&|p| p.distortion.truncate(3)), "distortion");
    assert_eq!(refused(&|p| p.distortion[2] = f64::INFINITY), "distortion");
    assert_eq!(refused(&|p| p.model = CameraModel::Pinhole), "distortion");
    assert_eq!(
        refused(&|p| {
            p.model = CameraModel::Fov;
            p.distortion = vec![0.0];
        }),
        "distortion"
    );
    // Folds before the corners.
    assert_eq!(refused(&|p| p.distortion = vec![-0.6, 0.0, 0.0, 0.0]), "distortion");
    assert_eq!(
        refused(&|p| {
            p.model = CameraModel::KannalaBrandt;
            p.distortion = vec![-0.9, 0.0, 0.0, 0.0];
        }),
        "distortion"
    );
}

const CORRECTION: CameraCorrection =
    CameraCorrection { focal: -0.02, center_x: 0.01, center_y: -0.005, k1: 0.0, k2: 0.0 };

#[test]
fn a_corrected_camera_sees_the_same_pixels_by_other_rays() {
    for nominal in all_cameras() {
        let camera = nominal.with_correction(CORRECTION);
        assert_eq!(camera.pinhole(), CORRECTION.apply(&nominal.pinhole()));
        assert_eq!(camera.undistorted_bounds(), nominal.undistorted_bounds());
        for pixel in pixels(&camera) {
            assert_eq!(camera.undistort(&pixel), nominal.undistort(&pixel));
            let Some(bearing) = camera.unproject(&pixel) else { panic!("{camera:?} at {pixel}") };
            let back = camera.project(&(bearing * 2.3)).unwrap();
            assert!((back - pixel).norm() < 1e-8, "{:?} at {pixel}", camera.parameters().model);
            if let Some(undistorted) = camera.undistort(&pixel) {
                let error = (camera.pinhole().bearing(&undistorted) - bearing).norm();
                assert!(error < 1e-8, "{:?} at {pixel}: {error:e}", camera.parameters().model);
            }
        }
        let point = Vector3::new(0.1, -0.2, 1.3);
        let (_, jacobian) = camera.project_with_jacobian(&point).unwrap();
        let numeric = numeric_jacobian(|p| camera.project(p).unwrap(), &point, 1e-6);
        assert_close(&jacobian, &numeric, 1e-7, "corrected");
    }
}

#[test]
fn a_correction_may_bend_what_the_calibration_has_straight() {
    let bending = CameraCorrection { k1: -0.05, k2: 0.01, ..CORRECTION };
    for nominal in all_cameras() {
        let camera = nominal.with_correction(bending);
        let (low, high) = camera.undistorted_bounds();
        for pixel in pixels(&camera) {
            // Beyond where the two models together are one-to-one there is no ray.
            let Some(bearing) = camera.unproject(&pixel).filter(|bearing| bearing.z > 0.3) else { continue };
            let back = camera.project(&(bearing * 2.3)).unwrap();
            assert!((back - pixel).norm() < 1e-7, "{:?} at {pixel}", camera.parameters().model);
            let undistorted = camera.undistort(&pixel).unwrap();
            let error = (camera.pinhole().bearing(&undistorted) - bearing).norm();
            assert!(error < 1e-8, "{:?} at {pixel}: {error:e}", camera.parameters().model);
            assert!((camera.distort(&undistorted).unwrap() - pixel).norm() < 1e-7);
            let slack = 1e-3 * (high - low).norm();
            assert!(undistorted.x >= low.x - slack && undistorted.x <= high.x + slack);
        }
        let point = Vector3::new(0.3, -0.2, 1.3);
        let (_, jacobian) = camera.project_with_jacobian(&point).unwrap();
        let numeric = numeric_jacobian(|p| camera.project(p).unwrap(), &point, 1e-6);
        assert_close(&jacobian, &numeric, 1e-6, "bending");
    }
}

#[test]
fn a_pinhole_that_turned_out_to_bend_is_written_as_what_it_is() {
    let nominal = Camera::new(CameraParameters {
        model: CameraModel::Pinhole,
        width: 752,
        height: 480,
        fx: 600.0,
        fy: 600.0,
        cx: 375.5,
        cy: 239.5,
        distortion: Vec::new(),
    })
    .unwrap();
    let bending = CameraCorrection { focal: -0.24, center_x: -0.014, center_y: 0.015, k1: -0.28, k2: 0.07 };
    let found = nominal.with_correction(bending);
    let written = Camera::new(found.corrected_parameters()).unwrap();
    assert_eq!(written.parameters().model, CameraModel::Radtan);
    for pixel in pixels(&nominal) {
        let error = (found.unproject(&pixel).unwrap() - written.unproject(&pixel).unwrap()).norm();
        assert!(error < 1e-9, "{pixel}: {error:e}");
    }
}

#[test]
fn a_correction_means_the_same_at_every_size() {
    for nominal in all_cameras() {
        let (one, other) = (
            nominal.with_correction(CORRECTION).scaled(0.5, 0.5),
            nominal.scaled(0.5, 0.5).with_correction(CORRECTION),
        );
        assert_eq!(one, other);
        let bearing = Vector3::new(0.1, 0.05, 1.0);
        let full = nominal.with_correction(CORRECTION).project(&bearing).unwrap();
        let half = one.project(&bearing).unwrap();
        assert!(((full.add_scalar(0.5)) * 0.5 - half.add_scalar(0.5)).norm() < 1e-9);
    }
}

#[test]
fn rays_go_there_and_back() {
    let ray = Vector3::new(0.3, -0.4, 1.2);
    let there = CORRECTION.nominal_from_corrected() * ray;
    assert!((CORRECTION.corrected_from_nominal() * there - ray).norm() < 1e-15);
    assert!(CameraCorrection::default().is_none() && !CORRECTION.is_none());
}
