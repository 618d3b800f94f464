//! Deleting sessions.

use crate::cameras::check_unused;
use crate::engine::{Connection, query};
use crate::points::cell::MAX_POINT_ID;
use crate::{Store, StoreError};

/// Rows deleted per transaction: other sessions' commits wait some tens of milliseconds at most.
const ROWS_PER_STEP: i64 = 5_000;

/// A deletion that takes at most the bound number of a session's rows.
enum Step {
    /// Of an ordinary table, in one statement.
    Rows(&'static str),
    /// Of an R*Tree: it refuses to be written while a statement that has not come to its end reads it, as a
    /// subquery with a limit does.
    Cells { select: &'static str, delete: &'static str },
}

/// Blobs first: the pages they free are what the R*Tree rearranges itself in when the database is full.
const STEPS: [Step; 10] = [
    // Pages of blobs are what takes the time here, hence fewer rows.
    Step::Rows(
        "DELETE FROM keyframe_images WHERE session = $1 AND keyframe IN
             (SELECT keyframe FROM keyframe_images WHERE session = $1 LIMIT $2 / 50)",
    ),
    Step::Rows(
        "DELETE FROM keyframe_features WHERE session = $1 AND keyframe IN
             (SELECT keyframe FROM keyframe_features WHERE session = $1 LIMIT $2 / 50)",
    ),
    Step::Rows(
        "DELETE FROM motion WHERE session = $1 AND first_ns IN
             (SELECT first_ns FROM motion WHERE session = $1 LIMIT $2 / 50)",
    ),
    Step::Rows(
        "DELETE FROM frames WHERE session = $1 AND sequence IN
             (SELECT sequence FROM frames WHERE session = $1 LIMIT $2)",
    ),
    Step::Rows(
        "DELETE FROM points WHERE session = $1 AND id IN (SELECT id FROM points WHERE session = $1 LIMIT $2)",
    ),
    Step::Cells {
        select: "SELECT key FROM point_cells
             WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $3) LIMIT $2",
        delete: "DELETE FROM point_cells WHERE key IN IDS($1)",
    },
    Step::Rows(
        "DELETE FROM lines WHERE session = $1 AND id IN (SELECT id FROM lines WHERE session = $1 LIMIT $2)",
    ),
    Step::Cells {
        select: "SELECT key FROM line_cells
             WHERE session_min = $1 AND key BETWEEN ($1 << 40) AND (($1 << 40) | $3) LIMIT $2",
        delete: "DELETE FROM line_cells WHERE key IN IDS($1)",
    },
    Step::Rows(
        "DELETE FROM keyframe_vanishing WHERE session = $1 AND keyframe IN
             (SELECT keyframe FROM keyframe_vanishing WHERE session = $1 LIMIT $2 / 10)",
    ),
    Step::Rows(
        "DELETE FROM removed_keyframes WHERE session = $1 AND id IN
             (SELECT id FROM removed_keyframes WHERE session = $1 LIMIT $2)",
    ),
];

impl Store {
    /// Deletes a session with everything in it. What a camera that was added to another session's map has put
    /// into that stays there.
    ///
    /// The name is free and the session is gone from every list at once; its rows are cleared away in small
    /// transactions, so that others go on being stored meanwhile. Should that be interrupted, the next
    /// [`Store::open`] finishes it.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`] if there is none of this name, [`StoreError::MapInUse`] if other
    /// sessions' cameras extend its map.
    pub async fn delete_session(&self, id: &str) -> Result<(), StoreError> {
        let mut transaction = self.begin_write().await?;
        transaction.hold(id).await?;
        check_unused(&mut transaction, id).await?;
        let number: Option<i64> =
            query("UPDATE sessions SET id = NULL, map = NULL WHERE id = $1 RETURNING number")
                .bind(id)
                .scalar(&mut transaction)
                .await?;
        let number = number.ok_or_else(|| StoreError::SessionNotFound { id: id.to_owned() })?;
        transaction.commit().await?;
        match self.clear_session(number).await {
            // It is gone from every list; what cannot be read of it stays in the file.
            Err(StoreError::Corrupt(what)) => {
                tracing::error!("a deleted session cannot be cleared away, its rows are damaged: {what}");
                Ok(())
            }
            cleared => cleared,
        }
    }

    /// Finishes deletions that were interrupted.
    pub(crate) async fn clear_deleted_sessions(&self) -> Result<(), StoreError> {
        let mut reader = self.reader().await?;
        let numbers: Vec<i64> =
            query("SELECT number FROM sessions WHERE id IS NULL").scalars(&mut reader).await?;
        drop(reader);
        for number in numbers {
            tracing::info!(number, "clearing away a session whose deletion was interrupted");
            self.clear_session(number).await?;
        }
        Ok(())
    }

    async fn clear_session(&self, number: i64) -> Result<(), StoreError> {
        for step in &STEPS {
            while self.delete_some(step, number).await? > 0 {}
        }
        // The keyframes and primitives go with the session's row.
        let mut transaction = self.begin_write().await?;
        delete_row(&mut transaction, number).await?;
        transaction.commit().await
    }

    /// How many rows the step found.
    async fn delete_some(&self, step: &Step, number: i64) -> Result<u64, StoreError> {
        let mut transaction = self.begin_write().await?;
        let n_deleted = match step {
            Step::Rows(delete) => {
                query(*delete).bind(number).bind(ROWS_PER_STEP).execute(&mut transaction).await?
            }
            Step::Cells { select, delete } => {
                let keys = query(*select).bind(number).bind(ROWS_PER_STEP).bind(MAX_POINT_ID as i64);
                let keys: Vec<i64> = keys.scalars(&mut transaction).await?;
                let n_keys = keys.len() as u64;
                query(*delete).bind(keys).execute(&mut transaction).await?;
                n_keys
            }
        };
        transaction.commit().await?;
        Ok(n_deleted)
    }
}

async fn delete_row(connection: &mut Connection, number: i64) -> Result<(), StoreError> {
    query("DELETE FROM sessions WHERE number = $1").bind(number).execute(connection).await?;
    Ok(())
}
