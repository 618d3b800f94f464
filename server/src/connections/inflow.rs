//! What a connection brings after it was upgraded, counted as it comes: a WebSocket's messages are put
//! together where nobody sees them before they are complete.

use crate::budget::{Budget, Charge};
use crate::error::ApiError;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll};

/// Shared by a connection's socket and by who reads its messages.
#[derive(Clone, Debug)]
pub struct Inflow(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    budget: Arc<Budget>,
    /// Set once what comes is counted.
    is_counted: OnceLock<()>,
    charge: Mutex<Option<Charge>>,
    refusal: OnceLock<ApiError>,
}

/// Room that is waited for.
pub type Waiting = Pin<Box<dyn Future<Output = Result<Charge, ApiError>> + Send>>;

impl Inflow {
    /// Nothing is counted yet.
    pub fn new(budget: Arc<Budget>) -> Self {
        let (is_counted, charge, refusal) = (OnceLock::new(), Mutex::default(), OnceLock::new());
        Self(Arc::new(Shared { budget, is_counted, charge, refusal }))
    }

    /// Counts what comes from now on.
    pub fn count(&self) {
        let _ = self.0.is_counted.set(());
    }

    /// What has come since this was last called: the room of the message that is complete now, and of the
    /// beginning of the next.
    pub fn take(&self) -> Option<Charge> {
        self.lock().take()
    }

    /// Why nothing more is read, if there was no room.
    pub fn refusal(&self) -> Option<ApiError> {
        self.0.refusal.get().cloned()
    }

    /// Waits for the room of what was read before.
    ///
    /// # Errors
    /// If there is none in time.
    pub(super) fn poll(&self, waiting: &mut Option<Waiting>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Some(charge) = waiting.as_mut() else { return Poll::Ready(Ok(())) };
        let charge = std::task::ready!(charge.as_mut().poll(cx));
        *waiting = None;
        match charge {
            Ok(charge) => {
                let mut all = self.lock();
                *all = Some(match all.take() {
                    Some(before) => before.and(charge),
                    None => charge,
                });
                Poll::Ready(Ok(()))
            }
            Err(refusal) => {
                let sentence = refusal.to_string();
                let _ = self.0.refusal.set(refusal);
                Poll::Ready(Err(io::Error::other(sentence)))
            }
        }
    }

    /// So much was read.
    pub(super) fn note(&self, n_bytes: usize) -> Option<Waiting> {
        if n_bytes == 0 || self.0.is_counted.get().is_none() {
            return None;
        }
        let budget = self.0.budget.clone();
        Some(Box::pin(async move { budget.take(n_bytes).await }))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Charge>> {
        self.0.charge.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
