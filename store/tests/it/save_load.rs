use crate::world::*;
use geometry::{CameraCorrection, Pose};
use nalgebra::Vector3;
use slam::config::SlamConfig;
use slam::map::{FrameState, LastIds, MapChanges, MapParts, Readout, RemovedKeyframe, SubmapId};
use slam::{Keyframe, Map, MapUpdate, NoClock, Pipeline};
use std::sync::Arc;
use store::{KeyframeImage, SessionCounts, StoreError};

async fn a_saved_map_comes_back_bit_for_bit(home: Home) {
    let store = home.store_with_session().await;
    let mut saved = structured(11, SMALL);
    saved.points[3].distance_range.1 = f64::INFINITY;
    saved.last_ids = LastIds { point: 1000, line: 2000, primitive: 3000, ..saved.last_ids };
    let committed = store.save_update("s", &first_update(&saved), TRACKED, &[]).await.unwrap();
    let counts = SessionCounts {
        n_frames: 20,
        n_keyframes: 6,
        n_points: 60,
        n_lines: 25,
        n_primitives: 4,
        n_submaps: 1,
    };
    assert_eq!((committed.last_sequence, committed.counts), (Some(20), counts));

    // Opened again, so that nothing comes from memory.
    store.close().await.unwrap();
    let store = home.open().await;
    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap();
    assert_eq!(loaded.record.counts, counts);
    assert_eq!(loaded.record.state, FrameState::Tracked);
    assert_eq!(loaded.resume.last_frame, Some((20, 20 * 50_000_000)));
    assert_same_parts(&loaded.resume.map, &saved);
    assert_eq!(store.check().await.unwrap(), []);

    let camera = loaded.record.checked_camera().unwrap();
    let config = SlamConfig { threading: slam::Threading::Inline, ..SlamConfig::default() };
    let pipeline = Pipeline::resume(config, camera, Arc::new(NoClock), loaded.resume).unwrap();
    let resumed = pipeline.map();
    assert_eq!((resumed.n_points(), resumed.n_lines(), resumed.n_primitives()), (60, 25, 4));
    assert_same_parts(&resumed.to_parts(), &saved);
}

