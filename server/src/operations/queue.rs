//! Operations that wait, run and have ended, and whose turn it is. No I/O.

use crate::access::Caller;
use crate::error::{ApiError, ErrorCode};
use crate::session::{Adjusted, Joined, SessionId};
use slam::Work;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Operations that have ended and are still told of.
const MAX_ENDED: usize = 512;
/// Share of the operations known that have not ended that one owner may have.
const OWNERS_SHARE: usize = 4;

/// What kind of operation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Global bundle adjustment of a map.
    #[default]
    Optimize,
    /// Joining two maps.
    Merge,
}

/// How far an operation is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// It waits for its turn.
    #[default]
    Queued,
    /// It runs.
    Running,
    /// It has ended with a result.
    Done,
    /// It has ended with an error.
    Failed,
    /// It was ended without a result.
    Cancelled,
}

/// What an operation came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// A map was adjusted.
    Adjusted(Adjusted),
    /// Two maps were joined, or nothing was found that both show.
    Joined(Joined),
    /// It was given up.
    Cancelled,
}

/// An operation, as it is told.
#[derive(Clone, Debug, Default)]
pub struct Operation {
    /// Its name.
    pub id: String,
    /// What kind.
    pub kind: Kind,
    /// The session it changes.
    pub session: Option<SessionId>,
    /// Of a merger: the session that is taken in.
    pub from: Option<SessionId>,
    /// How far it is.
    pub state: State,
    /// Share that is done, 0 to 1.
    pub progress: f64,
    /// Iterations of optimization so far.
    pub n_iterations: u32,
    /// What came of it.
    pub result: Option<Outcome>,
    /// Why it failed.
    pub error: Option<ApiError>,
    /// Wall-clock time, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// Likewise; `None` before it ends.
    pub ended_at_ns: Option<i64>,
}

impl Operation {
    pub(super) fn is_seen_by(&self, caller: &Caller) -> bool {
        let prefix = caller.prefix();
        self.session.as_ref().is_some_and(|session| session.as_str().starts_with(&prefix))
    }

    /// With the sessions as the caller calls them.
    pub(super) fn seen_by(self, caller: &Caller) -> Self {
        let named = |id: Option<SessionId>| id.map(|id| caller.stored(id.as_str().to_owned()));
        Self { session: named(self.session), from: named(self.from), ..self }
    }

    /// What came of it, or why it failed, in a plain sentence; empty before it ends.
    pub fn message(&self) -> String {
        match (&self.result, &self.error) {
            (_, Some(error)) => error.message.clone(),
            (Some(Outcome::Adjusted(adjusted)), None) => adjusted.sentence(),
            (Some(Outcome::Joined(joined)), None) => joined.sentence(),
            (Some(Outcome::Cancelled), None) => "cancelled; nothing was changed".to_owned(),
            (None, None) => String::new(),
        }
    }
}

/// An operation to be.
pub(super) struct New {
    pub kind: Kind,
    pub session: SessionId,
    pub from: Option<SessionId>,
    /// Whose turn it takes.
    pub owner: String,
    pub created_at_ns: i64,
}

/// An operation whose turn has come.
pub(super) struct Turn {
    pub id: String,
    pub kind: Kind,
    pub session: SessionId,
    pub from: Option<SessionId>,
    pub work: Arc<Work>,
}

#[derive(Clone, Default)]
pub(super) struct Limits {
    /// Operations that run at the same time.
    pub n_at_once: usize,
    /// Operations known that have not ended.
    pub max_unfinished: usize,
    /// Stands in the names of operations, with a `-` behind it; empty where the server is alone.
    pub tag: String,
}

struct Entry {
    operation: Operation,
    owner: String,
    work: Arc<Work>,
}

pub(super) struct Queue {
    limits: Limits,
    entries: BTreeMap<String, Entry>,
    /// In the order they came.
    order: VecDeque<String>,
    /// What waits, owner by owner.
    waiting: BTreeMap<String, VecDeque<String>>,
    /// Whose turn it was last.
    last_owner: String,
    n_running: usize,
}

