//! The names of the server's `session/sync.rs`. Locks and conditions are shuttle's, each use of which is a
//! point where another thread may go on. Tokio's primitives need no runtime; what they wake is a task of
//! shuttle's.

pub use shuttle::sync::{Condvar, Mutex, MutexGuard};
pub use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard, OwnedSemaphorePermit, Semaphore};

/// Tokio's, with a point before each use where another thread may go on.
#[derive(Debug, Default)]
pub struct Notify(tokio::sync::Notify);

impl Notify {
    /// Nothing to tell so far.
    pub fn new() -> Self {
        Self::default()
    }

    /// Wakes whoever waits, or the next one who will.
    pub fn notify_one(&self) {
        shuttle::thread::yield_now();
        self.0.notify_one();
    }

    /// Waits to be woken.
    pub async fn notified(&self) {
        shuttle::future::yield_now().await;
        self.0.notified().await;
    }
}
