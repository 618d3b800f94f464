//! Several cameras of one map: sessions whose frames hang on keyframes of another session's map.
//!
//! The map is in the rows of the session it began with. Others name that session in `sessions.map`, have
//! their frames, segments, masks and readings as any session, and a number among the map's cameras.

use crate::engine::{Connection, Row, query};
use crate::mask::read_mask;
use crate::number::{camera_id, keyframe_column, keyframe_id, to_column};
use crate::segments::Segments;
use crate::session::{decode_camera, read_session, state_column};
use crate::{SessionCounts, SessionRecord, Store, StoreError};
use geometry::{Camera, CameraParameters};
use slam::map::{CameraId, FrameRecord, FrameState, KeyframeId, MapCamera};
use slam::{JoinState, SlamConfig};
use std::collections::BTreeMap;

/// A session with what the pipeline of its camera is taken up with, the map aside.
#[derive(Clone, Debug)]
pub struct LoadedCamera {
    /// The session.
    pub record: SessionRecord,
    /// Its last frame, with the engine's time, and what of its images is left out.
    pub join: JoinState,
    /// By how much the engine's times are ahead of the client's.
    pub segments: Segments,
}

/// A camera that was added to a map.
#[derive(Clone, Debug)]
pub(crate) struct AddedCamera {
    pub parameters: CameraParameters,
    /// Whether it is of the same calibration as the map's own.
    pub is_refined: bool,
}

impl AddedCamera {
    /// Which of the map's cameras it is.
    pub fn of_map(&self, id: CameraId) -> MapCamera {
        MapCamera { id, is_refined: self.is_refined }
    }

    /// The camera whose pixels its features are in.
    pub fn working_camera(&self, config: &SlamConfig) -> Result<Camera, StoreError> {
        let camera = Camera::new(self.parameters.clone())
            .map_err(|error| StoreError::Corrupt(format!("a camera that was added: {error}")))?;
        Ok(config.of_added_camera().working_camera(&camera))
    }
}

/// Whose rows a session's answers are in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers {
    /// Its own: frames.
    pub own: i64,
    /// That of the session whose map it is: keyframes, landmarks.
    pub map: i64,
    /// Which of the map's cameras it is.
    pub camera: i64,
}

impl Numbers {
    pub async fn of(connection: &mut Connection, id: &str) -> Result<Self, StoreError> {
        let row = query(
            "SELECT s.number, coalesce(m.number, s.number), s.camera_number
             FROM sessions s LEFT JOIN sessions m ON m.id = s.map WHERE s.id = $1",
        )
        .bind(id)
        .fetch_optional(connection)
        .await?;
        let row = row.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?;
        Ok(Self { own: row.try_get(0)?, map: row.try_get(1)?, camera: row.try_get(2)? })
    }
}

/// The number of the session whose map a session's is.
pub(crate) async fn map_number(connection: &mut Connection, id: &str) -> Result<i64, StoreError> {
    Ok(Numbers::of(connection, id).await?.map)
}

/// The cameras that were added to a map, those of deleted sessions too.
pub(crate) async fn read_added(
    connection: &mut Connection,
    (map, own): (i64, &CameraParameters),
) -> Result<BTreeMap<CameraId, AddedCamera>, StoreError> {
    let select = "SELECT camera, parameters FROM added_cameras WHERE session = $1 ORDER BY camera";
    let rows = query(select).bind(map).fetch_all(connection).await?;
    let parse = |row: &Row| {
        let parameters = decode_camera(row.try_get(1)?)?;
        let is_refined = parameters == *own;
        Ok((camera_id(row.try_get(0)?)?, AddedCamera { parameters, is_refined }))
    };
    rows.iter().map(parse).collect()
}

/// The sessions that an update of a map is written for.
pub(crate) struct MapSessions {
    /// Segments of the session whose map it is.
    pub own: Segments,
    pub added: BTreeMap<CameraId, AddedSession>,
}

/// A session whose camera was added to the map.
pub(crate) struct AddedSession {
    pub number: i64,
    pub segments: Segments,
    pub last_frame: Option<(u64, i64)>,
    pub n_frames: u64,
    pub state: i64,
}

