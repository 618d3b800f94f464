//! Copies of databases: made while others write, and verified without a trace.

use crate::world::*;
use std::path::Path;
use store::{Store, StoreError, StoreOptions};

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[tokio::test]
async fn a_copy_is_of_one_commit_while_others_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.save_update("s", &first_update(&structured(61, SMALL)), TRACKED, &[]).await.unwrap();
    let copy = folder.path().join("copy");
    let writer = store.clone();
    let writing = tokio::spawn(async move {
        for i in 0.. {
            writer.create_session(&new_session(&format!("more-{i}"))).await.unwrap();
        }
    });
    tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    let begun = store.count_sessions_of("").await.unwrap();
    Store::back_up(store.path().unwrap(), &copy).await.unwrap();
    let ended = store.count_sessions_of("").await.unwrap();
    writing.abort();
    let verified = Store::verify(&copy).await.unwrap();
    assert_eq!(verified.findings, []);
    assert!((begun..=ended).contains(&verified.n_sessions), "{verified:?}, {begun} to {ended}");
    assert!(verified.are_sessions_checked);

    let copied = Store::open(&copy, StoreOptions::default()).await.unwrap();
    assert_same_parts(&load(&copied).await, &structured(61, SMALL));
    assert!(
        Store::back_up(store.path().unwrap(), &copy).await.is_err(),
        "a file that is not empty is left alone"
    );
}

#[tokio::test]
async fn verifying_leaves_no_trace_and_takes_what_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("maps.db");
    let store = Store::open(&path, StoreOptions::default()).await.unwrap();
    store.create_session(&new_session("kitchen")).await.unwrap();
    store.close().await.unwrap();
    let before = std::fs::read(&path).unwrap();
    let verified = Store::verify(&path).await.unwrap();
    assert_eq!((verified.findings, verified.n_sessions, verified.n_log_bytes_left_out), (vec![], 1, 0));
    assert_eq!(std::fs::read(&path).unwrap(), before);
    assert_eq!(names_in(folder.path()), ["maps.db"], "nothing is put beside it");
    assert!(Store::verify(&folder.path().join("none.db")).await.is_err());
}

#[tokio::test]
async fn what_is_in_the_log_is_verified_too() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().join("maps.db"), StoreOptions::default()).await.unwrap();
    store.create_session(&new_session("kitchen")).await.unwrap();
    // The store is open: what was written is in its log.
    let verified = Store::verify(store.path().unwrap()).await.unwrap();
    assert_eq!((verified.findings, verified.n_sessions, verified.n_log_bytes_left_out), (vec![], 1, 0));
}

#[tokio::test]
async fn a_database_of_an_earlier_release_is_verified_and_copied_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let old = folder.path().join("old");
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/schema-1.sqlite");
    std::fs::copy(fixture, &old).unwrap();
    let copy = folder.path().join("copy");
    Store::back_up(&old, &copy).await.unwrap();
    let verified = Store::verify(&copy).await.unwrap();
    assert_eq!((verified.findings, verified.n_sessions, verified.schema), (vec![], 1, 1));
    assert!(!verified.are_sessions_checked);
}

#[tokio::test]
async fn what_is_no_database_is_neither_copied_nor_whole() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("letter.txt");
    std::fs::write(&file, "Dear Sir or Madam, ".repeat(1000)).unwrap();
    for outcome in
        [Store::verify(&file).await.map(drop), Store::back_up(&file, &folder.path().join("copy")).await]
    {
        assert!(matches!(outcome, Err(StoreError::NotAStore { .. })), "{outcome:?}");
    }
}
