use crate::world::*;
use futures_util::TryStreamExt;
use geometry::CameraParameters;
use slam::map::{CameraId, FrameRecord, FrameState, MapCamera, MapParts};
use slam::{MapUpdate, SlamConfig};
use store::{NewSession, Store, StoreError, TrajectoryFilter, TrajectoryKind};

/// A session whose camera extends the map of `s`.
fn added(id: &str, camera: CameraParameters) -> NewSession {
    NewSession { map: Some("s".to_owned()), camera, ..new_session(id) }
}

fn of_camera(camera: u32, frame: FrameRecord) -> FrameRecord {
    FrameRecord { camera: CameraId(camera), ..frame }
}

/// The first keyframe is of the map's own camera, the second of the first that was added.
fn of_two_cameras(seed: u64, is_refined: bool) -> MapParts {
    let mut parts = structured(seed, SMALL);
    parts.keyframes[1].camera = MapCamera { id: CameraId(1), is_refined };
    parts
}

async fn poses(store: &Store, id: &str, kind: TrajectoryKind) -> Vec<u64> {
    let poses = store.trajectory(id, kind, TrajectoryFilter::default()).await.unwrap();
    let poses: Vec<_> = poses.try_collect().await.unwrap();
    poses.iter().map(|pose| pose.sequence).collect()
}

async fn two_sessions_share_a_map_and_keep_their_frames(home: Home) {
    let store = home.store_with_session().await;
    let made = store.create_session(&added("b", camera())).await.unwrap();
    assert_eq!((made.map.as_deref(), made.camera_id), (Some("s"), CameraId(1)));
    assert_eq!(store.cameras_of("s").await.unwrap(), ["b"]);

    let world = of_two_cameras(81, true);
    let frames = vec![
        frame(500, kf(1)),
        of_camera(1, frame(22, kf(2))),
        of_camera(1, lost_frame(23)),
        // Of a session that is no more.
        of_camera(7, frame(4, kf(1))),
    ];
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);

    let (own, other) = (store.get_session("s").await.unwrap(), store.get_session("b").await.unwrap());
    assert_eq!(own.last_frame.map(|(sequence, _)| sequence), Some(500));
    assert_eq!(other.last_frame.map(|(sequence, _)| sequence), Some(23));
    assert_eq!((own.state, other.state), (FrameState::Tracked, FrameState::Lost));
    assert_eq!((own.counts.n_frames, other.counts.n_frames), (1, 2));
    assert!(own.counts.n_keyframes > 0 && other.counts.n_keyframes == own.counts.n_keyframes);
    assert_eq!(poses(&store, "s", TrajectoryKind::Frames).await, [500]);
    assert_eq!(poses(&store, "b", TrajectoryKind::Frames).await, [22]);
    let keyframes_of = |id: &'static str| poses(&store, id, TrajectoryKind::Keyframes);
    assert_eq!(keyframes_of("b").await, [world.keyframes[1].sequence]);
    assert_eq!(keyframes_of("s").await.len() as u64, own.counts.n_keyframes - 1);
    // The map is the same, whoever is asked.
    for id in ["s", "b"] {
        let keyframes = store.keyframes(id, None, 100).await.unwrap();
        assert_eq!(keyframes.items.len() as u64, own.counts.n_keyframes);
        let points = store.points_page(id, &store::PointQuery::default(), None, 1000).await.unwrap();
        assert_eq!(points.items.len() as u64, own.counts.n_points);
    }
    assert_same_parts(&load(&store).await, &world);
    let loaded = store.load_camera("b").await.unwrap();
    assert_eq!(loaded.join.last_frame.map(|(sequence, _)| sequence), Some(23));
}

async fn a_map_stays_while_cameras_extend_it(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&added("b", camera())).await.unwrap();
    let refused = store.delete_session("s").await.unwrap_err();
    assert!(matches!(refused, StoreError::MapInUse { .. }), "{refused}");
    assert_eq!(
        refused.to_string(),
        r#"session "b" has its camera extend the map of session "s"; delete that one first"#
    );
    let world = of_two_cameras(82, true);
    let frames = vec![of_camera(1, frame(2, kf(2)))];
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    // What it has put into the map stays there, and its number is not given again.
    store.delete_session("b").await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    assert_same_parts(&load(&store).await, &world);
    assert_eq!(load(&store).await.keyframes[1].camera.id, CameraId(1));
    assert_eq!(store.create_session(&added("b", camera())).await.unwrap().camera_id, CameraId(2));
    store.delete_session("b").await.unwrap();
    store.delete_session("s").await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
}

async fn only_a_session_with_a_map_of_its_own_is_extended(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&added("b", camera())).await.unwrap();
    for map in ["b", "nowhere"] {
        let new = NewSession { map: Some(map.to_owned()), ..new_session("c") };
        let refused = store.create_session(&new).await.unwrap_err();
        assert!(matches!(refused, StoreError::SessionNotFound { .. }), "{refused}");
    }
    assert!(matches!(
        store.create_session(&added("b", camera())).await.unwrap_err(),
        StoreError::SessionExists { .. }
    ));
}

async fn a_camera_of_another_calibration_keeps_its_own(home: Home) {
    let store = home.store_with_session().await;
    let another = CameraParameters { fx: camera().fx * 1.1, ..camera() };
    store.create_session(&added("b", another.clone())).await.unwrap();
    let mut world = of_two_cameras(83, false);
    let lens = SlamConfig::default().working_camera(&geometry::Camera::new(another.clone()).unwrap());
    let seen = &world.keyframes[1].features;
    let features = slam::features::FrameFeatures::from_parts(
        seen.keypoints.clone(),
        seen.descriptors.clone(),
        &lens,
        seen.pyramid,
    );
    let features = features.unwrap().with_lines(seen.nominal_lines().to_vec());
    world.keyframes[1].features = std::sync::Arc::new(features);
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    let again = load(&store).await;
    assert!(!again.keyframes[1].camera.is_refined && again.keyframes[0].camera.is_refined);
    assert_eq!(again.keyframes[1].features.pinhole, lens.nominal_pinhole());
    assert_same_parts(&again, &world);
    let of_second = world.keyframes[1].id;
    assert_eq!(store.added_camera_of("b", of_second).await.unwrap(), Some(another));
    assert_eq!(store.added_camera_of("s", world.keyframes[0].id).await.unwrap(), None);
}

async fn a_map_of_several_cameras_is_copied(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&added("b", camera())).await.unwrap();
    let world = of_two_cameras(84, true);
    let frames = vec![frame(5, kf(1)), of_camera(1, frame(2, kf(2)))];
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let copy = Store::open(folder.path().join("copy.db"), store::StoreOptions::default()).await.unwrap();
    for id in ["b", "s"] {
        copy.copy_session(&store, id).await.unwrap();
        assert_eq!(copy.digest(id).await.unwrap(), store.digest(id).await.unwrap());
    }
    assert_eq!(copy.check().await.unwrap(), []);
    assert_eq!(poses(&copy, "b", TrajectoryKind::Frames).await, [2]);
    assert_same_parts(&load(&copy).await, &world);
}

on_either_engine!(
    two_sessions_share_a_map_and_keep_their_frames,
    a_map_stays_while_cameras_extend_it,
    only_a_session_with_a_map_of_its_own_is_extended,
    a_camera_of_another_calibration_keeps_its_own,
    a_map_of_several_cameras_is_copied,
);
