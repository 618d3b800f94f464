//! Loading a session's map, to take it up again.

use crate::blob::{FeatureSettings, decode_features, decode_vanishing};
use crate::cameras::{MapSessions, read_added};
use crate::engine::{Connection, Row, query};
use crate::lines::{LINE_COLUMNS, parse_line};
use crate::mask::read_mask;
use crate::number::{camera_id, from_column, keyframe_id, submap_id};
use crate::observations::enter_observations;
use crate::points::{POINT_COLUMNS, parse_point};
use crate::pose::{read_local_scale, read_pose, read_removed};
use crate::primitives::read_primitives;
use crate::segments::Segments;
use crate::session::parse_session;
use crate::{SessionRecord, Store, StoreError};
use geometry::Camera;
use slam::map::{CameraId, LastIds, MapCamera, MapParts};
use slam::{Keyframe, ResumeState, SlamConfig};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes fetched at a time, some 3 MB of features.
const KEYFRAMES_PER_STEP: i64 = 64;

/// Points or lines fetched at a time.
const LANDMARKS_PER_STEP: i64 = 4096;

/// A session with what its pipeline is taken up with.
#[derive(Clone, Debug)]
pub struct LoadedSession {
    /// The session.
    pub record: SessionRecord,
    /// Its map and its last frame, with the engine's times.
    pub resume: ResumeState,
    /// By how much those are ahead of the client's.
    pub segments: Segments,
}

impl Store {
    /// Reads a session with its whole map, as of the last commit.
    ///
    /// `config` is what the session will run with. Keypoints are stored in pixels of the working camera, so
    /// it must give the same working camera and pyramid as when they were made.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], [`StoreError::OtherSettings`] if the configuration does not fit, and
    /// [`StoreError::Corrupt`] if a row cannot be understood.
    pub async fn load_session(&self, id: &str, config: &SlamConfig) -> Result<LoadedSession, StoreError> {
        let mut transaction = self.begin_read().await?;
        let row =
            query("SELECT * FROM sessions WHERE id = $1").bind(id).fetch_optional(&mut transaction).await?;
        let row = row.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?;
        let (number, record) = parse_session(&row)?;
        let sessions = MapSessions::read_only(&mut transaction, (number, &record)).await?;
        let cameras = read_cameras(&mut transaction, (number, &record), config).await?;
        let mut keyframes = read_keyframes(&mut transaction, number, Arc::new(cameras)).await?;
        for Keyframe { camera, sequence, timestamp_ns, .. } in &mut keyframes {
            *timestamp_ns = sessions.engine_ns(camera.id, *sequence, *timestamp_ns);
        }
        let points = read_landmarks(&mut transaction, number, ("points", POINT_COLUMNS), parse_point).await?;
        let lines = read_landmarks(&mut transaction, number, ("lines", LINE_COLUMNS), parse_line).await?;
        let primitives = read_primitives(&mut transaction, number).await?;
        let mask = read_mask(&mut transaction, number).await?;
        let removed_keyframes = read_removed(&mut transaction, number).await?;
        transaction.commit().await?;

        let parts = MapParts {
            keyframes,
            points,
            lines,
            primitives,
            removed_keyframes,
            correction: record.correction,
            is_contradicted: record.is_contradicted,
            readout: record.readout,
            last_ids: LastIds {
                keyframe: from_column("last_keyframe_id", row.try_get("last_keyframe_id")?)?,
                point: from_column("last_point_id", row.try_get("last_point_id")?)?,
                line: from_column("last_line_id", row.try_get("last_line_id")?)?,
                primitive: from_column("last_primitive_id", row.try_get("last_primitive_id")?)?,
            },
        };
        let segments = sessions.own;
        let map = blocking(move || enter_observations(parts)).await?;
        let engine_ns = |(sequence, timestamp_ns)| (sequence, segments.engine_ns(sequence, timestamp_ns));
        let resume = ResumeState { map, last_frame: record.last_frame.map(engine_ns), mask };
        Ok(LoadedSession { record, resume, segments })
    }
}

/// Runs work that takes longer than a task on the runtime may.
pub(crate) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => Err(StoreError::Database(sqlx::Error::WorkerCrashed)),
        },
    }
}

/// A camera of a map, and what its keyframes' features must be of.
struct CameraOfMap {
    camera: MapCamera,
    working_camera: Camera,
    settings: FeatureSettings,
}

impl CameraOfMap {
    fn new(camera: MapCamera, working_camera: Camera, config: &SlamConfig) -> Self {
        let settings =
            FeatureSettings { pinhole: working_camera.nominal_pinhole(), pyramid: config.pyramid() };
        Self { camera, working_camera, settings }
    }
}

type CamerasOfMap = BTreeMap<CameraId, CameraOfMap>;

