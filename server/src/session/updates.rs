//! Updates on their way from the tracking thread to the writer, without I/O.
//!
//! Whatever happens to them is one step under one lock, so that none falls between two steps. That nothing is
//! lost and nobody waits for ever is checked by trying orders of steps (`server/models`).

use super::sync::{Condvar, Mutex, MutexGuard, Notify};
use std::collections::VecDeque;
use std::sync::PoisonError;

/// What waits to be saved.
pub trait Update {
    /// Appends what was handed over later, so that both are saved at once.
    fn join(&mut self, later: Self);
    /// Bytes of what may be left out when too much waits.
    fn ballast_bytes(&self) -> usize;
    /// Leaves that out.
    fn drop_ballast(&mut self);
}

/// How much may wait.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Updates are saved one by one, in transactions of their own; else those that wait are joined.
    pub one_by_one: bool,
    /// One by one, updates that wait before the next one waits for room.
    pub max_ahead: usize,
    /// Bytes of ballast that wait.
    pub max_ballast_bytes: usize,
}

/// See the module's documentation.
#[derive(Debug)]
pub struct Updates<U> {
    bounds: Bounds,
    state: Mutex<State<U>>,
    /// Wakes the writer: something to save, or someone waits for it.
    wake: Notify,
    /// Wakes whoever waits for room.
    room: Condvar,
}

#[derive(Debug)]
struct State<U> {
    waiting: VecDeque<(U, u64)>,
    ballast_bytes: usize,
    n_pushed: u64,
    /// The last attempt to save failed.
    is_failing: bool,
    /// Someone waits for what was handed over to be saved.
    is_hurried: bool,
    /// Nothing more is handed over.
    is_closed: bool,
    /// Nothing more is saved.
    has_ended: bool,
}

/// What is to be saved next.
#[derive(Debug)]
pub struct Taken<U> {
    /// The update.
    pub update: U,
    /// Number of the last one that was handed over in it, from 1.
    pub last_number: u64,
    /// Nothing follows: if it cannot be saved now, it is not tried again.
    pub is_last_attempt: bool,
}

/// What the writer finds.
enum Next<U> {
    Save(Taken<U>),
    Wait,
    End,
}

impl<U: Update> Updates<U> {
    /// Nothing so far.
    pub fn new(bounds: Bounds) -> Self {
        let state = State {
            waiting: VecDeque::new(),
            ballast_bytes: 0,
            n_pushed: 0,
            is_failing: false,
            is_hurried: false,
            is_closed: false,
            has_ended: false,
        };
        Self { bounds, state: Mutex::new(state), wake: Notify::new(), room: Condvar::new() }
    }

    /// Hands an update over, and says whether its ballast was left out. Returns at once, save one by one,
    /// when so many wait as may: then once there is room. Of a disk that fails there is no room to wait for,
    /// and updates are joined; of a writer that has ended there is none to save them, and they are dropped.
    pub fn push(&self, mut update: U) -> bool {
        let mut state = self.lock();
        while self.bounds.one_by_one && self.is_full(&state) && state.is_served() {
            state = self.room.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.n_pushed += 1;
        if state.has_ended {
            return false;
        }
        let n_bytes = update.ballast_bytes();
        let is_too_much = n_bytes > 0 && state.ballast_bytes + n_bytes > self.bounds.max_ballast_bytes;
        if is_too_much {
            update.drop_ballast();
        } else {
            state.ballast_bytes += n_bytes;
        }
        let number = state.n_pushed;
        let is_apart = self.bounds.one_by_one && !self.is_full(&state);
        match state.waiting.back_mut() {
            Some((last, last_number)) if !is_apart => {
                last.join(update);
                *last_number = number;
            }
            _ => state.waiting.push_back((update, number)),
        }
        drop(state);
        self.wake.notify_one();
        is_too_much
    }

    /// Updates handed over so far.
    pub fn n_pushed(&self) -> u64 {
        self.lock().n_pushed
    }

    /// Says that nothing more is handed over.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.room.notify_all();
        self.wake.notify_one();
    }

    /// What is to be saved next, waiting for it; `None` once closed and empty.
    pub async fn next(&self) -> Option<Taken<U>> {
        loop {
            match self.take() {
                Next::Save(taken) => return Some(taken),
                Next::End => return None,
                Next::Wait => self.woken().await,
            }
        }
    }

    /// Waits until there is something to save, or someone waits for it to be.
    pub async fn woken(&self) {
        self.wake.notified().await;
    }

    /// Asks the writer for an attempt now.
    pub fn hurry(&self) {
        self.lock().is_hurried = true;
        self.wake.notify_one();
    }

    /// Waits until someone waits for what was handed over, or nothing more is.
    pub async fn hurried(&self) {
        while !self.is_hurried() {
            self.woken().await;
        }
    }

    fn is_hurried(&self) -> bool {
        let state = self.lock();
        state.is_hurried || state.is_closed
    }

    /// Says that the last update taken was saved.
    pub fn saved(&self) {
        self.lock().is_failing = false;
    }

    /// Puts back what could not be saved.
    pub fn put_back(&self, taken: Taken<U>) {
        let Taken { mut update, mut last_number, .. } = taken;
        let mut state = self.lock();
        state.is_failing = true;
        state.ballast_bytes += update.ballast_bytes();
        if !self.bounds.one_by_one
            && let Some((later, later_number)) = state.waiting.pop_front()
        {
            update.join(later);
            last_number = later_number;
        }
        state.waiting.push_front((update, last_number));
        self.room.notify_all();
    }

    /// Says that nothing more is saved, whatever waits.
    pub fn end(&self) {
        let mut state = self.lock();
        state.has_ended = true;
        state.waiting.clear();
        self.room.notify_all();
    }

    fn take(&self) -> Next<U> {
        let mut state = self.lock();
        let Some((update, last_number)) = state.waiting.pop_front() else {
            return if state.is_closed { Next::End } else { Next::Wait };
        };
        state.ballast_bytes -= update.ballast_bytes();
        state.is_hurried &= !state.waiting.is_empty();
        self.room.notify_all();
        Next::Save(Taken { update, last_number, is_last_attempt: state.is_closed })
    }

    fn is_full(&self, state: &State<U>) -> bool {
        state.waiting.len() >= self.bounds.max_ahead
    }

    /// A panic elsewhere leaves the state whole: no code that can panic runs while it is locked.
    fn lock(&self) -> MutexGuard<'_, State<U>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<U> State<U> {
    /// Whether room will come.
    fn is_served(&self) -> bool {
        !(self.is_failing || self.is_closed || self.has_ended)
    }
}