impl Queue {
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            entries: BTreeMap::new(),
            order: VecDeque::new(),
            waiting: BTreeMap::new(),
            last_owner: String::new(),
            n_running: 0,
        }
    }

    pub fn begin(&mut self, new: New) -> Result<String, ApiError> {
        let New { kind, session, from, owner, created_at_ns } = new;
        self.check_room(&owner)?;
        self.check_sessions(&session, from.as_ref())?;
        let id = format!("op-{}{:016x}", self.limits.tag, rand::random::<u64>());
        let (session, from_session) = (Some(session), from);
        let operation = Operation {
            id: id.clone(),
            kind,
            session,
            from: from_session,
            created_at_ns,
            ..Operation::default()
        };
        self.waiting.entry(owner.clone()).or_default().push_back(id.clone());
        self.order.push_back(id.clone());
        self.entries.insert(id.clone(), Entry { operation, owner, work: Arc::default() });
        self.forget_old();
        Ok(id)
    }

    fn check_room(&self, owner: &str) -> Result<(), ApiError> {
        let unfinished = || self.entries.values().filter(|entry| !entry.has_ended());
        let limit = self.limits.max_unfinished;
        let own_limit = (limit / OWNERS_SHARE).max(1);
        let n_own = unfinished().filter(|entry| entry.owner == owner).count();
        // Without owners all sessions are one's.
        let is_over = if owner.is_empty() { n_own >= limit } else { n_own >= own_limit };
        if is_over || unfinished().count() >= limit {
            let sentence = "as many operations wait as this server takes; try again when some have ended";
            return Err(ApiError::new(ErrorCode::TooBusy, sentence));
        }
        Ok(())
    }

    fn check_sessions(&self, session: &SessionId, from: Option<&SessionId>) -> Result<(), ApiError> {
        let concerns = |entry: &&Entry| {
            let theirs = [entry.operation.session.as_ref(), entry.operation.from.as_ref()];
            [Some(session), from].into_iter().flatten().any(|id| theirs.contains(&Some(id)))
        };
        let Some(other) = self.entries.values().filter(|entry| !entry.has_ended()).find(concerns) else {
            return Ok(());
        };
        let id = &other.operation.id;
        let sentence =
            format!("operation {id} works on this session or is about to; wait for it, or cancel it");
        Err(ApiError::new(ErrorCode::SessionBusy, sentence))
    }

    /// What may start now: of the owner after the one whose turn it was last.
    pub fn next(&mut self) -> Option<Turn> {
        if self.n_running >= self.limits.n_at_once {
            return None;
        }
        let after = self
            .waiting
            .range::<String, _>((std::ops::Bound::Excluded(&self.last_owner), std::ops::Bound::Unbounded));
        let owner = after.chain(self.waiting.iter()).next().map(|(owner, _)| owner.clone())?;
        let queue = self.waiting.get_mut(&owner)?;
        let id = queue.pop_front();
        if queue.is_empty() {
            self.waiting.remove(&owner);
        }
        self.last_owner = owner;
        let entry = self.entries.get_mut(&id?)?;
        entry.operation.state = State::Running;
        self.n_running += 1;
        Some(Turn {
            id: entry.operation.id.clone(),
            kind: entry.operation.kind,
            session: entry.operation.session.clone()?,
            from: entry.operation.from.clone(),
            work: entry.work.clone(),
        })
    }

    pub fn end(&mut self, id: &str, outcome: Result<Outcome, ApiError>, now_ns: i64) {
        self.n_running = self.n_running.saturating_sub(1);
        if let Some(entry) = self.entries.get_mut(id) {
            entry.end(outcome, now_ns);
        }
        self.forget_old();
    }

    /// Cancels an operation: at once if it waits, else as soon as it notices.
    pub fn cancel(&mut self, id: &str, now_ns: i64) {
        let Some(entry) = self.entries.get_mut(id).filter(|entry| !entry.has_ended()) else { return };
        entry.work.cancel();
        if entry.operation.state == State::Queued {
            entry.end(Ok(Outcome::Cancelled), now_ns);
            if let Some(queue) = self.waiting.get_mut(&entry.owner) {
                queue.retain(|waiting| waiting != id);
                if queue.is_empty() {
                    self.waiting.remove(&entry.owner);
                }
            }
        }
    }

    /// Cancels every operation; how many still run.
    pub fn cancel_all(&mut self, now_ns: i64) -> usize {
        let ids: Vec<String> = self.order.iter().cloned().collect();
        ids.iter().for_each(|id| self.cancel(id, now_ns));
        self.n_running
    }

    pub fn get(&self, id: &str) -> Option<Operation> {
        self.entries.get(id).map(Entry::told)
    }

    /// The newest first.
    pub fn list(&self) -> Vec<Operation> {
        self.order.iter().rev().filter_map(|id| self.get(id)).collect()
    }

    fn forget_old(&mut self) {
        let mut n_over =
            self.entries.values().filter(|entry| entry.has_ended()).count().saturating_sub(MAX_ENDED);
        let entries = &mut self.entries;
        self.order.retain(|id| {
            let is_old = n_over > 0 && entries.get(id).is_none_or(Entry::has_ended);
            if is_old {
                entries.remove(id);
                n_over -= 1;
            }
            !is_old
        });
    }
}

