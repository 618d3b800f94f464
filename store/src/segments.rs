//! Segments of a session: parts whose frames have times of one clock.
//!
//! Stored times are the client's. The engine's only go on, also where a client's clock was set back: a
//! segment says by how much they are ahead.

use crate::engine::{Connection, Row, query};
use crate::number::{from_column, to_column};
use crate::{Store, StoreError};

/// By how much the engine's times are ahead of the client's, along a session.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Segments(Vec<(u64, i64)>);

impl Segments {
    /// By how much they are ahead at a frame, nanoseconds.
    pub fn ahead_ns(&self, sequence: u64) -> i64 {
        let begun = self.0.iter().rev().find(|(first, _)| *first <= sequence);
        begun.map_or(0, |(_, ahead_ns)| *ahead_ns)
    }

    /// The engine's time of a frame.
    pub(crate) fn engine_ns(&self, sequence: u64, timestamp_ns: i64) -> i64 {
        timestamp_ns.saturating_add(self.ahead_ns(sequence))
    }

    /// The client's time of a frame.
    pub(crate) fn client_ns(&self, sequence: u64, timestamp_ns: i64) -> i64 {
        timestamp_ns.saturating_sub(self.ahead_ns(sequence))
    }

    pub(crate) async fn read(connection: &mut Connection, session: i64) -> Result<Self, StoreError> {
        let select =
            "SELECT first_sequence, ahead_ns FROM segments WHERE session = $1 ORDER BY first_sequence";
        let rows = query(select).bind(session).fetch_all(connection).await?;
        let parse = |row: &Row| -> Result<(u64, i64), StoreError> {
            Ok((from_column("a segment's first sequence", row.try_get(0)?)?, row.try_get(1)?))
        };
        Ok(Self(rows.iter().map(parse).collect::<Result<_, _>>()?))
    }
}

impl Store {
    /// Begins a segment with a frame that is not stored yet: from there on the engine's times are ahead of
    /// the client's by so much.
    ///
    /// # Errors
    /// [`StoreError::SessionNotFound`], or if it cannot be stored.
    pub async fn begin_segment(&self, id: &str, sequence: u64, ahead_ns: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin_write().await?;
        let (session, _) = transaction.hold(id).await?;
        let insert = "INSERT INTO segments (session, first_sequence, ahead_ns) VALUES ($1, $2, $3) \
             ON CONFLICT (session, first_sequence) DO UPDATE SET ahead_ns = excluded.ahead_ns";
        let insert = query(insert).bind(session).bind(to_column("sequence", sequence)?).bind(ahead_ns);
        insert.execute(&mut transaction).await?;
        let outcome = transaction.commit().await;
        self.place().note(&outcome);
        outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_belongs_to_the_last_segment_that_began() {
        let segments = Segments(vec![(10, 5), (20, -7)]);
        assert_eq!([0, 9, 10, 19, 20, 99].map(|sequence| segments.ahead_ns(sequence)), [0, 0, 5, 5, -7, -7]);
        assert_eq!(segments.client_ns(12, segments.engine_ns(12, 100)), 100);
    }
}
