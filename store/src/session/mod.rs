//! Sessions: what they are called, what they run with, and how far they have come.

mod json;

use crate::cameras::{insert_added, read_map};
use crate::engine::{Connection, Row, query};
use crate::mask::write_mask;
use crate::number::{from_column, from_column_u32, to_column};
use crate::{Page, Store, StoreError};
use geometry::{Camera, CameraCorrection, CameraParameters};
use slam::map::{CameraId, FrameState, LastIds, Readout};
use slam::{Map, SceneMask};

pub(crate) use json::decode_camera;
pub use json::{Calibration, SessionOptions};

/// A session to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct NewSession {
    /// The name; the caller has checked its form.
    pub id: String,
    /// The camera the frames come from.
    pub camera: CameraParameters,
    /// The session's options.
    pub options: SessionOptions,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// What of its images is not the scene, if that is known.
    pub mask: Option<SceneMask>,
    /// The session whose map its camera extends; `None` if it has one of its own.
    pub map: Option<String>,
}

/// A stored session.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionRecord {
    /// The name.
    pub id: String,
    /// The camera the frames come from, as it was given.
    pub camera: CameraParameters,
    /// How that camera differs from what was given, as far as the session has found out.
    pub correction: CameraCorrection,
    /// Whether the images were found to contradict the camera as it was given.
    pub is_contradicted: bool,
    /// The readout of the camera's shutter, if the session has found it.
    pub readout: Option<Readout>,
    /// The session's options.
    pub options: SessionOptions,
    /// Whether small images are worked on enlarged (`SlamConfig::enlarge_below_px`): not in sessions that
    /// were made before that was done, whose keyframes hold the pixels of images as they were.
    pub enlarges_small_images: bool,
    /// Whether images are worked on enlarged for their border (`SlamConfig::enlarge_for_border`).
    pub enlarges_for_border: bool,
    /// What of its images is left out as not being the scene, if anything is.
    pub mask: Option<MaskShare>,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// How tracking the last stored frame ended.
    pub state: FrameState,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// Number and time of the last stored frame: every frame up to it is in the database.
    pub last_frame: Option<(u64, i64)>,
    /// How many things the session has.
    pub counts: SessionCounts,
    /// The session whose map it is; `None` if it has one of its own.
    pub map: Option<String>,
    /// Which of the map's cameras it is.
    pub camera_id: CameraId,
    /// The highest number that a camera of its own map was given: 0 while no other extends it.
    pub last_camera: CameraId,
}

/// How much of a session's images is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskShare {
    /// The share of the image, 0 to 1.
    pub share: f64,
    /// Whether it was given, and not found.
    pub is_given: bool,
}

/// How many things a session has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    /// Frames of the trajectory, with and without a pose.
    pub n_frames: u64,
    /// Keyframes, without removed ones.
    pub n_keyframes: u64,
    /// Points.
    pub n_points: u64,
    /// Lines.
    pub n_lines: u64,
    /// Global primitives.
    pub n_primitives: u64,
    /// Submaps that have keyframes.
    pub n_submaps: u32,
}

/// What of a session may be changed after it was made; what is `None` stays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionChanges {
    /// New options; they hold from the next time the session is loaded.
    pub options: Option<SessionOptions>,
    /// A new scale, metres per map unit; `Some(None)` frees it.
    pub metres_per_unit: Option<Option<f64>>,
}

impl Store {
    /// Makes a session without a map, or one whose camera extends the map of another.
    ///
    /// # Errors
    /// [`StoreError::SessionExists`] if the name is taken, [`StoreError::SessionNotFound`] if no session has
    /// such a map.
    pub async fn create_session(&self, new: &NewSession) -> Result<SessionRecord, StoreError> {
        let mut transaction = self.begin_write().await?;
        let (camera, options) = (json::encode_camera(&new.camera)?, json::encode_options(&new.options)?);
        let is_new = match &new.map {
            Some(map) => insert_added(&mut transaction, (new, map), (&camera, &options)).await?,
            None => insert(&mut transaction, new, (&camera, &options)).await?,
        };
        if !is_new {
            return Err(StoreError::SessionExists { id: new.id.clone() });
        }
        if let Some(mask) = &new.mask {
            let number = session_number(&mut transaction, &new.id).await?;
            write_mask(&mut transaction, number, Some(mask)).await?;
        }
        let record = read_session(&mut transaction, &new.id).await?.1;
        transaction.commit().await?;
        Ok(record)
    }

