//! Checks of key frames, removed key frames and frames.

use super::{KeypointCounts, Problems};
use crate::StoreError;
use crate::blob::check_features;
use crate::number::{from_column, keyframe_id};
use crate::pose::{PoseBook, read_pose};
use crate::session::parse_state;
use futures_util::TryStreamExt;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

/// Checks key frames and their features; how many keypoints each has.
pub(super) async fn check_keyframes(
    connection: &mut SqliteConnection,
    session: i64,
    problems: &mut Problems,
) -> Result<KeypointCounts, StoreError> {
    let mut counts = KeypointCounts::new();
    let mut rows = sqlx::query(
        "SELECT id, qx, qy, qz, qw, tx, ty, tz, n_keypoints, features
         FROM keyframes k LEFT JOIN keyframe_features f ON f.session = k.session AND f.keyframe = k.id
         WHERE k.session = ? ORDER BY id",
    )
    .bind(session)
    .fetch(connection);
    while let Some(row) = rows.try_next().await? {
        let Some(id) = problems.note(keyframe_id(row.try_get(0)?))? else { continue };
        if read_pose(&row, 1).is_err() {
            problems.add(format!("key frame {id} has no finite pose with a unit quaternion"));
        }
        let n_claimed: i64 = row.try_get(8)?;
        let features: Option<&[u8]> = row.try_get(9)?;
        let n_keypoints = match features.map(check_features) {
            None => {
                problems.add(format!("key frame {id} has no features"));
                0
            }
            Some(Err(error)) => {
                problems.add(format!("the features of key frame {id} cannot be read: {error}"));
                0
            }
            Some(Ok(n_keypoints)) => {
                if n_keypoints as i64 != n_claimed {
                    problems
                        .add(format!("key frame {id} claims {n_claimed} keypoints but has {n_keypoints}"));
                }
                n_keypoints
            }
        };
        counts.insert(id, n_keypoints);
    }
    Ok(counts)
}

/// Checks that each removed key frame hangs, by however many others, on one that is in the map.
pub(super) async fn check_removed(
    connection: &mut SqliteConnection,
    session: i64,
    problems: &mut Problems,
) -> Result<(), StoreError> {
    let Some(book) = problems.note(PoseBook::read(connection, session).await)? else { return Ok(()) };
    for id in book.removed.keys() {
        if book.keyframes.contains_key(id) {
            problems.add(format!("key frame {id} is in the map and removed from it"));
        }
        if book.camera_from_world(*id).is_none() {
            problems.add(format!("removed key frame {id} hangs on nothing"));
        }
    }
    Ok(())
}

/// Checks the trajectory; how many frames there are, and the last one's number and time.
pub(super) async fn check_frames(
    connection: &mut SqliteConnection,
    session: i64,
    problems: &mut Problems,
) -> Result<(u64, Option<(u64, i64)>), StoreError> {
    let (mut n_frames, mut last) = (0, None);
    let mut rows = sqlx::query(
        "SELECT sequence, timestamp_ns, state, reference, qx, qy, qz, qw, tx, ty, tz
         FROM frames WHERE session = ? ORDER BY sequence",
    )
    .bind(session)
    .fetch(connection);
    while let Some(row) = rows.try_next().await? {
        n_frames += 1;
        let Some(frame) = problems.note(check_frame(&row))? else { continue };
        if last.is_some_and(|(_, timestamp_ns)| timestamp_ns >= frame.1) {
            problems.add(format!("the time of frame {} is not after the one before", frame.0));
        }
        last = Some(frame);
    }
    Ok((n_frames, last))
}

fn check_frame(row: &SqliteRow) -> Result<(u64, i64), StoreError> {
    let sequence = from_column("a sequence", row.try_get(0)?)?;
    parse_state(row.try_get(2)?)?;
    let reference: Option<i64> = row.try_get(3)?;
    if let Some(reference) = reference {
        keyframe_id(reference)?;
        read_pose(row, 4).map_err(|_| {
            StoreError::Corrupt(format!("frame {sequence} has no finite pose with a unit quaternion"))
        })?;
    }
    Ok((sequence, row.try_get(1)?))
}
