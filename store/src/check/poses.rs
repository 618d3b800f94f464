//! Checks of keyframes, removed keyframes and frames.

use super::{Findings, Measured};
use crate::StoreError;
use crate::blob::{MeasuredCounts, check_features, decode_vanishing};
use crate::engine::{Connection, Row, query};
use crate::number::{from_column, keyframe_id};
use crate::pose::{PoseBook, read_local_scale, read_pose};
use crate::segments::Segments;
use crate::session::parse_state;
use futures_util::TryStreamExt;
use geometry::Pose;

/// Checks keyframes and their features; how much was measured in each.
pub(super) async fn check_keyframes(
    connection: &mut Connection,
    session: i64,
    problems: &mut Findings,
) -> Result<Measured, StoreError> {
    let mut measured = Measured::new();
    let mut rows = query(
        "SELECT id, qx, qy, qz, qw, tx, ty, tz, n_keypoints, features, n_segments, vanishing, unit
         FROM keyframes k LEFT JOIN keyframe_features f ON f.session = k.session AND f.keyframe = k.id
         LEFT JOIN keyframe_vanishing v ON v.session = k.session AND v.keyframe = k.id
         WHERE k.session = $1 ORDER BY id",
    )
    .bind(session)
    .fetch(connection);
    while let Some(row) = rows.try_next().await? {
        let Some(id) = problems.note(keyframe_id(row.try_get(0)?))? else { continue };
        if read_pose(&row, 1).is_err() {
            problems.add(format!("keyframe {id} has no finite pose with a unit quaternion"));
        }
        if read_local_scale(&row, 12).is_err() {
            problems.add(format!("keyframe {id} has no unit that is a positive number"));
        }
        let n_claimed: [i64; 2] = [row.try_get(8)?, row.try_get(10)?];
        let features: Option<&[u8]> = row.try_get(9)?;
        let counts = match features.map(check_features) {
            None => {
                problems.add(format!("keyframe {id} has no features"));
                MeasuredCounts::default()
            }
            Some(Err(error)) => {
                problems.add(format!("the features of keyframe {id} cannot be read: {error}"));
                MeasuredCounts::default()
            }
            Some(Ok(counts)) => {
                let found = [counts.n_keypoints, counts.n_segments];
                for ((what, claimed), found) in ["keypoints", "segments"].iter().zip(n_claimed).zip(found) {
                    if found as i64 != claimed {
                        problems.add(format!("keyframe {id} claims {claimed} {what} but has {found}"));
                    }
                }
                counts
            }
        };
        let vanishing: Option<&[u8]> = row.try_get(11)?;
        let n_vanishing = match vanishing.map(|blob| decode_vanishing(blob, counts.n_segments)) {
            None => 0,
            Some(Ok(vanishing)) => vanishing.len(),
            Some(Err(error)) => {
                problems.add(format!("the vanishing points of keyframe {id} cannot be read: {error}"));
                0
            }
        };
        measured.insert(id, [counts.n_keypoints, counts.n_segments, n_vanishing]);
    }
    Ok(measured)
}

/// Checks that each removed keyframe hangs, by however many others, on one that is in the map.
pub(super) async fn check_removed(
    connection: &mut Connection,
    session: i64,
    problems: &mut Findings,
) -> Result<(), StoreError> {
    let Some(book) = problems.note(PoseBook::read(connection, session).await)? else { return Ok(()) };
    for id in book.removed.keys() {
        if book.keyframes.contains_key(id) {
            problems.add(format!("keyframe {id} is in the map and removed from it"));
        }
        if book.locate(*id, &Pose::identity()).is_none() {
            problems.add(format!("removed keyframe {id} hangs on nothing"));
        }
    }
    Ok(())
}

/// Checks the trajectory; how many frames there are, and the last one's number and time.
pub(super) async fn check_frames(
    connection: &mut Connection,
    session: i64,
    problems: &mut Findings,
) -> Result<(u64, Option<(u64, i64)>), StoreError> {
    let segments = Segments::read(connection, session).await?;
    let engine_ns = |(sequence, timestamp_ns): (u64, i64)| segments.engine_ns(sequence, timestamp_ns);
    let (mut n_frames, mut last) = (0, None);
    let mut rows = query(
        "SELECT sequence, timestamp_ns, state, reference, qx, qy, qz, qw, tx, ty, tz
         FROM frames WHERE session = $1 ORDER BY sequence",
    )
    .bind(session)
    .fetch(connection);
    while let Some(row) = rows.try_next().await? {
        n_frames += 1;
        let Some(frame) = problems.note(check_frame(&row))? else { continue };
        if last.is_some_and(|last| engine_ns(last) >= engine_ns(frame)) {
            problems.add(format!("the time of frame {} is not after the one before", frame.0));
        }
        last = Some(frame);
    }
    Ok((n_frames, last))
}

fn check_frame(row: &Row) -> Result<(u64, i64), StoreError> {
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