    /// The session of this name.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`] if there is none.
    pub async fn get_session(&self, id: &str) -> Result<SessionRecord, StoreError> {
        let mut reader = self.reader().await?;
        Ok(read_session(&mut reader, id).await?.1)
    }

    /// Metres per map unit of a session; `None` while the scale is free.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn metres_per_unit(&self, id: &str) -> Result<Option<f64>, StoreError> {
        let mut reader = self.reader().await?;
        let scale =
            query("SELECT metres_per_unit FROM sessions WHERE id = $1").bind(id).scalar(&mut reader).await?;
        scale.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })
    }

    /// Up to `page_size` sessions whose names come after the given one, in the order of the names' bytes.
    pub async fn list_sessions(
        &self,
        after: Option<&str>,
        page_size: u32,
    ) -> Result<Page<SessionRecord, String>, StoreError> {
        self.list_sessions_of("", after, page_size).await
    }

    /// As [`Self::list_sessions`], of those whose names begin so.
    pub async fn list_sessions_of(
        &self,
        prefix: &str,
        after: Option<&str>,
        page_size: u32,
    ) -> Result<Page<SessionRecord, String>, StoreError> {
        let mut reader = self.reader().await?;
        let rows =
            query("SELECT * FROM sessions WHERE id > $1 AND id >= $2 AND id < $3 ORDER BY id LIMIT $4")
                .bind(after.unwrap_or_default())
                .bind(prefix)
                .bind(beyond(prefix))
                .bind(i64::from(page_size) + 1)
                .fetch_all(&mut reader)
                .await?;
        let sessions = rows
            .iter()
            .map(|row| parse_session(row).map(|(_, record)| record))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Page::of(sessions, page_size, |last: &SessionRecord| last.id.clone()))
    }

    /// How many sessions there are whose names begin so.
    pub async fn count_sessions_of(&self, prefix: &str) -> Result<u64, StoreError> {
        let mut reader = self.reader().await?;
        let n_sessions: i64 = query("SELECT count(*) FROM sessions WHERE id >= $1 AND id < $2")
            .bind(prefix)
            .bind(beyond(prefix))
            .only(&mut reader)
            .await?;
        from_column("the number of sessions", n_sessions)
    }

    /// Bytes of the images and features of keyframes in sessions whose names begin so: most of what they take
    /// in the file. Only the rows' heads are read.
    pub async fn stored_bytes_of(&self, prefix: &str) -> Result<u64, StoreError> {
        let mut reader = self.reader().await?;
        let n_bytes: i64 = query(
            "SELECT CAST(coalesce(sum(
                 (SELECT coalesce(sum(length(features)), 0) FROM keyframe_features WHERE session = number) +
                 (SELECT coalesce(sum(length(bytes) + object_bytes), 0) FROM keyframe_images WHERE session = number) +
                 (SELECT coalesce(sum(length(readings)), 0) FROM motion WHERE session = number)), 0) AS BIGINT)
             FROM sessions WHERE id >= $1 AND id < $2",
        )
        .bind(prefix)
        .bind(beyond(prefix)).only(&mut reader).await?;
        from_column("the size of sessions", n_bytes)
    }

    /// Changes a session's options or scale.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or [`StoreError::NotFinite`] for a scale that is not a positive
    /// number.
    pub async fn update_session(
        &self,
        id: &str,
        changes: &SessionChanges,
    ) -> Result<SessionRecord, StoreError> {
        if let Some(Some(scale)) = changes.metres_per_unit
            && !(scale.is_finite() && scale > 0.0)
        {
            return Err(StoreError::NotFinite("the scale".into()));
        }
        let mut transaction = self.begin_write().await?;
        let (number, _) = transaction.hold(id).await?;
        if let Some(options) = &changes.options {
            query("UPDATE sessions SET options = $1 WHERE number = $2")
                .bind(json::encode_options(options)?)
                .bind(number)
                .execute(&mut transaction)
                .await?;
        }
        if let Some(scale) = changes.metres_per_unit {
            // The map's units are those of all its cameras.
            query("UPDATE sessions SET metres_per_unit = $1 WHERE number = $2 OR map = $3")
                .bind(scale)
                .bind(number)
                .bind(id)
                .execute(&mut transaction)
                .await?;
        }
        let record = read_session(&mut transaction, id).await?.1;
        transaction.commit().await?;
        Ok(record)
    }
}

