use crate::world::*;
use futures_util::TryStreamExt;
use slam::MapUpdate;
use slam::map::{FrameRecord, FrameState, MapChanges, MapParts, RemovedKeyframe, SubmapId};
use store::{Store, StoreError, SubmapChoice, TrajectoryFilter, TrajectoryKind, TrajectoryPose};

async fn trajectory(store: &Store, kind: TrajectoryKind, filter: TrajectoryFilter) -> Vec<TrajectoryPose> {
    store.trajectory("s", kind, filter).await.unwrap().try_collect().await.unwrap()
}

/// Keyframes 3 and 4 of six were removed: 4 hung on 3, and 3 hangs on 2.
fn with_removed_keyframes(seed: u64) -> MapParts {
    let mut world = parts(seed, SMALL);
    let pose_of = |world: &MapParts, id: u64| world.keyframes[id as usize - 1].camera_from_world;
    for (id, anchor) in [(4, 3), (3, 2)] {
        let camera_from_anchor = pose_of(&world, id) * pose_of(&world, anchor).inverse();
        world
            .removed_keyframes
            .insert(0, RemovedKeyframe { id: kf(id), anchor: kf(anchor), camera_from_anchor });
    }
    let points: Vec<_> = world
        .points
        .iter()
        .filter(|point| point.observations.iter().any(|seen| [kf(3), kf(4)].contains(&seen.keyframe)))
        .map(|point| point.id)
        .collect();
    points.into_iter().for_each(|id| remove_point(&mut world, id));
    world.keyframes.retain(|keyframe| ![kf(3), kf(4)].contains(&keyframe.id));
    world.keyframes[2].parent = Some(kf(2));
    world
}

fn changes_of(world: &MapParts) -> MapChanges {
    let removed_keyframes = world.removed_keyframes.iter().map(|removed| removed.id).collect();
    MapChanges { removed_keyframes, ..all_new(world) }
}

async fn frames_keep_their_place_through_removed_key_frames(home: Home) {
    let store = home.store_with_session().await;
    let mut world = with_removed_keyframes(31);
    let references: [u64; 5] = [1, 4, 3, 2, 4];
    let mut frames: Vec<FrameRecord> =
        (10..).zip(references).map(|(sequence, reference)| frame(sequence, kf(reference))).collect();
    frames.insert(2, FrameRecord { sequence: 9, timestamp_ns: 1, ..lost_frame(0) });
    let update = MapUpdate { map: map(&world), changes: changes_of(&world), frames: frames.clone() };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    // The map is corrected: the frames move with it though they are not written again.
    for corrected in [false, true] {
        if corrected {
            world.keyframes.iter_mut().for_each(|keyframe| {
                // A correction may change the scale of a part of the map.
                (keyframe.camera_from_world, keyframe.local_scale) = (Numbers(5).pose(), 1.25);
            });
            let keyframes = world.keyframes.iter().map(|keyframe| keyframe.id).collect();
            let changes = MapChanges { keyframes, ..MapChanges::default() };
            let update = MapUpdate { map: map(&world), changes, frames: vec![] };
            store.save_update("s", &update, TRACKED, &[]).await.unwrap();
        }
        let expected_map = map(&world);
        let found = trajectory(&store, TrajectoryKind::Frames, TrajectoryFilter::default()).await;
        assert_eq!(found.iter().map(|pose| pose.sequence).collect::<Vec<_>>(), [10, 11, 12, 13, 14]);
        for pose in &found {
            let record = frames.iter().find(|frame| frame.sequence == pose.sequence).unwrap();
            let frame_pose = record.pose.unwrap();
            let (submap, camera_from_world) = expected_map.locate(&frame_pose).unwrap();
            assert_eq!(pose.submap, submap);
            assert_eq!(pose.world_from_camera, camera_from_world.inverse());
            assert_eq!((pose.timestamp_ns, pose.reference), (record.timestamp_ns, frame_pose.reference));
            let stored = store.frame("s", pose.sequence).await.unwrap().unwrap();
            assert_eq!(stored.world_from_camera, Some((pose.submap, pose.world_from_camera)));
        }
    }
    let lost = store.frame("s", 9).await.unwrap().unwrap();
    assert_eq!((lost.state, lost.world_from_camera), (FrameState::Lost, None));
    assert_eq!(store.frame("s", 8).await.unwrap(), None);
}