const SELECT_SESSIONS: &str = "SELECT * FROM sessions WHERE map = $1 ORDER BY number";
const SELECT_SESSIONS_FOR_UPDATE: &str =
    "SELECT * FROM sessions WHERE map = $1 ORDER BY number FOR NO KEY UPDATE";

impl MapSessions {
    /// In a transaction that writes; others who would wait for its end.
    pub async fn read(
        connection: &mut Connection,
        (number, record): (i64, &SessionRecord),
    ) -> Result<Self, StoreError> {
        let sql = connection.either(SELECT_SESSIONS, SELECT_SESSIONS_FOR_UPDATE);
        Self::select(connection, (number, record), sql).await
    }

    /// In a transaction that only reads.
    pub async fn read_only(
        connection: &mut Connection,
        (number, record): (i64, &SessionRecord),
    ) -> Result<Self, StoreError> {
        Self::select(connection, (number, record), SELECT_SESSIONS).await
    }

    async fn select(
        connection: &mut Connection,
        (number, record): (i64, &SessionRecord),
        sql: &'static str,
    ) -> Result<Self, StoreError> {
        let own = Segments::read(connection, number).await?;
        let mut added = BTreeMap::new();
        if record.last_camera == CameraId::default() {
            return Ok(Self { own, added });
        }
        for row in query(sql).bind(&record.id).fetch_all(connection).await? {
            let (number, session) = crate::session::parse_session(&row)?;
            let segments = Segments::read(connection, number).await?;
            let SessionRecord { camera_id, last_frame, counts, state, .. } = session;
            let (n_frames, state) = (counts.n_frames, state_column(state));
            added.insert(camera_id, AddedSession { number, segments, last_frame, n_frames, state });
        }
        Ok(Self { own, added })
    }

    /// The client's time of a frame; as the engine has it where nobody knows better any more.
    pub fn client_ns(&self, camera: CameraId, sequence: u64, timestamp_ns: i64) -> i64 {
        let segments = self.segments_of(camera);
        segments.map_or(timestamp_ns, |segments| segments.client_ns(sequence, timestamp_ns))
    }

    /// The engine's time of a frame, likewise.
    pub fn engine_ns(&self, camera: CameraId, sequence: u64, timestamp_ns: i64) -> i64 {
        let segments = self.segments_of(camera);
        segments.map_or(timestamp_ns, |segments| segments.engine_ns(sequence, timestamp_ns))
    }

    fn segments_of(&self, camera: CameraId) -> Option<&Segments> {
        match self.added.get(&camera) {
            None if camera == CameraId::default() => Some(&self.own),
            added => added.map(|added| &added.segments),
        }
    }
}

impl AddedSession {
    /// Writes what frames make of the session's row.
    pub async fn write_progress(
        &self,
        connection: &mut Connection,
        frames: &[&FrameRecord],
        n_new: u64,
    ) -> Result<(), StoreError> {
        let client_ns = |frame: &FrameRecord| self.segments.client_ns(frame.sequence, frame.timestamp_ns);
        let newest = frames.iter().max_by_key(|frame| frame.sequence);
        let last_frame = self.last_frame.max(newest.map(|frame| (frame.sequence, client_ns(frame))));
        let told = frames.iter().filter(|frame| !frame.backfilled).max_by_key(|frame| frame.sequence);
        let state = told.map_or(self.state, |frame| state_column(frame.state));
        query(
            "UPDATE sessions SET state = $1, last_sequence = $2, last_timestamp_ns = $3, n_frames = $4
             WHERE number = $5",
        )
        .bind(state)
        .bind(last_frame.map(|(sequence, _)| to_column("sequence", sequence)).transpose()?)
        .bind(last_frame.map(|(_, timestamp_ns)| timestamp_ns))
        .bind(to_column("n_frames", self.n_frames + n_new)?)
        .bind(self.number)
        .execute(connection)
        .await?;
        Ok(())
    }
}

