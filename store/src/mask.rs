//! What of a session's images is not the scene.

use crate::engine::{Connection, query};
use crate::session::session_number;
use crate::{Store, StoreError};
use slam::SceneMask;
use std::sync::Arc;
use vision::mask::Mask;

impl Store {
    /// Stores what of a session's images is left out; nothing with `None`.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`].
    pub async fn set_mask(&self, session: &str, mask: Option<&SceneMask>) -> Result<(), StoreError> {
        let mut transaction = self.begin_write().await?;
        let (number, _) = transaction.hold(session).await?;
        write_mask(&mut transaction, number, mask).await?;
        let outcome = transaction.commit().await;
        self.place().note(&outcome);
        outcome
    }

    /// What of a session's images is left out.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or [`StoreError::Corrupt`].
    pub async fn mask(&self, session: &str) -> Result<Option<SceneMask>, StoreError> {
        let mut reader = self.reader().await?;
        let number = session_number(&mut reader, session).await?;
        read_mask(&mut reader, number).await
    }
}

pub(crate) async fn write_mask(
    connection: &mut Connection,
    number: i64,
    mask: Option<&SceneMask>,
) -> Result<(), StoreError> {
    query("UPDATE sessions SET mask_share = $1, mask_given = $2 WHERE number = $3")
        .bind(mask.map(|known| known.mask.share()))
        .bind(mask.is_some_and(|known| known.is_given))
        .bind(number)
        .execute(&mut *connection)
        .await?;
    match mask {
        Some(known) => {
            query(
                "INSERT INTO session_masks (session, runs) VALUES ($1, $2)
                 ON CONFLICT (session) DO UPDATE SET runs = excluded.runs",
            )
            .bind(number)
            .bind(known.mask.to_bytes())
            .execute(&mut *connection)
            .await?
        }
        None => {
            query("DELETE FROM session_masks WHERE session = $1")
                .bind(number)
                .execute(&mut *connection)
                .await?
        }
    };
    Ok(())
}

pub(crate) async fn read_mask(
    connection: &mut Connection,
    number: i64,
) -> Result<Option<SceneMask>, StoreError> {
    let row = query(
        "SELECT runs, mask_given FROM session_masks JOIN sessions ON number = session WHERE session = $1",
    )
    .bind(number)
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let mask = Mask::from_bytes(row.try_get("runs")?)
        .ok_or_else(|| StoreError::Corrupt("the mask of a session is none".into()))?;
    Ok(Some(SceneMask { mask: Arc::new(mask), is_given: row.try_get("mask_given")? }))
}
