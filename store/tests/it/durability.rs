use crate::world::*;
use futures_util::TryStreamExt;
use slam::MapUpdate;
use slam::map::MapChanges;
use std::path::Path;
use store::{Durability, PointQuery, Store, StoreError, StoreOptions};

fn bigger(seed: u64) -> slam::map::MapParts {
    parts(seed, Size { n_keyframes: 40, n_keypoints: 300, n_points: 2000 })
}

#[tokio::test]
async fn a_full_disk_leaves_the_last_commit_and_the_update_can_be_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.create_session(&new_session("ballast")).await.unwrap();
    store.save_update("s", &first_update(&parts(41, SMALL)), TRACKED, &[]).await.unwrap();
    store.save_update("ballast", &first_update(&bigger(42)), TRACKED, &[]).await.unwrap();
    store.close().await.unwrap();
    let n_bytes = std::fs::metadata(store.path().unwrap()).unwrap().len();

    // No more room than the file takes now.
    let options = StoreOptions { max_bytes: Some(n_bytes), ..StoreOptions::default() };
    let store = Store::open(store.path().unwrap(), options).await.unwrap();
    store.create_session(&new_session("large")).await.unwrap();
    let before = (store.digest("s").await.unwrap(), store.digest("large").await.unwrap());
    let large = structured(43, Size { n_keyframes: 30, n_keypoints: 300, n_points: 1500 });
    let update = first_update(&large);
    for _ in 0..2 {
        let error = store.save_update("large", &update, TRACKED, &[]).await.unwrap_err();
        assert!(matches!(&error, StoreError::DiskFull(_)), "{error:?}");
        assert_eq!((store.digest("s").await.unwrap(), store.digest("large").await.unwrap()), before);
        assert_eq!(store.check().await.unwrap(), []);
    }
    // What fits is still stored, and deleting makes room for the rest.
    let small = MapUpdate {
        map: map(&parts(41, SMALL)),
        changes: MapChanges::default(),
        frames: vec![lost_frame(21)],
    };
    store.save_update("s", &small, TRACKED, &[]).await.unwrap();
    store.delete_session("ballast").await.unwrap();
    store.save_update("large", &update, TRACKED, &[]).await.unwrap();
    let loaded = store.load_session("large", &slam::SlamConfig::default()).await.unwrap();
    assert_same_parts(&loaded.resume.map, &large);
    assert_eq!(store.check().await.unwrap(), []);
}

#[cfg(unix)]
#[tokio::test]
async fn what_goes_into_a_file_that_is_gone_is_not_called_saved() {
    for lost in ["", "-wal"] {
        let folder = tempfile::tempdir().unwrap();
        let store = store_with_session(folder.path()).await;
        store.save_update("s", &first_update(&parts(44, SMALL)), TRACKED, &[]).await.unwrap();
        store.check_saving().unwrap();
        std::fs::remove_file(format!("{}{lost}", store.path().unwrap().display())).unwrap();
        let update = MapUpdate {
            map: map(&parts(44, SMALL)),
            changes: MapChanges::default(),
            frames: vec![lost_frame(22)],
        };
        let error = store.save_update("s", &update, TRACKED, &[]).await.unwrap_err();
        assert!(matches!(&error, StoreError::Gone { path } if path.ends_with(lost)), "{error:?}");
        assert!(error.to_string().contains("removed or replaced"), "{error}");
        assert!(store.check_saving().is_err());
    }
}

#[tokio::test]
async fn saving_that_fails_is_told_until_it_succeeds() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.close().await.unwrap();
    let n_bytes = std::fs::metadata(store.path().unwrap()).unwrap().len();
    let options = StoreOptions { max_bytes: Some(n_bytes), ..StoreOptions::default() };
    let store = Store::open(store.path().unwrap(), options).await.unwrap();
    store.check_saving().unwrap();
    store.save_update("s", &first_update(&bigger(45)), TRACKED, &[]).await.unwrap_err();
    let error = store.check_saving().unwrap_err().to_string();
    assert!(error.contains("saving fails") && error.contains("no room left"), "{error}");
    let small = MapUpdate {
        map: map(&parts(45, SMALL)),
        changes: MapChanges::default(),
        frames: vec![lost_frame(1)],
    };
    store.save_update("s", &small, TRACKED, &[]).await.unwrap();
    store.check_saving().unwrap();
}

/// Copies the database as the end of the process would leave it.
fn copy_as_if_killed(from: &Path, to: &Path) {
    for suffix in ["", "-wal"] {
        let name = |path: &Path| format!("{}{suffix}", path.display());
        if Path::new(&name(from)).exists() {
            std::fs::copy(name(from), name(to)).unwrap();
        }
    }
}