impl Entry {
    fn has_ended(&self) -> bool {
        self.operation.ended_at_ns.is_some()
    }

    fn end(&mut self, outcome: Result<Outcome, ApiError>, now_ns: i64) {
        let operation = &mut self.operation;
        operation.ended_at_ns = Some(now_ns);
        operation.progress = self.work.share_done();
        operation.n_iterations = self.work.n_iterations();
        match outcome {
            Ok(Outcome::Cancelled) => {
                (operation.state, operation.result) = (State::Cancelled, Some(Outcome::Cancelled));
            }
            Ok(result) => {
                (operation.state, operation.result, operation.progress) = (State::Done, Some(result), 1.0);
            }
            Err(error) => (operation.state, operation.error) = (State::Failed, Some(error)),
        }
    }

    fn told(&self) -> Operation {
        let mut operation = self.operation.clone();
        if !self.has_ended() {
            // It is done when its result is saved.
            operation.progress = self.work.share_done().min(0.99);
            operation.n_iterations = self.work.n_iterations();
        }
        operation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(key: &str) -> New {
        let session = SessionId::parse(key, "session").unwrap();
        let owner = key.split_once('~').map_or("", |(owner, _)| owner).to_owned();
        New { kind: Kind::Optimize, session, from: None, owner, created_at_ns: 1 }
    }

    fn queue(n_at_once: usize, max_unfinished: usize) -> Queue {
        Queue::new(Limits { n_at_once, max_unfinished, ..Limits::default() })
    }

    #[test]
    fn owners_take_turns() {
        let mut queue = queue(1, 40);
        for key in ["ann~1", "ann~2", "ann~3", "bob~1", "cy~1", "bob~2"] {
            queue.begin(new(key)).unwrap();
        }
        let mut turns = Vec::new();
        while let Some(turn) = queue.next() {
            assert!(queue.next().is_none(), "two at once");
            turns.push(turn.session.as_str().to_owned());
            queue.end(&turn.id, Ok(Outcome::Cancelled), 2);
        }
        assert_eq!(turns, ["ann~1", "bob~1", "cy~1", "ann~2", "bob~2", "ann~3"]);
    }

    #[test]
    fn one_session_has_one_operation_and_one_owner_a_share() {
        let mut queue = queue(1, 8);
        let first = queue.begin(new("ann~1")).unwrap();
        assert_eq!(queue.begin(new("ann~1")).unwrap_err().code, ErrorCode::SessionBusy);
        queue.begin(new("ann~2")).unwrap();
        assert_eq!(queue.begin(new("ann~3")).unwrap_err().code, ErrorCode::TooBusy);
        queue.begin(new("bob~1")).unwrap();
        queue.cancel(&first, 3);
        assert_eq!(queue.get(&first).unwrap().state, State::Cancelled);
        queue.begin(new("ann~1")).unwrap();
        // Cancelled while it waited, it has no turn any more.
        let turns: Vec<_> = std::iter::from_fn(|| {
            let turn = queue.next()?;
            queue.end(&turn.id, Ok(Outcome::Cancelled), 4);
            Some(turn.session.as_str().to_owned())
        })
        .collect();
        assert_eq!(turns, ["ann~2", "bob~1", "ann~1"]);
    }

    #[test]
    fn those_that_ended_long_ago_are_forgotten_and_running_ones_notice_a_cancellation() {
        let mut queue = queue(1, 4);
        let oldest = queue.begin(new("s0")).unwrap();
        for i in 1..=MAX_ENDED + 1 {
            let turn = queue.next().unwrap();
            queue.end(&turn.id, Err(ApiError::invalid("x", "y")), 2);
            queue.begin(new(&format!("s{i}"))).unwrap();
        }
        assert!(queue.get(&oldest).is_none());
        assert_eq!(queue.list().len(), MAX_ENDED + 1);
        let turn = queue.next().unwrap();
        assert_eq!(queue.cancel_all(5), 1);
        assert!(turn.work.is_cancelled());
        assert_eq!(queue.get(&turn.id).unwrap().state, State::Running);
    }
}
