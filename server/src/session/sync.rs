//! What the types that `server/models` checks synchronize with. There the same names stand for primitives
//! that try many orders of steps.

pub use std::sync::{Condvar, Mutex, MutexGuard};
pub use tokio::sync::{Mutex as AsyncMutex, Notify, OwnedMutexGuard, OwnedSemaphorePermit, Semaphore};
