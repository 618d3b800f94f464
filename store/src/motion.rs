//! What the motion sensors of a session's device measured: kept for who works with it, not used by the engine.

use crate::blob::{decode_motion, encode_motion};
use crate::engine::query;
use crate::session::session_number;
use crate::{Store, StoreError};

/// One reading of a gyroscope and an accelerometer, in the axes of the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionReading {
    /// Time by the clock of the session's frames, nanoseconds.
    pub timestamp_ns: i64,
    /// Radians a second.
    pub angular_velocity: [f32; 3],
    /// Metres a second squared, gravity included.
    pub acceleration: [f32; 3],
}

impl Store {
    /// Keeps readings, in the order of their times. Those that were sent before take the place of themselves.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if they cannot be stored.
    pub async fn add_motion(&self, id: &str, readings: &[MotionReading]) -> Result<(), StoreError> {
        let Some(first) = readings.first() else { return Ok(()) };
        let mut transaction = self.begin_write().await?;
        let (session, _) = transaction.hold(id).await?;
        let insert = "INSERT INTO motion (session, first_ns, n_readings, readings) VALUES ($1, $2, $3, $4) \
             ON CONFLICT (session, first_ns) DO UPDATE SET n_readings = excluded.n_readings, \
             readings = excluded.readings";
        let insert = query(insert).bind(session).bind(first.timestamp_ns).bind(readings.len() as i64);
        insert.bind(encode_motion(readings)).execute(&mut transaction).await?;
        let outcome = transaction.commit().await;
        self.place().note(&outcome);
        outcome
    }

    /// The readings that were sent together and begin next after a time, and when they begin; `None` when
    /// there are no more.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if they cannot be read.
    pub async fn motion_after(
        &self,
        id: &str,
        after_ns: Option<i64>,
    ) -> Result<Option<(i64, Vec<MotionReading>)>, StoreError> {
        let mut reader = self.reader().await?;
        let session = session_number(&mut reader, id).await?;
        let select = "SELECT first_ns, readings FROM motion \
             WHERE session = $1 AND ($2 IS NULL OR first_ns > $2) ORDER BY first_ns LIMIT 1";
        let row = query(select).bind(session).bind(after_ns).fetch_optional(&mut reader).await?;
        let Some(row) = row else { return Ok(None) };
        let (first_ns, readings): (i64, Vec<u8>) = (row.try_get(0)?, row.try_get(1)?);
        Ok(Some((
            first_ns,
            decode_motion(&readings).map_err(|error| StoreError::Corrupt(error.to_string()))?,
        )))
    }
}
