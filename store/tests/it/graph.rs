use crate::world::*;
use std::collections::BTreeMap;
use store::SharedLandmarks;

async fn a_snapshot_gives_the_whole_map_as_of_its_commit(home: Home) {
    let store = home.store_with_session().await;
    let world = structured(91, Size { n_keyframes: 12, n_keypoints: 500, n_points: 1200 });
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    let mut snapshot = store.snapshot("s").await.unwrap();
    // What is stored meanwhile is not seen.
    store.save_update("s", &first_update(&structured(92, SMALL)), TRACKED, &[]).await.unwrap();

    assert_eq!(snapshot.record().counts.n_points, 1200);
    assert_eq!(snapshot.n_landmarks(None).await.unwrap(), (1200, 25));
    assert_eq!(snapshot.n_landmarks(Some(slam::map::SubmapId(3))).await.unwrap(), (0, 0));
    let mut points = Vec::new();
    loop {
        let step = snapshot
            .points_after(points.last().map(|p: &slam::map::PointLandmark| p.id), None)
            .await
            .unwrap();
        if step.is_empty() {
            break;
        }
        points.extend(step);
    }
    assert_eq!(points, world.points);
    assert_eq!(snapshot.lines_after(None, None).await.unwrap(), world.lines);
    assert_eq!(snapshot.lines_after(Some(ln(25)), None).await.unwrap(), []);
    assert_eq!(snapshot.primitives().await.unwrap(), world.primitives);
    let keyframes = snapshot.keyframes_after(Some(kf(2))).await.unwrap();
    assert_eq!((keyframes.len(), keyframes[0].id, keyframes[0].n_segments), (10, kf(3), 30));
    assert_eq!(keyframes[0].n_lines as usize, world.keyframes[2].observed_lines().count());
    let positions = snapshot.keypoints(kf(3)).await.unwrap();
    let expected: Vec<_> = world.keyframes[2].features.keypoints.iter().map(|k| [k.x, k.y]).collect();
    assert_eq!(positions, expected);
}

async fn covisibility_counts_what_each_pair_of_key_frames_sees(home: Home) {
    let store = home.store_with_session().await;
    let world = structured(93, SMALL);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    let found = store.snapshot("s").await.unwrap().covisibility().await.unwrap();

    let mut expected = BTreeMap::new();
    for a in &world.keyframes {
        for b in world.keyframes.iter().filter(|b| b.id > a.id) {
            let n_points = a.observed_points().filter(|(_, id)| b.points.contains(&Some(*id))).count() as u32;
            let n_lines = a.observed_lines().filter(|(_, id)| b.lines.contains(&Some(*id))).count() as u32;
            if n_points + n_lines > 0 {
                expected.insert((a.id, b.id), SharedLandmarks { n_points, n_lines });
            }
        }
    }
    assert_eq!(found, expected);
    assert!(found.values().any(|shared| shared.n_lines > 0));
}

on_either_engine! {
    a_snapshot_gives_the_whole_map_as_of_its_commit,
    covisibility_counts_what_each_pair_of_key_frames_sees,
}
