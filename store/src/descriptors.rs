//! What a map's points look like, without the rest of it: enough to tell whether an image may show the map.

use crate::cameras::map_number;
use crate::engine::query;
use crate::load::blocking;
use crate::number::keyframe_id;
use crate::{Store, StoreError};
use slam::map::KeyframeId;
use std::collections::BTreeMap;
use vision::Descriptor;

/// Points read at a time, half a megabyte.
const POINTS_PER_STEP: i64 = 8192;

impl Store {
    /// The descriptors of a session's points, by the keyframe that made each.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if a row is damaged.
    pub async fn point_descriptors(
        &self,
        session: &str,
    ) -> Result<BTreeMap<KeyframeId, Vec<Descriptor>>, StoreError> {
        let mut transaction = self.begin_read().await?;
        let number = map_number(&mut transaction, session).await?;
        let (mut all, mut after) = (BTreeMap::<KeyframeId, Vec<Descriptor>>::new(), 0_i64);
        loop {
            let rows = query(
                "SELECT id, created_by, descriptor FROM points WHERE session = $1 AND id > $2 ORDER BY id LIMIT $3",
            )
            .bind(number)
            .bind(after)
            .bind(POINTS_PER_STEP)
            .fetch_all(&mut transaction)
            .await?;
            let Some(last) = rows.last() else { break };
            after = last.try_get(0)?;
            all = blocking(move || {
                for row in &rows {
                    let bytes: &[u8] = row.try_get(2)?;
                    let bytes: [u8; 32] = bytes
                        .try_into()
                        .map_err(|_| StoreError::Corrupt("a descriptor is not of 32 bytes".to_owned()))?;
                    let maker = keyframe_id(row.try_get(1)?)?;
                    all.entry(maker).or_default().push(Descriptor::from_bytes(&bytes));
                }
                Ok(all)
            })
            .await?;
        }
        transaction.commit().await?;
        Ok(all)
    }
}
