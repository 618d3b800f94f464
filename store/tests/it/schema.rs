use crate::world::*;
use sqlx::sqlite::SqlitePool;
use std::path::{Path, PathBuf};
use store::{Store, StoreError, StoreOptions};

/// A database written by the first release, with the session `s` of `parts(51, SMALL)`.
fn first_release() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/schema-1.sqlite")
}

#[tokio::test]
async fn a_database_of_the_first_release_opens() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("maps.db");
    std::fs::copy(first_release(), &path).unwrap();
    let store = Store::open(&path, StoreOptions::default()).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    let session = store.get_session("s").await.unwrap();
    assert_eq!((session.camera, session.last_frame), (camera(), Some((20, 1_000_000_000))));
    assert!(!session.enlarges_small_images, "its keyframes hold the pixels of images as they were");
    assert_same_parts(&load(&store).await, &parts(51, SMALL));
    assert_eq!((session.counts.n_points, session.counts.n_lines, session.counts.n_primitives), (60, 0, 0));
    // And it can be written to, lines and all; what was measured in its keyframes stays.
    let mut grown = parts(51, SMALL);
    let mut newer = structured(52, SMALL).keyframes.remove(5);
    newer.id = kf(7);
    newer.points.fill(None);
    newer.lines.fill(None);
    newer.vanishing.iter_mut().for_each(|seen| seen.primitive = None);
    grown.keyframes.push(newer);
    grown.last_ids.keyframe = 7;
    store.save_update("s", &first_update(&grown), TRACKED, &[]).await.unwrap();
    assert_same_parts(&load(&store).await, &grown);
    assert_eq!(store.check().await.unwrap(), []);
}

/// A database written by this release, with the session `s` of `structured(51, SMALL)`.
#[tokio::test]
async fn a_database_with_lines_opens() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("maps.db");
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/schema-2.sqlite");
    std::fs::copy(fixture, &path).unwrap();
    let store = Store::open(&path, StoreOptions::default()).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    assert_same_parts(&load(&store).await, &structured(51, SMALL));
}

/// Writes the file that the newest of the tests above opens. Run once per release that changes the schema,
/// under a new name.
#[tokio::test]
#[ignore = "writes a file of the repository"]
async fn write_a_database_of_this_release() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.save_update("s", &first_update(&structured(51, SMALL)), TRACKED, &[]).await.unwrap();
    store.close().await.unwrap();
    let name = format!("tests/fixtures/schema-{}.sqlite", Store::schema_version());
    std::fs::copy(store.path().unwrap(), Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
}

#[tokio::test]
async fn a_newer_schema_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.close().await.unwrap();
    let connection = SqlitePool::connect(store.path().unwrap().to_str().unwrap()).await.unwrap();
    sqlx::query(
        "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
         VALUES (9000, 'from the future', 1, x'00', 0)",
    )
    .execute(&connection)
    .await
    .unwrap();
    connection.close().await;
    let before = std::fs::read(store.path().unwrap()).unwrap();

    let error = Store::open(store.path().unwrap(), StoreOptions::default()).await.unwrap_err();
    let supported = Store::schema_version();
    assert!(
        matches!(error, StoreError::NewerSchema { found: 9000, supported: s } if s == supported),
        "{error:?}"
    );
    assert!(error.to_string().contains("9000"));
    assert_eq!(std::fs::read(store.path().unwrap()).unwrap(), before);
}

#[tokio::test]
async fn other_files_are_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("text.db");
    std::fs::write(&text, "This is no database. ".repeat(400)).unwrap();
    let other = folder.path().join("other.db");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&other).create_if_missing(true);
    let connection = SqlitePool::connect_with(options).await.unwrap();
    sqlx::query("CREATE TABLE recipes (name TEXT)").execute(&connection).await.unwrap();
    connection.close().await;

    for path in [text, other] {
        let before = std::fs::read(&path).unwrap();
        let error = Store::open(&path, StoreOptions::default()).await.unwrap_err();
        assert!(matches!(&error, StoreError::NotAStore { .. }), "{error:?}");
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }
    let nowhere =
        Store::open(folder.path().join("no/such/folder.db"), StoreOptions::default()).await.unwrap_err();
    assert!(matches!(nowhere, StoreError::Io(_)), "{nowhere:?}");
}

#[tokio::test]
async fn an_empty_file_is_as_good_as_none() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("maps.db"), "").unwrap();
    let store = store_with_session(folder.path()).await;
    assert_eq!(store.check().await.unwrap(), []);
}
