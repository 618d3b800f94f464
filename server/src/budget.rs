//! Memory for what clients send and is not worked off yet: one budget for all connections.

use crate::error::{ApiError, ErrorCode};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// What is counted in, bytes: a small message takes as much as one of this size.
const UNIT_BYTES: usize = 1024;

/// How long a message waits for room: frames that are queued are tracked within that, so that a client is
/// held back and not refused.
const PATIENCE: Duration = Duration::from_secs(5);

/// When a client that was refused may try again.
const RETRY_AFTER: Duration = Duration::from_secs(2);

/// See the module's documentation.
#[derive(Debug)]
pub struct Budget {
    room: Arc<Semaphore>,
    n_bytes: usize,
    patience: Duration,
}

/// Room that a message takes until this is dropped.
#[derive(Debug)]
pub struct Charge(OwnedSemaphorePermit);

impl Budget {
    /// Room for so many bytes.
    pub fn new(n_bytes: usize) -> Self {
        Self::with_patience(n_bytes, PATIENCE)
    }

    /// As [`Self::new`], where messages wait for so long.
    pub fn with_patience(n_bytes: usize, patience: Duration) -> Self {
        let n_units = (n_bytes / UNIT_BYTES).clamp(1, Semaphore::MAX_PERMITS);
        Self { room: Arc::new(Semaphore::new(n_units)), n_bytes, patience }
    }

    /// Room for a message of so many bytes, once there is some. Who waits longest comes first.
    ///
    /// # Errors
    /// If there is none in time, or could never be as much.
    pub async fn take(&self, n_bytes: usize) -> Result<Charge, ApiError> {
        // What never fits must not hold up those that wait behind it.
        if n_bytes > self.n_bytes {
            return Err(self.refusal());
        }
        let n_units = u32::try_from(n_bytes.div_ceil(UNIT_BYTES).max(1)).unwrap_or(u32::MAX);
        let taken = tokio::time::timeout(self.patience, self.room.clone().acquire_many_owned(n_units)).await;
        match taken {
            Ok(Ok(permit)) => Ok(Charge(permit)),
            _ => Err(self.refusal()),
        }
    }

    fn refusal(&self) -> ApiError {
        metrics::counter!("monoslam_messages_refused_total").increment(1);
        let sentence = format!(
            "this server holds {} bytes of messages that are not finished or not worked off, as many as it may; send it \
             again in a moment, or one at a time",
            self.n_bytes
        );
        ApiError::new(ErrorCode::TooBusy, sentence).retry_after(RETRY_AFTER)
    }

    /// Bytes that are taken.
    pub fn n_taken_bytes(&self) -> usize {
        self.n_bytes.saturating_sub(self.room.available_permits() * UNIT_BYTES)
    }
}

impl Charge {
    /// The room of both, of the same budget.
    pub fn and(mut self, other: Self) -> Self {
        self.0.merge(other.0);
        self
    }
}

/// What the messages of one request take: each until whoever works it off has done so.
#[derive(Clone, Debug, Default)]
pub struct Charges(Arc<Mutex<std::collections::VecDeque<Charge>>>);

impl Charges {
    /// The next message is complete.
    pub fn push(&self, charge: Charge) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push_back(charge);
    }

    /// That of the oldest message, which was read just now.
    pub fn pop(&self) -> Option<Charge> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_does_not_fit_waits_and_is_refused_in_the_end() {
        let patience = Duration::from_millis(400);
        let budget = Arc::new(Budget::with_patience(10 * UNIT_BYTES, patience));
        let first = budget.take(8 * UNIT_BYTES).await.unwrap();
        assert_eq!(budget.n_taken_bytes(), 8 * UNIT_BYTES);
        let error = budget.take(3 * UNIT_BYTES).await.unwrap_err();
        assert!(error.code == ErrorCode::TooBusy && error.retry_after.is_some(), "{error:?}");
        let waiting = tokio::spawn({
            let budget = budget.clone();
            async move { budget.take(3 * UNIT_BYTES).await }
        });
        tokio::time::sleep(patience / 8).await;
        drop(first);
        assert!(waiting.await.unwrap().is_ok(), "there is room again");
        let asked = std::time::Instant::now();
        assert!(budget.take(11 * UNIT_BYTES).await.is_err(), "more than all");
        assert!(asked.elapsed() < patience / 2, "refused at once, and not after those behind it have waited");
        assert_eq!(budget.n_taken_bytes(), 0);
    }
}