#[tokio::test]
async fn a_killed_process_leaves_the_map_of_its_last_commit() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    let mut world = structured(44, SMALL);
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    for round in 0..6u64 {
        world.points.iter_mut().for_each(|point| point.position += Numbers(round).vector(0.3));
        world.lines.iter_mut().for_each(|line| move_line(line, Numbers(round).vector(0.3)));
        world.primitives.iter_mut().for_each(|primitive| primitive.covariance *= 0.5);
        let changes = MapChanges { keyframes: Default::default(), ..all_new(&world) };
        let update = MapUpdate { map: map(&world), changes, frames: vec![frame(21 + round, kf(1))] };
        store.save_update("s", &update, TRACKED, &[]).await.unwrap();

        // The copy is taken while everything is open, without folding in the log.
        let copy = folder.path().join(format!("copy{round}.db"));
        copy_as_if_killed(store.path().unwrap(), &copy);
        let revived = Store::open(&copy, StoreOptions::default()).await.unwrap();
        assert_eq!(revived.check().await.unwrap(), []);
        assert_eq!(revived.get_session("s").await.unwrap().last_frame.unwrap().0, 21 + round);
        assert_same_parts(&load(&revived).await, &world);
        assert_eq!(revived.digest("s").await.unwrap(), store.digest("s").await.unwrap());
    }
}

#[tokio::test]
async fn a_log_cut_anywhere_leaves_some_commit_complete() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    let world = parts(45, SMALL);
    let mut digests = vec![store.digest("s").await.unwrap()];
    store.checkpoint().await.unwrap();
    store.save_update("s", &first_update(&world), TRACKED, &[]).await.unwrap();
    digests.push(store.digest("s").await.unwrap());
    for sequence in 21..24 {
        let frames = vec![frame(sequence, kf(2))];
        let update = MapUpdate { map: map(&world), changes: MapChanges::default(), frames };
        store.save_update("s", &update, TRACKED, &[]).await.unwrap();
        digests.push(store.digest("s").await.unwrap());
    }
    let log = std::fs::read(format!("{}-wal", store.path().unwrap().display())).unwrap();
    let copy = folder.path().join("copy.db");
    let mut seen = std::collections::BTreeSet::new();
    for part in 0..=24 {
        let _ = std::fs::remove_file(format!("{}-shm", copy.display()));
        std::fs::copy(store.path().unwrap(), &copy).unwrap();
        std::fs::write(format!("{}-wal", copy.display()), &log[..log.len() * part / 24]).unwrap();
        let revived = Store::open(&copy, StoreOptions::default()).await.unwrap();
        assert_eq!(revived.check().await.unwrap(), []);
        let digest = revived.digest("s").await.unwrap();
        let commit = digests.iter().position(|known| *known == digest);
        seen.insert(commit.expect("the database is as of one of the commits"));
        revived.close().await.unwrap();
    }
    assert_eq!((seen.first(), seen.last()), (Some(&0), Some(&4)));
}

/// Saves run on whichever thread the runtime likes.
fn assert_send<T: Send>(future: T) -> T {
    future
}

#[tokio::test]
async fn a_cancelled_save_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    let before = store.digest("s").await.unwrap();
    let update = first_update(&bigger(46));
    for micros in [0, 200, 1000, 4000] {
        let save = assert_send(store.save_update("s", &update, TRACKED, &[]));
        if tokio::time::timeout(std::time::Duration::from_micros(micros), save).await.is_err() {
            assert_eq!(store.digest("s").await.unwrap(), before);
        }
    }
    store.save_update("s", &update, TRACKED, &[]).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readers_see_whole_commits_while_a_writer_writes() {
    let folder = tempfile::tempdir().unwrap();
    let options = StoreOptions { durability: Durability::ProcessEnd, ..StoreOptions::default() };
    let store = Store::open(folder.path().join("maps.db"), options).await.unwrap();
    store.create_session(&new_session("s")).await.unwrap();
    // Every commit puts all points at one height; a reader must never see two heights in a page.
    let mut world = parts(47, SMALL);
    let mut at_height = |height: f64| {
        world.points.iter_mut().for_each(|point| point.position.z = height);
        let frames = vec![frame(height as u64, kf(1))];
        MapUpdate { map: map(&world), changes: all_new(&world), frames }
    };
    store.save_update("s", &at_height(1.0), TRACKED, &[]).await.unwrap();

    let reader = tokio::spawn({
        let store = store.clone();
        async move {
            let mut heights = Vec::new();
            while heights.last().is_none_or(|height| *height < 60.0) {
                let page = store.points_page("s", &PointQuery::default(), None, 100).await.unwrap();
                let height = page.items[0].position.z;
                assert!(page.items.iter().all(|point| point.position.z == height));
                heights.push(height);
            }
            heights
        }
    });
    for height in 2..=60 {
        store.save_update("s", &at_height(f64::from(height)), TRACKED, &[]).await.unwrap();
    }
    let heights = tokio::time::timeout(std::time::Duration::from_secs(60), reader).await.unwrap().unwrap();
    assert!(heights.is_sorted(), "commits are seen in their order");
    let points = store.points("s", PointQuery::default()).await.unwrap();
    assert_eq!(points.try_collect::<Vec<_>>().await.unwrap(), load(&store).await.points);
}