async fn a_camera_that_was_put_right_comes_back(home: Home) {
    let store = home.store_with_session().await;
    let correction =
        CameraCorrection { focal: -0.013, center_x: 0.002, center_y: 0.1 + 0.2, k1: -0.03, k2: 0.001 };
    let readout = Some(Readout { readout_ns: 16_700_001, sigma_ns: 1_200_000 });
    let saved = MapParts { correction, readout, ..parts(12, SMALL) };
    let update = first_update(&saved);
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    let record = store.get_session("s").await.unwrap();
    assert_eq!((record.correction, record.refined_camera()), (CameraCorrection::default(), None));
    assert_eq!(record.readout, None);

    let changes = MapChanges { correction: true, ..MapChanges::default() };
    let update = MapUpdate { map: update.map, changes, frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    store.close().await.unwrap();
    let store = home.open().await;
    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap();
    let given = loaded.record.checked_camera().unwrap();
    let refined = loaded.record.refined_camera().unwrap();
    assert_eq!(refined.fx, given.parameters().fx * (1.0 - 0.013));
    assert_eq!(store.check().await.unwrap(), []);

    let config = SlamConfig { threading: slam::Threading::Inline, ..SlamConfig::default() };
    let resumed = Pipeline::resume(config, given, Arc::new(NoClock), loaded.resume).unwrap().map();
    assert_eq!(resumed.correction(), correction);
    assert_eq!((loaded.record.readout, resumed.readout()), (readout, readout));
    assert_same_parts(&resumed.to_parts(), &update.map.to_parts());

    // What cannot be a camera is refused.
    let broken = CameraCorrection { focal: f64::NAN, ..correction };
    assert!(Map::from_parts(MapParts { correction: broken, ..parts(12, SMALL) }).is_err());
}

async fn features_are_written_again_only_where_they_lie_elsewhere(home: Home) {
    let store = home.store_with_session().await;
    let before = parts(12, SMALL);
    store.save_update("s", &first_update(&before), TRACKED, &[]).await.unwrap();

    let mut after = before.clone();
    for (keyframe, other) in after.keyframes.iter_mut().zip(&parts(13, SMALL).keyframes) {
        keyframe.features = other.features.clone();
    }
    let (keyframes, moved_features) = ([kf(2), kf(3)].into(), [kf(3)].into());
    let changes = MapChanges { keyframes, moved_features, ..MapChanges::default() };
    let update = MapUpdate { map: map(&after), changes, frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap().resume.map;
    let keypoints = |parts: &MapParts, idx: usize| parts.keyframes[idx].features.keypoints.clone();
    assert_ne!(keypoints(&before, 2), keypoints(&after, 2));
    assert_eq!(keypoints(&loaded, 1), keypoints(&before, 1));
    assert_eq!(keypoints(&loaded, 2), keypoints(&after, 2));
}

async fn a_session_without_a_map_comes_back_empty(home: Home) {
    let store = home.store_with_session().await;
    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap();
    assert_eq!((loaded.resume.map.keyframes.len(), loaded.resume.last_frame), (0, None));
    let frames = vec![lost_frame(0), lost_frame(4)];
    let update = MapUpdate { map: Arc::new(Map::default()), changes: MapChanges::default(), frames };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    let loaded = store.load_session("s", &SlamConfig::default()).await.unwrap();
    assert_eq!(loaded.resume.last_frame, Some((4, 200_000_000)));
}

async fn only_rows_named_in_the_changes_are_written(home: Home) {
    let store = home.store_with_session().await;
    let before = parts(12, SMALL);
    store.save_update("s", &first_update(&before), TRACKED, &[]).await.unwrap();

    // Everything moves, but the update names one keyframe and two points.
    let mut after = before.clone();
    let mut numbers = Numbers(99);
    after.keyframes.iter_mut().for_each(|keyframe| keyframe.camera_from_world = numbers.pose());
    after.points.iter_mut().for_each(|point| point.position += Vector3::new(0.5, -0.001, 4.0));
    let changes =
        MapChanges { keyframes: [kf(2)].into(), points: [pt(5), pt(60)].into(), ..MapChanges::default() };
    let update = MapUpdate { map: map(&after), changes, frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    let mut expected = before;
    expected.keyframes[1].camera_from_world = after.keyframes[1].camera_from_world;
    for idx in [4, 59] {
        expected.points[idx] = after.points[idx].clone();
    }
    assert_same_parts(&load(&store).await, &expected);
    assert_eq!(store.check().await.unwrap(), []);
}

/// The map after keyframe 3 and point 7 were removed, and what changed thereby.
fn removal(before: &slam::map::MapParts) -> (slam::map::MapParts, MapChanges) {
    let mut after = before.clone();
    let mut changes = MapChanges { removed_keyframes: [kf(3)].into(), ..MapChanges::default() };
    let pose_of = |id: u64| before.keyframes[id as usize - 1].camera_from_world;
    let camera_from_anchor = pose_of(3) * pose_of(2).inverse();
    after.removed_keyframes.push(RemovedKeyframe { id: kf(3), anchor: kf(2), camera_from_anchor });
    after.keyframes.retain(|keyframe| keyframe.id != kf(3));
    after.keyframes[2].parent = Some(kf(2));
    changes.keyframes.insert(kf(4));
    for point in &mut after.points {
        let n = point.observations.len();
        point.observations.retain(|seen| seen.keyframe != kf(3));
        if point.observations.len() < n {
            changes.points.insert(point.id);
        }
    }
    let few: Vec<_> =
        after.points.iter().filter(|point| point.observations.len() < 2).map(|point| point.id).collect();
    for id in few.into_iter().chain([pt(7)]) {
        remove_point(&mut after, id);
        changes.points.remove(&id);
        changes.removed_points.insert(id);
    }
    changes.keyframes.extend(after.keyframes.iter().map(|keyframe| keyframe.id));
    (after, changes)
}

async fn removed_key_frames_and_points_vanish(home: Home) {
    let store = home.store_with_session().await;
    let before = parts(13, SMALL);
    let image = KeyframeImage { keyframe: kf(3), media_type: "image/png".into(), bytes: vec![1, 2, 3] };
    store.save_update("s", &first_update(&before), TRACKED, &[image]).await.unwrap();
    assert!(store.keyframe_image("s", kf(3)).await.unwrap().is_some());

    let (after, changes) = removal(&before);
    let update = MapUpdate { map: map(&after), changes, frames: vec![] };
    let committed = store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    assert_eq!(committed.counts.n_keyframes, 5);
    assert_eq!(committed.counts.n_points, after.points.len() as u64);
    assert_same_parts(&load(&store).await, &after);
    assert_eq!(store.keyframe_image("s", kf(3)).await.unwrap(), None);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn a_dropped_submap_takes_along_what_hung_on_it(home: Home) {
    let store = home.store_with_session().await;
    let before = parts(14, SMALL);
    store.save_update("s", &first_update(&before), TRACKED, &[]).await.unwrap();
    let (removed, changes) = removal(&before);
    let update = MapUpdate { map: map(&removed), changes, frames: vec![] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    // The whole submap goes, and the record of keyframe 3 with it, though only keyframes in the map are
    // named.
    let changes = MapChanges {
        removed_keyframes: removed.keyframes.iter().map(|keyframe| keyframe.id).collect(),
        removed_points: removed.points.iter().map(|point| point.id).collect(),
        ..MapChanges::default()
    };
    let empty = slam::map::MapParts {
        last_ids: LastIds { keyframe: 6, point: 60, ..LastIds::default() },
        ..Default::default()
    };
    store
        .save_update("s", &MapUpdate { map: map(&empty), changes, frames: vec![] }, TRACKED, &[])
        .await
        .unwrap();
    assert_same_parts(&load(&store).await, &empty);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn joined_updates_store_what_single_ones_do(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&new_session("joined")).await.unwrap();
    let first = parts(15, SMALL);
    let (second, second_changes) = removal(&first);
    let mut third = second.clone();
    third.points[0].position.x += 100.0;
    third.keyframes.push(Keyframe::from_parts(
        kf(7),
        SubmapId(1),
        90,
        4_500_000_000,
        Pose::identity(),
        first.keyframes[0].features.clone(),
        None,
    ));
    third.last_ids.keyframe = 7;
    let third_changes = MapChanges {
        keyframes: [kf(7)].into(),
        points: [third.points[0].id].into(),
        ..MapChanges::default()
    };
    // The lost frame is found a place for later.
    let backfilled = slam::map::FrameRecord { backfilled: true, ..frame(22, kf(2)) };
    let updates = [
        first_update(&first),
        MapUpdate {
            map: map(&second),
            changes: second_changes,
            frames: vec![frame(21, kf(3)), lost_frame(22)],
        },
        MapUpdate { map: map(&third), changes: third_changes, frames: vec![backfilled, frame(23, kf(7))] },
    ];

    for update in &updates {
        store.save_update("s", update, TRACKED, &[]).await.unwrap();
    }
    let [mut joined, second, third_update] = updates;
    joined.merge(second);
    joined.merge(third_update);
    let committed = store.save_update("joined", &joined, TRACKED, &[]).await.unwrap();

    assert_eq!(committed.counts.n_frames, 23);
    assert_eq!(committed.counts.n_submaps, 2);
    assert_eq!(
        store.digest("s").await.unwrap().to_string(),
        store.digest("joined").await.unwrap().to_string()
    );
    assert_same_parts(&load(&store).await, &third);
    assert_eq!(store.check().await.unwrap(), []);
}

async fn equal_updates_give_equal_digests_and_any_difference_shows(home: Home) {
    let store = home.store_with_session().await;
    let mut digests = Vec::new();
    for (id, time) in [("a", 1), ("b", 2), ("c", 3)] {
        let new = store::NewSession { created_at_ns: time, ..new_session(id) };
        store.create_session(&new).await.unwrap();
        let mut saved = structured(16, SMALL);
        if id == "c" {
            let next_after = |value: &mut f64| *value = f64::from_bits(value.to_bits() + 1);
            next_after(&mut saved.points[30].position.y);
            next_after(&mut saved.lines[7].endpoints[0].z);
            next_after(&mut saved.primitives[1].covariance[(2, 0)]);
            next_after(&mut saved.keyframes[3].vanishing[2].direction.x);
        }
        store.save_update(id, &first_update(&saved), TRACKED, &[]).await.unwrap();
        digests.push(store.digest(id).await.unwrap());
    }
    assert_eq!(digests[0], digests[1]);
    let differing: Vec<_> =
        digests[0].0.iter().zip(&digests[2].0).filter(|(a, c)| a != c).map(|(a, _)| a.table).collect();
    assert_eq!(differing, ["points", "keyframe_vanishing", "lines", "primitives"]);
}

async fn a_map_is_not_taken_up_with_other_settings(home: Home) {
    let store = home.store_with_session().await;
    store.save_update("s", &first_update(&parts(17, SMALL)), TRACKED, &[]).await.unwrap();
    let narrow = SlamConfig { working_width_px: 320, ..SlamConfig::default() };
    let error = store.load_session("s", &narrow).await.unwrap_err();
    assert!(matches!(&error, StoreError::OtherSettings(_)), "{error}");
    let mut levels = SlamConfig::default();
    levels.orb.n_levels = 4;
    assert!(matches!(store.load_session("s", &levels).await, Err(StoreError::OtherSettings(_))));
}

async fn updates_that_cannot_be_stored_leave_no_trace(home: Home) {
    let store = home.store_with_session().await;
    let good = parts(18, SMALL);
    store.save_update("s", &first_update(&good), TRACKED, &[]).await.unwrap();
    let before = store.digest("s").await.unwrap();

    let mut moved = good.clone();
    moved.points[0].position.x += 1.0;
    let changes = MapChanges { points: [pt(1)].into(), ..MapChanges::default() };
    let update = |frames| MapUpdate { map: map(&moved), changes: changes.clone(), frames };
    let too_large =
        store.save_update("s", &update(vec![lost_frame(u64::MAX)]), TRACKED, &[]).await.unwrap_err();
    assert!(matches!(too_large, StoreError::OutOfRange { what: "sequence", value: u64::MAX }));
    let mut infinite = frame(30, kf(1));
    infinite.pose.as_mut().unwrap().camera_from_reference.translation.x = f64::NAN;
    let not_finite = store.save_update("s", &update(vec![infinite]), TRACKED, &[]).await.unwrap_err();
    assert!(matches!(not_finite, StoreError::NotFinite(_)));
    let mut blind = good.clone();
    blind.points[0].mean_view_direction.x = f64::NAN;
    let not_finite = MapUpdate { map: map(&blind), changes: changes.clone(), frames: vec![] };
    assert!(matches!(store.save_update("s", &not_finite, TRACKED, &[]).await, Err(StoreError::NotFinite(_))));

    assert_eq!(store.digest("s").await.unwrap(), before);
    store.save_update("s", &update(vec![frame(30, kf(1))]), TRACKED, &[]).await.unwrap();
    assert_ne!(store.digest("s").await.unwrap(), before);
}

on_either_engine! {
    a_saved_map_comes_back_bit_for_bit,
    a_camera_that_was_put_right_comes_back,
    features_are_written_again_only_where_they_lie_elsewhere,
    a_session_without_a_map_comes_back_empty,
    only_rows_named_in_the_changes_are_written,
    removed_key_frames_and_points_vanish,
    a_dropped_submap_takes_along_what_hung_on_it,
    joined_updates_store_what_single_ones_do,
    equal_updates_give_equal_digests_and_any_difference_shows,
    a_map_is_not_taken_up_with_other_settings,
    updates_that_cannot_be_stored_leave_no_trace,
}
