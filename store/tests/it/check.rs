use crate::world::*;
use sqlx::AssertSqlSafe;
use sqlx::sqlite::SqlitePool;
use std::path::{Path, PathBuf};
use store::{Store, StoreOptions};

/// A sound database, closed.
async fn sound_database(folder: &Path) -> PathBuf {
    let store = store_with_session(folder).await;
    store.save_update("s", &first_update(&structured(61, SMALL)), TRACKED, &[]).await.unwrap();
    assert_eq!(store.check().await.unwrap(), []);
    store.close().await.unwrap();
    store.path().unwrap().to_path_buf()
}

/// What `check` says after a statement was run on a copy of the database.
async fn problems_after(damage: &'static str, sound: &Path) -> Vec<String> {
    let path = sound.with_extension("copy");
    std::fs::copy(sound, &path).unwrap();
    let connection = SqlitePool::connect(path.to_str().unwrap()).await.unwrap();
    let statement = format!("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON; {damage}");
    sqlx::raw_sql(AssertSqlSafe(statement)).execute(&connection).await.unwrap();
    connection.close().await;
    let store = Store::open(&path, StoreOptions::default()).await.unwrap();
    let problems = store.check().await.unwrap();
    store.close().await.unwrap();
    problems.iter().map(ToString::to_string).collect()
}