impl From<&SceneMask> for MaskShare {
    fn from(known: &SceneMask) -> Self {
        Self { share: known.mask.share(), is_given: known.is_given }
    }
}

impl SessionRecord {
    /// The camera as it was given, checked again.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] if it is not the valid one that was stored.
    pub fn checked_camera(&self) -> Result<Camera, StoreError> {
        Camera::new(self.camera.clone())
            .map_err(|error| StoreError::Corrupt(format!("the camera of session {:?}: {error}", self.id)))
    }

    /// The camera as the session has found it to be; `None` if as it was given.
    pub fn refined_camera(&self) -> Option<CameraParameters> {
        let camera = self.checked_camera().ok().filter(|_| !self.correction.is_none())?;
        Some(camera.with_correction(self.correction).corrected_parameters())
    }
}

/// Makes a session with a map of its own; whether the name was free.
async fn insert(
    connection: &mut Connection,
    new: &NewSession,
    (camera, options): (&str, &str),
) -> Result<bool, StoreError> {
    let inserted = query(
        "INSERT INTO sessions (id, camera, options, created_at_ns, state, enlarges_small_images)
         VALUES ($1, $2, $3, $4, $5, TRUE)
         ON CONFLICT (id) DO NOTHING",
    )
    .bind(&new.id)
    .bind(camera)
    .bind(options)
    .bind(new.created_at_ns)
    .bind(state_column(FrameState::Initialising))
    .execute(connection)
    .await?;
    Ok(inserted > 0)
}

/// What stands behind every name that begins so.
fn beyond(prefix: &str) -> String {
    format!("{prefix}{}", char::MAX)
}

/// The number of a session.
pub(crate) async fn session_number(connection: &mut Connection, id: &str) -> Result<i64, StoreError> {
    query("SELECT number FROM sessions WHERE id = $1")
        .bind(id)
        .scalar(connection)
        .await?
        .ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })
}

/// A session with its number.
pub(crate) async fn read_session(
    connection: &mut Connection,
    id: &str,
) -> Result<(i64, SessionRecord), StoreError> {
    let row = query("SELECT * FROM sessions WHERE id = $1").bind(id).fetch_optional(connection).await?;
    parse_session(&row.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?)
}

pub(crate) fn parse_session(row: &Row) -> Result<(i64, SessionRecord), StoreError> {
    let last_sequence: Option<i64> = row.try_get("last_sequence")?;
    let last_timestamp_ns: Option<i64> = row.try_get("last_timestamp_ns")?;
    let last_sequence = last_sequence.map(|value| from_column("a sequence", value)).transpose()?;
    let (map, camera_id, last_camera) = read_map(row)?;
    let record = SessionRecord {
        id: row.try_get("id")?,
        camera: json::decode_camera(row.try_get("camera")?)?,
        correction: CameraCorrection {
            focal: row.try_get("focal_correction")?,
            center_x: row.try_get("centre_x_correction")?,
            center_y: row.try_get("centre_y_correction")?,
            k1: row.try_get("k1_correction")?,
            k2: row.try_get("k2_correction")?,
        },
        is_contradicted: row.try_get("calibration_contradicted")?,
        readout: match row.try_get("found_readout_ns")? {
            Some(readout_ns) => {
                let sigma_ns: Option<i64> = row.try_get("found_readout_sigma_ns")?;
                Some(Readout { readout_ns, sigma_ns: sigma_ns.unwrap_or(0) })
            }
            None => None,
        },
        options: json::decode_options(row.try_get("options")?)?,
        enlarges_small_images: row.try_get("enlarges_small_images")?,
        enlarges_for_border: row.try_get("enlarges_for_border")?,
        mask: match row.try_get("mask_share")? {
            Some(share) => Some(MaskShare { share, is_given: row.try_get("mask_given")? }),
            None => None,
        },
        created_at_ns: row.try_get("created_at_ns")?,
        state: parse_state(row.try_get("state")?)?,
        metres_per_unit: row.try_get("metres_per_unit")?,
        last_frame: last_sequence.zip(last_timestamp_ns),
        counts: SessionCounts {
            n_frames: from_column("n_frames", row.try_get("n_frames")?)?,
            n_keyframes: from_column("n_keyframes", row.try_get("n_keyframes")?)?,
            n_points: from_column("n_points", row.try_get("n_points")?)?,
            n_lines: from_column("n_lines", row.try_get("n_lines")?)?,
            n_primitives: from_column("n_primitives", row.try_get("n_primitives")?)?,
            n_submaps: from_column_u32("n_submaps", row.try_get("n_submaps")?)?,
        },
        map,
        camera_id,
        last_camera,
    };
    Ok((row.try_get("number")?, record))
}