async fn key_frames_make_a_trajectory_of_their_own(home: Home) {
    let store = home.store_with_session().await;
    let world = with_removed_keyframes(32);
    let update = MapUpdate { map: map(&world), changes: changes_of(&world), frames: vec![frame(100, kf(1))] };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    let found = trajectory(&store, TrajectoryKind::Keyframes, TrajectoryFilter::default()).await;
    assert_eq!(found.len(), 4);
    for (pose, keyframe) in found.iter().zip(&world.keyframes) {
        assert_eq!((pose.reference, pose.sequence), (keyframe.id, keyframe.sequence));
        assert_eq!(pose.world_from_camera, keyframe.camera_from_world.inverse());
        assert_eq!((pose.state, pose.backfilled), (FrameState::Tracked, false));
    }
}

async fn a_trajectory_can_be_cut_by_time_and_submap(home: Home) {
    let store = home.store_with_session().await;
    let mut frames: Vec<_> = (1..=1500).map(|sequence| frame(sequence, kf(1 + sequence % 6))).collect();
    frames.iter_mut().skip(1000).for_each(|frame| frame.pose.as_mut().unwrap().submap = SubmapId(1));
    let world = parts(33, SMALL);
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames: frames.clone() };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    let sequences = |poses: Vec<TrajectoryPose>| poses.iter().map(|pose| pose.sequence).collect::<Vec<_>>();
    let all = trajectory(&store, TrajectoryKind::Frames, TrajectoryFilter::default()).await;
    assert_eq!(sequences(all), (1..=1500).collect::<Vec<_>>());
    let time = |sequence: usize| Some(frames[sequence - 1].timestamp_ns);
    let filter = TrajectoryFilter {
        from_timestamp_ns: time(40),
        to_timestamp_ns: time(1100),
        submaps: SubmapChoice::One(SubmapId(1)),
    };
    // Its keyframes became part of submap 0.
    assert_eq!(trajectory(&store, TrajectoryKind::Frames, filter).await, []);
    let filter = TrajectoryFilter { submaps: SubmapChoice::One(SubmapId(0)), ..filter };
    let part = trajectory(&store, TrajectoryKind::Frames, filter).await;
    assert_eq!(sequences(part), (40..=1100).collect::<Vec<_>>());
    let filter = TrajectoryFilter { submaps: SubmapChoice::Largest, ..filter };
    let part = trajectory(&store, TrajectoryKind::Frames, filter).await;
    assert_eq!(sequences(part), (40..=1100).collect::<Vec<_>>());
}

async fn frames_of_a_dropped_submap_are_left_out_and_later_frames_do_not_appear(home: Home) {
    let store = home.store_with_session().await;
    let world = parts(34, SMALL);
    let frames = vec![frame(1, kf(1)), frame(2, kf(40)), frame(3, kf(2))];
    let update = MapUpdate { map: map(&world), changes: all_new(&world), frames };
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();

    let mut stream =
        store.trajectory("s", TrajectoryKind::Frames, TrajectoryFilter::default()).await.unwrap();
    let later = MapUpdate { map: map(&world), changes: MapChanges::default(), frames: vec![frame(4, kf(1))] };
    store.save_update("s", &later, TRACKED, &[]).await.unwrap();
    let mut sequences = Vec::new();
    while let Some(pose) = stream.try_next().await.unwrap() {
        sequences.push(pose.sequence);
    }
    assert_eq!(sequences, [1, 3]);
    let missing: Result<_, StoreError> =
        store.trajectory("x", TrajectoryKind::Frames, TrajectoryFilter::default()).await.map(drop);
    assert!(matches!(missing, Err(StoreError::SessionNotFound { .. })));
}

on_either_engine! {
    frames_keep_their_place_through_removed_key_frames,
    key_frames_make_a_trajectory_of_their_own,
    a_trajectory_can_be_cut_by_time_and_submap,
    frames_of_a_dropped_submap_are_left_out_and_later_frames_do_not_appear,
}
