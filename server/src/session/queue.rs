//! The frames of one stream that wait for their turn.
//!
//! An async producer (the network) on one side, a thread (the decoder) on the other. What happens when the
//! queue is full is the stream's policy: LOSSLESS waits, which holds the client back through HTTP/2's flow
//! control; REALTIME drops the oldest frame and leaves a marker in its place, so that answers keep the order
//! of arrival.

use super::frame::{Rejection, SentFrame};
use crate::error::ApiError;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

/// Markers of dropped and rejected frames that wait to be answered, at most. They are small, but a client
/// that does not read its answers must not grow them without end: beyond this it is held back, whatever the
/// policy.
const MAX_MARKERS: usize = 4096;

/// What happens to frames that come faster than they are tracked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// Every frame is tracked; the client waits.
    Lossless,
    /// The newest frames are tracked, the others dropped.
    Realtime,
}

/// One place in the queue.
#[derive(Clone, Debug)]
pub enum Queued {
    /// A frame to track.
    Frame(SentFrame),
    /// A frame that newer ones pushed out.
    Dropped(u64),
    /// A frame that was found unusable on arrival.
    Rejected(Rejection),
}

/// How a stream ended: by the client's will, or with an error.
pub type Ending = Result<(), ApiError>;

/// See the module's documentation.
#[derive(Debug)]
pub struct FrameQueue {
    policy: Policy,
    capacity: usize,
    opened: Instant,
    state: Mutex<State>,
    filled: Condvar,
    /// Wakes the producer when there is room or the queue is closed.
    changed: Notify,
}

#[derive(Debug, Default)]
struct State {
    items: VecDeque<Queued>,
    n_frames: usize,
    ending: Option<Ending>,
    /// When something was put in or taken out last; `None` before the first frame.
    last_use: Option<Instant>,
}

/// The queue takes nothing more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Closed;

impl FrameQueue {
    /// A queue for up to `capacity` frames.
    pub fn new(policy: Policy, capacity: usize) -> Self {
        let (state, filled, changed) = (Mutex::default(), Condvar::new(), Notify::new());
        Self { policy, capacity, opened: Instant::now(), state, filled, changed }
    }

    /// Adds to the queue, waiting for room where the policy says so.
    ///
    /// # Errors
    /// If the queue was closed before there was room.
    pub async fn push(&self, item: Queued) -> Result<(), Closed> {
        let mut item = Some(item);
        loop {
            let changed = self.changed.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if let Some(outcome) = self.try_push(&mut item) {
                return outcome;
            }
            changed.await;
        }
    }

    /// `None` if there is no room now.
    fn try_push(&self, item: &mut Option<Queued>) -> Option<Result<(), Closed>> {
        let mut state = self.lock();
        if state.ending.is_some() {
            return Some(Err(Closed));
        }
        if state.items.len() >= self.capacity + MAX_MARKERS {
            return None;
        }
        if matches!(item, Some(Queued::Frame(_))) {
            if state.n_frames >= self.capacity {
                match self.policy {
                    Policy::Lossless => return None,
                    Policy::Realtime => state.drop_oldest_frame(),
                }
            }
            state.n_frames += 1;
        }
        state.items.extend(item.take());
        state.last_use = Some(Instant::now());
        self.filled.notify_one();
        Some(Ok(()))
    }