/// Writes what a committed update makes of the session's row.
pub(crate) async fn write_progress(
    connection: &mut Connection,
    number: i64,
    state: FrameState,
    last_frame: Option<(u64, i64)>,
    last_ids: LastIds,
    counts: &SessionCounts,
) -> Result<(), StoreError> {
    let last_sequence = last_frame.map(|(sequence, _)| to_column("sequence", sequence)).transpose()?;
    query(
        "UPDATE sessions SET state = $1, last_sequence = $2, last_timestamp_ns = $3, last_keyframe_id = $4,
         last_point_id = $5, last_line_id = $6, last_primitive_id = $7, n_frames = $8, n_keyframes = $9, n_points = $10,
         n_lines = $11, n_primitives = $12, n_submaps = $13 WHERE number = $14",
    )
    .bind(state_column(state))
    .bind(last_sequence)
    .bind(last_frame.map(|(_, timestamp_ns)| timestamp_ns))
    .bind(to_column("keyframe id", last_ids.keyframe)?)
    .bind(to_column("point id", last_ids.point)?)
    .bind(to_column("line id", last_ids.line)?)
    .bind(to_column("primitive id", last_ids.primitive)?)
    .bind(to_column("n_frames", counts.n_frames)?)
    .bind(to_column("n_keyframes", counts.n_keyframes)?)
    .bind(to_column("n_points", counts.n_points)?)
    .bind(to_column("n_lines", counts.n_lines)?)
    .bind(to_column("n_primitives", counts.n_primitives)?)
    .bind(i64::from(counts.n_submaps))
    .bind(number)
    .execute(connection)
    .await?;
    Ok(())
}

/// Notes that the keyframes are of images enlarged for their border.
pub(crate) async fn write_enlarged(transaction: &mut Connection, number: i64) -> Result<(), StoreError> {
    query("UPDATE sessions SET enlarges_for_border = TRUE WHERE number = $1")
        .bind(number)
        .execute(transaction)
        .await?;
    Ok(())
}

/// Writes how the session's camera differs from its calibration, whether the images contradict it, and the
/// readout of its shutter.
pub(crate) async fn write_correction(
    connection: &mut Connection,
    number: i64,
    map: &Map,
) -> Result<(), StoreError> {
    let CameraCorrection { focal, center_x, center_y, k1, k2 } = map.correction();
    if ![focal, center_x, center_y, k1, k2].iter().all(|value| value.is_finite()) {
        return Err(StoreError::NotFinite("the correction of the camera".into()));
    }
    query(
        "UPDATE sessions SET focal_correction = $1, centre_x_correction = $2, centre_y_correction = $3,
         k1_correction = $4, k2_correction = $5, calibration_contradicted = $6, found_readout_ns = $7,
         found_readout_sigma_ns = $8 WHERE number = $9",
    )
    .bind(focal)
    .bind(center_x)
    .bind(center_y)
    .bind(k1)
    .bind(k2)
    .bind(map.is_contradicted())
    .bind(map.readout().map(|readout| readout.readout_ns))
    .bind(map.readout().map(|readout| readout.sigma_ns))
    .bind(number)
    .execute(connection)
    .await?;
    Ok(())
}

/// A frame's state as a column value.
pub(crate) fn state_column(state: FrameState) -> i64 {
    match state {
        FrameState::Initialising => 1,
        FrameState::Tracked => 2,
        FrameState::Weak => 3,
        FrameState::Lost => 4,
    }
}

/// Reverses [`state_column`].
pub(crate) fn parse_state(value: i64) -> Result<FrameState, StoreError> {
    match value {
        1 => Ok(FrameState::Initialising),
        2 => Ok(FrameState::Tracked),
        3 => Ok(FrameState::Weak),
        4 => Ok(FrameState::Lost),
        _ => Err(StoreError::Corrupt(format!("a frame has the unknown state {value}"))),
    }
}