#[tokio::test]
async fn every_kind_of_damage_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let sound = sound_database(folder.path()).await;
    let cases = [
        ("UPDATE sessions SET n_points = 3", "it claims 3 points but has 60"),
        ("UPDATE sessions SET n_frames = 3", "it claims 3 frames but has 20"),
        ("UPDATE sessions SET last_sequence = 21", "as its last frame"),
        ("UPDATE sessions SET camera = '{}'", "camera: "),
        (
            "UPDATE sessions SET camera = replace(camera, '458.654', '-1.0')",
            "fx must be a positive focal length",
        ),
        ("UPDATE sessions SET state = 9", "unknown state 9"),
        ("UPDATE keyframes SET qw = qw + 0.5 WHERE id = 2", "keyframe 2 has no finite pose"),
        ("UPDATE keyframes SET tx = 9e999 WHERE id = 3", "keyframe 3 has no finite pose"),
        ("UPDATE keyframes SET n_keypoints = 81 WHERE id = 3", "keyframe 3 claims 81 keypoints but has 80"),
        ("UPDATE keyframes SET parent = 99 WHERE id = 3", "a row of keyframes refers to one of keyframes"),
        ("DELETE FROM keyframe_features WHERE keyframe = 4", "keyframe 4 has no features"),
        (
            "UPDATE keyframe_features SET features = x'01' WHERE keyframe = 1",
            "features of keyframe 1 cannot be read",
        ),
        ("DELETE FROM keyframes WHERE id = 6", "refers to one of keyframes that is not there"),
        ("UPDATE points SET x = 9e999 WHERE id = 5", "point 5 has a number that is not finite"),
        ("UPDATE points SET x = x + 50 WHERE id = 5", "point 5 is not where spatial queries look"),
        (
            "UPDATE points SET observations = x'02' WHERE id = 5",
            "point 5: observations have the unknown format 2",
        ),
        (
            "UPDATE points SET observations = x'01', n_observations = 0 WHERE id = 5",
            "point 5 is seen by 0 keyframes",
        ),
        ("UPDATE points SET n_observations = 9 WHERE id = 5", "point 5 has the wrong number of observations"),
        (
            "UPDATE points SET observations = x'0101000163', n_observations = 2 WHERE id = 5",
            "a keypoint its keyframe does not have: 99 of 2",
        ),
        (
            "UPDATE points SET observations = x'0101006300', n_observations = 2 WHERE id = 5",
            "a keyframe that is not there: 0 of 100",
        ),
        (
            "UPDATE points SET (observations, n_observations) = (SELECT observations, n_observations FROM points WHERE id = 6) WHERE id = 5",
            "a keypoint that another point is seen by",
        ),
        ("DELETE FROM point_cells WHERE key & 0xffffffffff = 8", "point 8 is not where spatial queries look"),
        (
            "INSERT INTO point_cells VALUES ((1 << 40) | 70, 1, 1, 0, 1, 0, 1, 0, 1)",
            "61 places are noted for 60 points",
        ),
        ("UPDATE sessions SET n_lines = 3", "it claims 3 lines but has 25"),
        ("UPDATE sessions SET n_primitives = 3", "it claims 3 primitives but has 4"),
        ("UPDATE keyframes SET n_segments = 31 WHERE id = 3", "keyframe 3 claims 31 segments but has 30"),
        (
            "UPDATE keyframe_vanishing SET vanishing = x'09' WHERE keyframe = 2",
            "vanishing points of keyframe 2 cannot be read",
        ),
        ("DELETE FROM keyframe_vanishing WHERE keyframe = 2", "a vanishing point its keyframe does not have"),
        ("UPDATE lines SET start_x = 9e999 WHERE id = 5", "line 5 has a number that is not finite"),
        ("UPDATE lines SET end_z = end_z + 50 WHERE id = 5", "line 5 is not where spatial queries look"),
        ("UPDATE lines SET end_z = end_z + 0.1 WHERE id = 5", "an end of line 5 is not on it"),
        ("UPDATE lines SET direction_y = direction_y + 1 WHERE id = 5", "line 5: it is no Plücker line"),
        ("UPDATE lines SET n_observations = 9 WHERE id = 5", "line 5 has the wrong number of observations"),
        (
            "UPDATE lines SET (observations, n_observations) = (SELECT observations, n_observations FROM lines WHERE id = 6) WHERE id = 5",
            "a segment that another line is seen by",
        ),
        (
            "UPDATE lines SET primitive = 99 WHERE id = 5",
            "line 5 belongs to primitive 99, which is not there",
        ),
        ("DELETE FROM line_cells WHERE key & 0xffffffffff = 8", "line 8 is not where spatial queries look"),
        (
            "INSERT INTO line_cells VALUES ((1 << 40) | 70, 1, 1, 0, 1, 0, 1, 0, 1)",
            "26 places are noted for 25 lines",
        ),
        ("UPDATE primitives SET direction_x = 2 WHERE id = 1", "primitive 1: it is no direction"),
        ("UPDATE primitives SET covariance = x'00' WHERE id = 1", "primitive 1: "),
        (
            "UPDATE primitives SET (observations, n_observations) = (SELECT observations, n_observations FROM primitives WHERE id = 2) WHERE id = 1",
            "a vanishing point that another primitive is seen by",
        ),
        (
            "INSERT INTO removed_keyframes VALUES (1, 9, 8, 0, 0, 0, 1, 0, 0, 0), (1, 8, 9, 0, 0, 0, 1, 0, 0, 0)",
            "removed keyframe 8 hangs on nothing",
        ),
        (
            "INSERT INTO removed_keyframes VALUES (1, 2, 1, 0, 0, 0, 1, 0, 0, 0)",
            "keyframe 2 is in the map and removed",
        ),
        (
            "UPDATE frames SET timestamp_ns = 0 WHERE sequence = 9",
            "the time of frame 9 is not after the one before",
        ),
        ("UPDATE frames SET qx = 7 WHERE sequence = 9", "frame 9 has no finite pose"),
        ("UPDATE frames SET state = 0 WHERE sequence = 9", "unknown state 0"),
        (
            "INSERT INTO frames (session, sequence, timestamp_ns, state, backfilled) VALUES (7, 1, 1, 1, 0)",
            "a row of frames refers to one of sessions",
        ),
    ];
    for (damage, expected) in cases {
        let problems = problems_after(damage, &sound).await;
        assert!(problems.iter().any(|problem| problem.contains(expected)), "{damage}: {problems:?}");
    }
}

#[tokio::test]
async fn pages_overwritten_on_disk_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_with_session(folder.path()).await;
    store.save_update("s", &first_update(&parts(62, SMALL)), TRACKED, &[]).await.unwrap();
    store.close().await.unwrap();
    let mut bytes = std::fs::read(store.path().unwrap()).unwrap();
    let n = bytes.len();
    bytes[n - 8192..].fill(0x5a);
    std::fs::write(store.path().unwrap(), bytes).unwrap();
    let store = Store::open(store.path().unwrap(), StoreOptions::default()).await.unwrap();
    let outcome = store.check().await;
    assert!(!matches!(&outcome, Ok(problems) if problems.is_empty()), "{outcome:?}");
}
