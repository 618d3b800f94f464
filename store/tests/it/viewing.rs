//! What viewers read: frames with and without a pose, chosen landmarks, and what a keyframe measured.

use crate::world::*;
use futures_util::TryStreamExt;
use slam::map::{FrameState, MapChanges, RemovedKeyframe};
use slam::{Map, MapUpdate};
use std::collections::BTreeSet;
use std::sync::Arc;
use store::{FrameEntry, KeyframeImage, Store, StoreError};

async fn all_frames(store: &Store) -> Vec<FrameEntry> {
    store.frames("s").await.unwrap().try_collect().await.unwrap()
}

async fn frames_are_told_with_the_keyframe_that_moves_them(home: Home) {
    let store = home.store_with_session().await;
    let mut world = parts(31, SMALL);
    // Keyframe 6, the last of the chain, was removed and hangs on 5.
    let pose = |id: usize| world.keyframes[id - 1].camera_from_world;
    let camera_from_anchor = pose(6) * pose(5).inverse();
    let points: Vec<_> = world.points.iter().filter(|point| point.observation_in(kf(6)).is_some()).collect();
    let points: Vec<_> = points.into_iter().map(|point| point.id).collect();
    points.into_iter().for_each(|id| remove_point(&mut world, id));
    world.keyframes.pop();
    world.removed_keyframes.push(RemovedKeyframe { id: kf(6), anchor: kf(5), camera_from_anchor });

    // More than one step of reading, a lost frame in the middle.
    let n_frames = 1100;
    let mut frames: Vec<_> = (0..n_frames).map(|sequence| frame(sequence, kf(1 + sequence % 6))).collect();
    frames[600] = lost_frame(600);
    let changes = MapChanges { removed_keyframes: [kf(6)].into(), ..all_new(&world) };
    let map: Arc<Map> = map(&world);
    store
        .save_update("s", &MapUpdate { map: map.clone(), changes, frames: frames.clone() }, TRACKED, &[])
        .await
        .unwrap();

    let found = all_frames(&store).await;
    assert_eq!(found.len() as u64, n_frames);
    for (entry, record) in found.iter().zip(&frames) {
        assert_eq!(
            (entry.sequence, entry.timestamp_ns, entry.state, &entry.reason),
            (record.sequence, record.timestamp_ns, record.state, &record.reason)
        );
        let Some(pose) = record.pose else {
            assert_eq!((&entry.place, entry.state), (&None, FrameState::Lost));
            continue;
        };
        let place = entry.place.clone().unwrap();
        let (submap, camera_from_world) = map.locate(&pose).unwrap();
        assert_eq!((place.submap, place.world_from_camera), (submap, camera_from_world.inverse()));
        let way = if pose.reference == kf(6) { vec![kf(6), kf(5)] } else { vec![pose.reference] };
        assert_eq!(place.way, way);
    }
    assert!(matches!(store.frames("nobody").await, Err(StoreError::SessionNotFound { .. })));
}

async fn chosen_landmarks_are_read_and_others_are_not(home: Home) {
    let store = home.store_with_session().await;
    let world = structured(7, SMALL);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    let wanted: BTreeSet<_> = [pt(3), pt(17), pt(999_999)].into();
    let points: Vec<_> = store.points_of("s", &wanted).await.unwrap().try_collect().await.unwrap();
    assert_eq!(points, [world.points[2].clone(), world.points[16].clone()]);
    let lines: Vec<_> = store.lines_of("s", &[ln(4)].into()).await.unwrap().try_collect().await.unwrap();
    assert_eq!(lines, [world.lines[3].clone()]);
    let none: Vec<_> = store.points_of("s", &BTreeSet::new()).await.unwrap().try_collect().await.unwrap();
    assert!(none.is_empty());
}

async fn a_keyframe_tells_what_it_measured_and_what_sees_it(home: Home) {
    let store = home.store_with_session().await;
    let world = structured(7, SMALL);
    let image = |id| KeyframeImage { keyframe: kf(id), media_type: "image/png".into(), bytes: vec![1] };
    assert_eq!(store.newest_image("s").await.unwrap(), None);
    store.save_update("s", &first_update(&world), TRACKED, &[image(2), image(5)]).await.unwrap();
    assert_eq!(store.newest_image("s").await.unwrap(), Some(kf(5)));

    let keyframe = &world.keyframes[1];
    let measured = store.measured_keyframe("s", kf(2)).await.unwrap().unwrap();
    let pixels: Vec<[f32; 2]> =
        keyframe.features.keypoints.iter().map(|keypoint| [keypoint.x, keypoint.y]).collect();
    assert_eq!(measured.keypoints, pixels);
    assert_eq!(store.keypoints("s", kf(2)).await.unwrap(), Some(pixels));
    assert_eq!(measured.segments, keyframe.features.lines);
    assert_eq!((&measured.points, &measured.lines), (&keyframe.points, &keyframe.lines));
    assert_eq!(measured.vanishing, keyframe.vanishing);
    assert!(measured.points.iter().any(Option::is_some) && measured.lines.iter().any(Option::is_some));
    assert!(measured.vanishing.iter().any(|seen| seen.primitive.is_some()));
    assert!(store.measured_keyframe("s", kf(77)).await.unwrap().is_none());
}

on_either_engine! {
    frames_are_told_with_the_keyframe_that_moves_them,
    chosen_landmarks_are_read_and_others_are_not,
    a_keyframe_tells_what_it_measured_and_what_sees_it,
}