    /// Takes the oldest item, waiting for one; `None` once the queue is closed and empty.
    pub fn pop_blocking(&self) -> Option<Queued> {
        let mut state = self.lock();
        loop {
            if let Some(item) = state.items.pop_front() {
                if matches!(item, Queued::Frame(_)) {
                    state.n_frames -= 1;
                }
                state.last_use = Some(Instant::now());
                self.changed.notify_waiters();
                return Some(item);
            }
            if state.ending.is_some() {
                return None;
            }
            state = self.filled.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Takes nothing more; what is queued is still served. The first ending stands.
    pub fn close(&self, ending: Ending) {
        let mut state = self.lock();
        state.ending.get_or_insert(ending);
        self.filled.notify_all();
        self.changed.notify_waiters();
    }

    /// Takes nothing more and forgets what is queued. The first ending stands.
    pub fn abort(&self, ending: Ending) {
        let mut state = self.lock();
        state.ending.get_or_insert(ending);
        state.items.clear();
        state.n_frames = 0;
        self.filled.notify_all();
        self.changed.notify_waiters();
    }

    /// Waits until the queue is closed.
    pub async fn closed(&self) {
        loop {
            let changed = self.changed.notified();
            tokio::pin!(changed);
            changed.as_mut().enable();
            if self.is_closed() {
                return;
            }
            changed.await;
        }
    }

    /// Whether the queue is closed.
    pub fn is_closed(&self) -> bool {
        self.lock().ending.is_some()
    }

    /// How the stream ended, once it has.
    pub fn ending(&self) -> Option<Ending> {
        self.lock().ending.clone()
    }

    /// What happens to frames that come too fast.
    pub fn policy(&self) -> Policy {
        self.policy
    }

    /// For how long nothing has come and nothing waited.
    pub fn idle_for(&self) -> Duration {
        let state = self.lock();
        if !state.items.is_empty() {
            return Duration::ZERO;
        }
        state.last_use.unwrap_or(self.opened).elapsed()
    }

    /// Frames that wait.
    pub fn n_frames(&self) -> usize {
        self.lock().n_frames
    }

    /// A panic elsewhere leaves the state whole: no code that can panic runs while it is locked.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn drop_oldest_frame(&mut self) {
        let oldest = self.items.iter_mut().find(|item| matches!(item, Queued::Frame(_)));
        if let Some(item) = oldest
            && let Queued::Frame(frame) = item
        {
            *item = Queued::Dropped(frame.sequence);
            self.n_frames -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::frame::{Encoding, SentImage};

    fn frame(sequence: u64) -> Queued {
        let image = SentImage {
            encoding: Encoding::Auto,
            width: 0,
            height: 0,
            row_stride: 0,
            data: bytes::Bytes::new(),
        };
        Queued::Frame(SentFrame { sequence, timestamp_ns: 0, image, arrived: Instant::now(), charge: None })
    }

    fn drained(queue: &FrameQueue) -> Vec<String> {
        queue.close(Ok(()));
        std::iter::from_fn(|| queue.pop_blocking())
            .map(|item| match item {
                Queued::Frame(frame) => format!("frame {}", frame.sequence),
                Queued::Dropped(sequence) => format!("dropped {sequence}"),
                Queued::Rejected(rejection) => format!("rejected {}", rejection.sequence),
            })
            .collect()
    }

    #[tokio::test]
    async fn realtime_keeps_the_newest_frames_and_the_order_of_arrival() {
        let queue = FrameQueue::new(Policy::Realtime, 2);
        for sequence in 0..5 {
            queue.push(frame(sequence)).await.unwrap();
        }
        assert_eq!(drained(&queue), ["dropped 0", "dropped 1", "dropped 2", "frame 3", "frame 4"]);
    }

    #[tokio::test]
    async fn lossless_waits_for_room() {
        let queue = FrameQueue::new(Policy::Lossless, 2);
        queue.push(frame(0)).await.unwrap();
        queue.push(frame(1)).await.unwrap();
        let third = queue.push(frame(2));
        tokio::pin!(third);
        let waited = tokio::time::timeout(Duration::from_millis(20), &mut third).await;
        assert!(waited.is_err(), "a full queue took a frame");
        queue.pop_blocking();
        tokio::time::timeout(Duration::from_secs(5), third).await.unwrap().unwrap();
        assert_eq!(drained(&queue), ["frame 1", "frame 2"]);
    }

    #[tokio::test]
    async fn closing_wakes_a_producer_that_waits_and_the_first_ending_stands() {
        let queue = FrameQueue::new(Policy::Lossless, 1);
        queue.push(frame(0)).await.unwrap();
        let second = queue.push(frame(1));
        tokio::pin!(second);
        assert!(tokio::time::timeout(Duration::from_millis(20), &mut second).await.is_err());
        queue.abort(Err(ApiError::new(crate::error::ErrorCode::TakenOver, "taken")));
        assert_eq!(second.await, Err(Closed));
        queue.close(Ok(()));
        assert!(queue.ending().unwrap().is_err());
        assert!(queue.pop_blocking().is_none());
    }
}