async fn read_cameras(
    connection: &mut Connection,
    (number, record): (i64, &SessionRecord),
    config: &SlamConfig,
) -> Result<CamerasOfMap, StoreError> {
    let own = config.working_camera(&record.checked_camera()?);
    let own = CameraOfMap::new(MapCamera::default(), own, config);
    let mut cameras = BTreeMap::from([(CameraId::default(), own)]);
    if record.last_camera != CameraId::default() {
        for (id, added) in read_added(connection, (number, &record.camera)).await? {
            let working_camera = added.working_camera(config)?;
            cameras.insert(id, CameraOfMap::new(added.of_map(id), working_camera, config));
        }
    }
    Ok(cameras)
}

async fn read_keyframes(
    connection: &mut Connection,
    session: i64,
    cameras: Arc<CamerasOfMap>,
) -> Result<Vec<Keyframe>, StoreError> {
    let mut keyframes: Vec<Keyframe> = Vec::new();
    loop {
        let after = keyframes.last().map_or(0, |last| last.id.get() as i64);
        let rows = query(
            "SELECT k.id, submap, sequence, timestamp_ns, qx, qy, qz, qw, tx, ty, tz, parent, features, vanishing, unit,
                 camera
             FROM keyframes k LEFT JOIN keyframe_features f ON f.session = k.session AND f.keyframe = k.id
             LEFT JOIN keyframe_vanishing v ON v.session = k.session AND v.keyframe = k.id
             WHERE k.session = $1 AND k.id > $2 ORDER BY k.id LIMIT $3",
        )
        .bind(session)
        .bind(after)
        .bind(KEYFRAMES_PER_STEP)
        .fetch_all(&mut *connection)
        .await?;
        if rows.is_empty() {
            return Ok(keyframes);
        }
        let cameras = Arc::clone(&cameras);
        let parsed = blocking(move || {
            rows.iter().map(|row| parse_keyframe(row, &cameras)).collect::<Result<Vec<_>, _>>()
        });
        keyframes.extend(parsed.await?);
    }
}

/// A keyframe that sees nothing yet.
fn parse_keyframe(row: &Row, cameras: &CamerasOfMap) -> Result<Keyframe, StoreError> {
    let id = keyframe_id(row.try_get(0)?)?;
    let corrupt = |what: &dyn std::fmt::Display| StoreError::Corrupt(format!("keyframe {id}: {what}"));
    let blob: Option<&[u8]> = row.try_get(12)?;
    let blob = blob.ok_or_else(|| corrupt(&"it has no features"))?;
    let camera = cameras.get(&camera_id(row.try_get(15)?)?);
    let camera = camera.ok_or_else(|| corrupt(&"it is of a camera that nothing is known of"))?;
    let CameraOfMap { camera, working_camera, settings } = camera;
    let features = decode_features(blob, working_camera, settings).map_err(|error| corrupt(&error))?;
    let features = features.map_err(|made_with| StoreError::OtherSettings(describe(&made_with, settings)))?;
    let vanishing: Option<&[u8]> = row.try_get(13)?;
    let vanishing = vanishing.map(|blob| decode_vanishing(blob, features.lines.len())).transpose();
    let vanishing = vanishing.map_err(|error| corrupt(&error))?;
    let parent: Option<i64> = row.try_get(11)?;
    let mut keyframe = Keyframe::from_parts(
        id,
        submap_id(row.try_get(1)?)?,
        from_column("a sequence", row.try_get(2)?)?,
        row.try_get(3)?,
        read_pose(row, 4)?,
        Arc::new(features),
        parent.map(keyframe_id).transpose()?,
    );
    keyframe.camera = *camera;
    keyframe.vanishing = vanishing.unwrap_or_default();
    keyframe.local_scale = read_local_scale(row, 14)?;
    Ok(keyframe)
}

/// In which way the settings differ.
fn describe(made_with: &FeatureSettings, expected: &FeatureSettings) -> String {
    if made_with.pyramid == expected.pyramid {
        let (then, now) = (made_with.pinhole.fx, expected.pinhole.fx);
        return format!("a working image of focal length {then:.2} px, now {now:.2} px");
    }
    let (then, now) = (made_with.pyramid, expected.pyramid);
    format!(
        "{} pyramid levels of ratio {:.3}, now {} of {:.3}",
        then.n_levels, then.scale_factor, now.n_levels, now.scale_factor
    )
}

/// Reads the rows of a table with a session and an id, in the order of their ids.
async fn read_landmarks<T: Send + 'static>(
    connection: &mut Connection,
    session: i64,
    (table, columns): (&str, &str),
    parse: fn(&Row) -> Result<T, StoreError>,
) -> Result<Vec<T>, StoreError> {
    let sql = format!("SELECT {columns} FROM {table} WHERE session = $1 AND id > $2 ORDER BY id LIMIT $3");
    let (mut landmarks, mut after) = (Vec::new(), 0_i64);
    loop {
        // Safe: the text is made of constants.
        let rows = query(sql.clone())
            .bind(session)
            .bind(after)
            .bind(LANDMARKS_PER_STEP)
            .fetch_all(&mut *connection)
            .await?;
        let Some(last) = rows.last() else { return Ok(landmarks) };
        after = last.try_get(0)?;
        landmarks.extend(blocking(move || rows.iter().map(parse).collect::<Result<Vec<_>, _>>()).await?);
    }
}