/// Has the rows of sessions whose cameras were added say what the map is like.
pub(crate) async fn write_map_counts(
    connection: &mut Connection,
    (map, number): (&str, i64),
    counts: &SessionCounts,
    with_correction: bool,
) -> Result<(), StoreError> {
    let column = to_column;
    query(
        "UPDATE sessions SET n_keyframes = $1, n_points = $2, n_lines = $3, n_primitives = $4, n_submaps = $5
         WHERE map = $6",
    )
    .bind(column("n_keyframes", counts.n_keyframes)?)
    .bind(column("n_points", counts.n_points)?)
    .bind(column("n_lines", counts.n_lines)?)
    .bind(column("n_primitives", counts.n_primitives)?)
    .bind(i64::from(counts.n_submaps))
    .bind(map)
    .execute(&mut *connection)
    .await?;
    if !with_correction {
        return Ok(());
    }
    // Of the calibration of the map's own: what was found of that one holds for them.
    for column in [
        "focal_correction",
        "centre_x_correction",
        "centre_y_correction",
        "k1_correction",
        "k2_correction",
        "calibration_contradicted",
        "found_readout_ns",
        "found_readout_sigma_ns",
    ] {
        let sql = format!(
            "UPDATE sessions SET {column} = (SELECT {column} FROM sessions WHERE number = $1)
             WHERE map = $2 AND camera = (SELECT camera FROM sessions WHERE number = $1)"
        );
        // Safe: the text is made of constants.
        query(sql).bind(number).bind(map).execute(&mut *connection).await?;
    }
    Ok(())
}

impl Store {
    /// Reads what the pipeline of a session's camera is taken up with, the map aside.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], [`StoreError::Corrupt`].
    pub async fn load_camera(&self, id: &str) -> Result<LoadedCamera, StoreError> {
        let mut transaction = self.begin_read().await?;
        let (number, record) = read_session(&mut transaction, id).await?;
        let segments = Segments::read(&mut transaction, number).await?;
        let mask = read_mask(&mut transaction, number).await?;
        transaction.commit().await?;
        let engine_ns = |(sequence, timestamp_ns)| (sequence, segments.engine_ns(sequence, timestamp_ns));
        let join = JoinState { last_frame: record.last_frame.map(engine_ns), mask };
        Ok(LoadedCamera { record, join, segments })
    }

    /// The sessions whose cameras extend a session's map, in the order of their names, without that session
    /// itself.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn cameras_of(&self, map: &str) -> Result<Vec<String>, StoreError> {
        let select = query("SELECT id FROM sessions WHERE map = $1 AND id IS NOT NULL ORDER BY id");
        select.bind(map).scalars(&mut self.reader().await?).await
    }

    /// The session whose map a session's is, as if its camera were the one that took a keyframe.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn record_of_keyframe(
        &self,
        id: &str,
        keyframe: KeyframeId,
    ) -> Result<SessionRecord, StoreError> {
        let map = self.map_of(id).await?;
        let Some(camera) = self.added_camera_of(id, keyframe).await?.filter(|camera| *camera != map.camera)
        else {
            return Ok(map);
        };
        let correction = geometry::CameraCorrection::default();
        Ok(SessionRecord {
            camera,
            correction,
            enlarges_small_images: true,
            enlarges_for_border: false,
            ..map
        })
    }

    /// The session whose map a session's is, which may be itself.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn map_of(&self, id: &str) -> Result<SessionRecord, StoreError> {
        let record = self.get_session(id).await?;
        match &record.map {
            Some(map) => self.get_session(map).await,
            None => Ok(record),
        }
    }

    /// The calibration of each camera that was added to a session's map, and which keyframe was taken by one.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn added_cameras(
        &self,
        id: &str,
    ) -> Result<(BTreeMap<CameraId, CameraParameters>, BTreeMap<KeyframeId, CameraId>), StoreError> {
        let mut transaction = self.begin_read().await?;
        let map = map_number(&mut transaction, id).await?;
        let row = query("SELECT camera FROM sessions WHERE number = $1").bind(map);
        let own = decode_camera(row.fetch_one(&mut transaction).await?.try_get(0)?)?;
        let added = read_added(&mut transaction, (map, &own)).await?;
        let select = query("SELECT id, camera FROM keyframes WHERE session = $1 AND camera > 0");
        let rows = select.bind(map).fetch_all(&mut transaction).await?;
        transaction.commit().await?;
        let keyframe = |row: &Row| Ok((keyframe_id(row.try_get(0)?)?, camera_id(row.try_get(1)?)?));
        let keyframes = rows.iter().map(keyframe).collect::<Result<_, StoreError>>()?;
        Ok((added.into_iter().map(|(id, camera)| (id, camera.parameters)).collect(), keyframes))
    }

    /// The calibration of the camera that took a keyframe, if that is one that was added to the map.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn added_camera_of(
        &self,
        id: &str,
        keyframe: KeyframeId,
    ) -> Result<Option<CameraParameters>, StoreError> {
        let mut reader = self.reader().await?;
        let map = map_number(&mut reader, id).await?;
        let row = query(
            "SELECT a.parameters FROM keyframes k JOIN added_cameras a ON a.session = k.session AND a.camera = k.camera
             WHERE k.session = $1 AND k.id = $2",
        )
        .bind(map)
        .bind(keyframe_column(keyframe)?)
        .fetch_optional(&mut reader)
        .await?;
        row.map(|row| decode_camera(row.try_get(0)?)).transpose()
    }
}

