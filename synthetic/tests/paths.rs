//! Paths stay clear of the walls, within their limits, and smooth; point clouds are as noisy as asked for.

use geometry::{Camera, CameraModel, CameraParameters, so3};
use nalgebra::{Vector2, Vector3};
use synthetic::{
    MotionLimits, Path, PathConfig, PathKind, PointCloudConfig, PointCloudWorld, Preset, SequenceConfig,
};

#[test]
fn paths_of_presets_keep_clear_and_within_limits() {
    for preset in Preset::ALL {
        for seed in [1, 2] {
            let config = SequenceConfig::preset(preset, seed);
            let world = config.world.build();
            let path = Path::new(&config.path);
            let dt = 0.02;
            let n = (path.duration_s() / dt) as usize;
            let name = preset.name();
            for i in 0..n {
                let (now, next) =
                    (path.camera_from_world(i as f64 * dt), path.camera_from_world((i + 1) as f64 * dt));
                let speed = (next.center() - now.center()).norm() / dt;
                let rotation_deg = so3::angle_between(&now.rotation, &next.rotation).to_degrees() / dt;
                assert!(speed < 1.001 * config.path.limits.speed, "{name}: {speed}");
                assert!(rotation_deg < 1.001 * config.path.limits.rotation_deg, "{name}: {rotation_deg}");
                if i % 25 == 0 {
                    let clearance = world.clearance(&now.center());
                    assert!(clearance > 0.25, "{name}, seed {seed}, {} s: {clearance}", i as f64 * dt);
                }
            }
        }
    }
}

#[test]
fn acceleration_is_continuous() {
    let config = SequenceConfig::preset(Preset::CorridorRing, 1);
    let path = Path::new(&config.path);
    let h = 1e-3;
    let acceleration = |t: f64| {
        let at = |t| path.camera_from_world(t).center();
        (at(t + h) - 2.0 * at(t) + at(t - h)) / (h * h)
    };
    // Across the knots of the spline, every quarter of a second, where its third derivative jumps.
    for k in 4..120 {
        let knot = f64::from(k) * 0.25;
        let jump = (acceleration(knot + 2.0 * h) - acceleration(knot - 2.0 * h)).norm();
        assert!(jump < 0.2, "the acceleration jumps by {jump} at {knot} s");
    }
}

#[test]
fn orbits_begin_with_sideways_motion() {
    for preset in [Preset::RoomRich, Preset::RoomPoor, Preset::Atlanta, Preset::Unstructured] {
        let path = Path::new(&SequenceConfig::preset(preset, 1).path);
        let (start, later) = (path.camera_from_world(0.0), path.camera_from_world(1.5));
        let moved = start.transform(&later.center());
        assert!(moved.x.abs() > 0.3, "{}: moved {moved:?}", preset.name());
        assert!(moved.x.abs() > 2.0 * moved.z.abs(), "{}: moved {moved:?}", preset.name());
    }
}

#[test]
fn lawnmowers_cover_their_rectangle() {
    let kind = PathKind::Lawnmower {
        low: Vector2::new(-1.0, -1.0),
        high: Vector2::new(1.0, 1.0),
        spacing: 0.5,
        height: 1.4,
        yaw_deg: 90.0,
    };
    let path = Path::new(&PathConfig { kind, limits: MotionLimits::default(), jitter: None, seed: 1 });
    let positions: Vec<Vector3<f64>> = (0..=(path.duration_s() * 10.0) as usize)
        .map(|i| path.camera_from_world(0.1 * i as f64).center())
        .collect();
    for strip in -2..=2 {
        for x in [-0.9, 0.0, 0.9] {
            let target = Vector3::new(x, 0.5 * f64::from(strip), 1.4);
            let nearest = positions.iter().map(|p| (p - target).norm()).fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.1, "{target:?} is missed by {nearest}");
        }
    }
    let ahead = path.camera_from_world(3.0).rotation.inverse() * Vector3::z();
    assert!((ahead - Vector3::y()).norm() < 1e-9, "it looks towards +y");
}

#[test]
fn point_clouds_are_as_noisy_as_asked_for() {
    let camera = Camera::new(CameraParameters {
        model: CameraModel::Pinhole,
        width: 640,
        height: 480,
        fx: 460.0,
        fy: 460.0,
        cx: 319.5,
        cy: 239.5,
        distortion: Vec::new(),
    })
    .expect("the camera is valid");
    let config =
        PointCloudConfig { noise_px: 0.8, outlier_share: 0.1, seed: 9, ..PointCloudConfig::default() };
    let world = PointCloudWorld::new(&config, &camera);
    assert_eq!(world.observations, PointCloudWorld::new(&config, &camera).observations);
    let (mut squares, mut n_inliers) = (0.0, 0.0);
    for seen in world.observations.iter().filter(|seen| !seen.is_outlier) {
        let truth =
            camera.project(&world.cameras_from_world[seen.camera].transform(&world.points[seen.point]));
        squares += (seen.pixel - truth.expect("observed points are in front")).norm_squared();
        n_inliers += 1.0;
    }
    let sigma = (squares / (2.0 * n_inliers)).sqrt();
    assert!((sigma - 0.8).abs() < 0.05, "sigma {sigma}");
    let outlier_share = 1.0 - n_inliers / world.observations.len() as f64;
    assert!((outlier_share - 0.1).abs() < 0.03, "{outlier_share}");
    assert!(world.observations.len() > 3000, "{} observations", world.observations.len());
}
