//! Which keyframes see the same landmarks.

use crate::blob::decode_observations;
use crate::engine::{Row, query};
use crate::load::blocking;
use crate::{MapSnapshot, StoreError};
use slam::map::{KeyframeId, Observation};
use std::collections::BTreeMap;

/// What two keyframes both see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharedLandmarks {
    /// Points seen by both.
    pub n_points: u32,
    /// Lines seen by both.
    pub n_lines: u32,
}

/// Pairs of keyframes, the lower id first, that see something in common.
pub type Covisibility = BTreeMap<(KeyframeId, KeyframeId), SharedLandmarks>;

/// Landmarks whose observations are counted at a time, so that no other task waits for long.
const LANDMARKS_PER_STEP: i64 = 4096;

impl MapSnapshot {
    /// Counts what each pair of keyframes sees in common. Holds the pairs, some twenty for each keyframe.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn covisibility(&mut self) -> Result<Covisibility, StoreError> {
        let points = self.count_pairs("points", Covisibility::new(), |shared| &mut shared.n_points).await?;
        self.count_pairs("lines", points, |shared| &mut shared.n_lines).await
    }

    async fn count_pairs(
        &mut self,
        table: &str,
        mut pairs: Covisibility,
        count: fn(&mut SharedLandmarks) -> &mut u32,
    ) -> Result<Covisibility, StoreError> {
        let sql = format!(
            "SELECT id, observations FROM {table} WHERE session = $1 AND id > $2 ORDER BY id LIMIT {LANDMARKS_PER_STEP}"
        );
        let (session, mut after) = (self.session(), 0_i64);
        loop {
            // Safe: the text is made of constants.
            let rows: Vec<Row> =
                query(sql.clone()).bind(session).bind(after).fetch_all(self.connection()).await?;
            let Some(last) = rows.last() else { return Ok(pairs) };
            after = last.try_get(0)?;
            let counted = blocking(move || {
                for row in &rows {
                    let observations = decode_observations(row.try_get(1)?)
                        .map_err(|error| StoreError::Corrupt(error.to_string()))?;
                    add_pairs(&mut pairs, &observations, count);
                }
                Ok(pairs)
            });
            pairs = counted.await?;
        }
    }
}

fn add_pairs(
    pairs: &mut Covisibility,
    observations: &[Observation],
    count: fn(&mut SharedLandmarks) -> &mut u32,
) {
    // Observations are in the order of the keyframes' ids, so the lower one comes first.
    for (idx, first) in observations.iter().enumerate() {
        for second in &observations[idx + 1..] {
            *count(pairs.entry((first.keyframe, second.keyframe)).or_default()) += 1;
        }
    }
}
