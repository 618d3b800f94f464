use crate::world::*;
use store::{SessionChanges, SessionCounts, SessionOptions, Store, StoreError, StoreOptions};

#[tokio::test]
async fn what_was_deleted_is_given_back_when_the_file_is_compacted() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().join("maps.db"), StoreOptions::default()).await.unwrap();
    for i in 0..300 {
        store.create_session(&new_session(&format!("session-{i}"))).await.unwrap();
    }
    for i in 0..299 {
        store.delete_session(&format!("session-{i}")).await.unwrap();
    }
    let [before, after] = store.compact().await.unwrap();
    assert!(after < before, "{before} bytes before, {after} after");
    assert_eq!(std::fs::metadata(store.path().unwrap()).unwrap().len(), after);
    assert!(store.check().await.unwrap().is_empty());
    assert_eq!(store.get_session("session-299").await.unwrap().id, "session-299");
}

async fn a_session_is_made_found_changed_and_deleted(home: Home) {
    let store = home.open().await;
    let made = store.create_session(&new_session("kitchen")).await.unwrap();
    assert_eq!((made.id.as_str(), &made.camera), ("kitchen", &camera()));
    assert_eq!((made.last_frame, made.metres_per_unit, made.counts), (None, None, SessionCounts::default()));
    assert!(made.enlarges_small_images);
    assert_eq!(store.get_session("kitchen").await.unwrap(), made);

    let taken = store.create_session(&new_session("kitchen")).await.unwrap_err();
    assert_eq!(taken.to_string(), r#"there is already a session "kitchen""#);

    let options = SessionOptions { lines: Some(false), ..SessionOptions::default() };
    let changes = SessionChanges { options: Some(options.clone()), metres_per_unit: Some(Some(0.25)) };
    let changed = store.update_session("kitchen", &changes).await.unwrap();
    assert_eq!((changed.options, changed.metres_per_unit), (options.clone(), Some(0.25)));
    let freed = SessionChanges { options: None, metres_per_unit: Some(None) };
    let changed = store.update_session("kitchen", &freed).await.unwrap();
    assert_eq!((changed.options, changed.metres_per_unit), (options, None));
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused = SessionChanges { options: None, metres_per_unit: Some(Some(scale)) };
        assert!(matches!(store.update_session("kitchen", &refused).await, Err(StoreError::NotFinite(_))));
    }

    store.delete_session("kitchen").await.unwrap();
    for error in [
        store.get_session("kitchen").await.unwrap_err(),
        store.delete_session("kitchen").await.unwrap_err(),
        store.update_session("kitchen", &freed).await.unwrap_err(),
        store.digest("kitchen").await.unwrap_err(),
    ] {
        assert_eq!(error.to_string(), r#"there is no session "kitchen""#);
    }
}

async fn sessions_are_listed_by_name_in_pages(home: Home) {
    let store = home.open().await;
    for id in ["c", "a", "e", "b", "d"] {
        store.create_session(&new_session(id)).await.unwrap();
    }
    let mut seen = Vec::new();
    let mut after: Option<String> = None;
    loop {
        let page = store.list_sessions(after.as_deref(), 2).await.unwrap();
        assert!(page.items.len() <= 2);
        seen.extend(page.items.into_iter().map(|session| session.id));
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!(seen, ["a", "b", "c", "d", "e"]);
    assert_eq!(store.list_sessions(None, 5).await.unwrap().next, None);
}

async fn deleting_one_session_leaves_the_others(home: Home) {
    let store = home.store_with_session().await;
    store.create_session(&new_session("other")).await.unwrap();
    let (mine, other) = (parts(1, SMALL), parts(2, SMALL));
    store.save_update("s", &first_update(&mine), TRACKED, &[]).await.unwrap();
    store.save_update("other", &first_update(&other), TRACKED, &[]).await.unwrap();
    let before = store.digest("other").await.unwrap();

    store.delete_session("s").await.unwrap();
    assert_eq!(store.digest("other").await.unwrap(), before);
    assert_eq!(store.check().await.unwrap(), []);

    store.create_session(&new_session("s")).await.unwrap();
    assert_eq!(load(&store).await.points, []);
    assert!(
        store.digest("s").await.unwrap().0.iter().all(|table| table.table == "sessions" || table.n_rows == 0)
    );
}

async fn a_session_of_more_rows_than_go_at_once_is_deleted(home: Home) {
    let store = home.store_with_session().await;
    let large = Size { n_keyframes: 100, n_keypoints: 1200, n_points: 30_000 };
    store.save_update("s", &first_update(&parts(1, large)), TRACKED, &[]).await.unwrap();
    store.delete_session("s").await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    store.close().await.unwrap();
    for rows in
        ["SELECT count(*) FROM points", "SELECT count(*) FROM point_cells", "SELECT count(*) FROM line_cells"]
    {
        assert_eq!(number(&home, rows).await, 0, "{rows}");
    }
}

async fn an_interrupted_deletion_is_finished_when_the_database_is_opened(home: Home) {
    let store = home.store_with_session().await;
    store.save_update("s", &first_update(&parts(1, SMALL)), TRACKED, &[]).await.unwrap();
    store.close().await.unwrap();
    // What delete_session has done before it begins to clear away rows.
    assert_eq!(number(&home, "UPDATE sessions SET id = NULL RETURNING number").await, 1);

    let store = home.open().await;
    assert_eq!(store.list_sessions(None, 10).await.unwrap().items, []);
    store.close().await.unwrap();
    for rows in [
        "SELECT count(*) FROM sessions",
        "SELECT count(*) FROM keyframes",
        "SELECT count(*) FROM keyframe_features",
        "SELECT count(*) FROM points",
        "SELECT count(*) FROM point_cells",
        "SELECT count(*) FROM frames",
    ] {
        assert_eq!(number(&home, rows).await, 0, "{rows}");
    }
}

on_either_engine! {
    a_session_is_made_found_changed_and_deleted,
    sessions_are_listed_by_name_in_pages,
    deleting_one_session_leaves_the_others,
    a_session_of_more_rows_than_go_at_once_is_deleted,
    an_interrupted_deletion_is_finished_when_the_database_is_opened,
}