/// Makes a session whose camera extends the map of another.
pub(crate) async fn insert_added(
    connection: &mut Connection,
    (new, map): (&crate::NewSession, &str),
    (camera, options): (&str, &str),
) -> Result<bool, StoreError> {
    // Who deletes the map meanwhile waits for this row, or has taken its name.
    let numbered = query(
        "UPDATE sessions SET last_camera_number = last_camera_number + 1 WHERE id = $1 AND map IS NULL
         RETURNING number, last_camera_number",
    );
    let row = numbered.bind(map).fetch_optional(connection).await?;
    let row = row.ok_or_else(|| StoreError::SessionNotFound { id: map.to_owned() })?;
    let (number, camera_number): (i64, i64) = (row.try_get(0)?, row.try_get(1)?);
    let inserted = query(
        "INSERT INTO sessions (id, camera, options, created_at_ns, state, enlarges_small_images, map, camera_number,
             n_keyframes, n_points, n_lines, n_primitives, n_submaps, metres_per_unit)
         SELECT $1, $2, $3, CAST($4 AS BIGINT), CAST($5 AS BIGINT), TRUE, id, last_camera_number,
             n_keyframes, n_points, n_lines, n_primitives, n_submaps, metres_per_unit
         FROM sessions WHERE number = $6
         ON CONFLICT (id) DO NOTHING",
    )
    .bind(&new.id)
    .bind(camera)
    .bind(options)
    .bind(new.created_at_ns)
    .bind(state_column(FrameState::Initialising))
    .bind(number)
    .execute(&mut *connection)
    .await?;
    if inserted == 0 {
        return Ok(false);
    }
    query("INSERT INTO added_cameras (session, camera, parameters) VALUES ($1, $2, $3)")
        .bind(number)
        .bind(camera_number)
        .bind(camera)
        .execute(connection)
        .await?;
    Ok(true)
}

/// Refuses to delete a session whose map others extend.
pub(crate) async fn check_unused(connection: &mut Connection, id: &str) -> Result<(), StoreError> {
    let by: Option<String> =
        query("SELECT id FROM sessions WHERE map = $1 AND id IS NOT NULL ORDER BY id LIMIT 1")
            .bind(id)
            .scalar(connection)
            .await?;
    match by {
        Some(by) => Err(StoreError::MapInUse { id: id.to_owned(), by }),
        None => Ok(()),
    }
}

/// Whose map a session's is if not its own, which of its cameras it is, and the highest number that was given
/// to a camera of its own map.
pub(crate) fn read_map(row: &Row) -> Result<(Option<String>, CameraId, CameraId), StoreError> {
    let (own, last): (i64, i64) = (row.try_get("camera_number")?, row.try_get("last_camera_number")?);
    Ok((row.try_get("map")?, camera_id(own)?, camera_id(last)?))
}
