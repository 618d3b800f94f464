//! A map that cameras of different lenses have made.

use crate::api::Api;
use geometry::{Camera, CameraModel, CameraParameters};
use serde_json::json;
use server::{Config, open_store};
use slam::SlamConfig;
use slam::features::FrameFeatures;
use slam::map::{CameraId, MapCamera};
use std::sync::Arc;
use store::{KeyframeImage, NewSession};
use testkit::stored::{TRACKED, new_session};
use testkit::world::{SMALL, first_update, kf, structured};

/// The map of `s`, whose second keyframe the camera of `b` took, by another lens.
async fn map_of_two_lenses() -> Api {
    let (fx, fy, cx, cy) = (500.0, 501.0, 319.5, 239.5);
    let (model, distortion) = (CameraModel::Pinhole, Vec::new());
    let lens = CameraParameters { model, width: 640, height: 480, fx, fy, cx, cy, distortion };
    let mut world = structured(7, SMALL);
    let second = &mut world.keyframes[1];
    second.camera = MapCamera { id: CameraId(1), is_refined: false };
    let (keypoints, descriptors) = (second.features.keypoints.clone(), second.features.descriptors.clone());
    let working = SlamConfig::default().working_camera(&Camera::new(lens.clone()).unwrap());
    let features = FrameFeatures::from_parts(keypoints, descriptors, &working, second.features.pyramid);
    second.features = Arc::new(features.unwrap().with_lines(second.features.nominal_lines().to_vec()));

    let folder = tempfile::tempdir().unwrap();
    let store = open_store(&Config::local(folder.path())).await.unwrap();
    store.create_session(&new_session("s")).await.unwrap();
    let added = NewSession { camera: lens, map: Some("s".to_owned()), ..new_session("b") };
    store.create_session(&added).await.unwrap();
    let image = |keyframe| KeyframeImage { keyframe, media_type: "image/png".to_owned(), bytes: vec![0] };
    store.save_update("s", &first_update(&world), TRACKED, &[image(kf(1)), image(kf(2))]).await.unwrap();
    store.close().await.unwrap();
    Api::over(folder, world).await
}

#[tokio::test]
async fn exports_have_each_image_with_its_own_camera() {
    let api = map_of_two_lenses().await;
    let cameras = api.text("/map?format=colmap&part=cameras").await;
    let rows: Vec<&str> = cameras.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!(rows.len(), 2, "{cameras}");
    assert!(rows[0].starts_with("1 "), "{cameras}");
    assert_eq!(rows[1], "2 PINHOLE 640 480 500 501 320 240");
    let images = api.text("/map?format=colmap&part=images").await;
    let of = images.lines().filter(|line| line.contains("keyframe_"));
    let of: Vec<&str> = of.map(|line| line.split(' ').nth(8).unwrap()).collect();
    assert_eq!(of[..3], ["1", "2", "1"], "{images}");

    let transforms = api.json("/map?format=transforms").await;
    assert_eq!(
        (&transforms["frames"][0]["fl_x"], &transforms["frames"][1]["fl_x"]),
        (&json!(null), &json!(500.0))
    );
    assert_eq!(transforms["frames"][1]["w"], 640);
}

#[tokio::test]
async fn what_a_keyframe_shows_is_told_in_the_pixels_of_its_own_camera() {
    let api = map_of_two_lenses().await;
    for (keyframe, size) in [(1, [752, 480]), (2, [640, 480])] {
        let observed = api.json(&format!("/keyframes/{keyframe}/observed")).await;
        assert_eq!(
            (&observed["width"], &observed["height"]),
            (&json!(size[0]), &json!(size[1])),
            "{keyframe}"
        );
    }
}
