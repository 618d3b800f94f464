//! What takes long and goes on whether or not its client is there: adjusting a map, joining two.
//!
//! Operations wait for their turn, owner by owner, so that nobody's many hold up another's one. They are
//! known to this process alone: a restart forgets them, and since each saves its result in one transaction at
//! its end, one that was cut short has changed nothing.

mod queue;
mod run;

pub use queue::{Kind, Operation, Outcome, State};

use crate::access::Caller;
use crate::error::{ApiError, ErrorCode};
use crate::fleet::operation_tag;
use crate::session::{Registry, SessionId};
use queue::{Limits, New, Queue};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use store::Store;
use tokio::sync::Notify;

/// What operations work with.
#[derive(Clone)]
pub struct Tools {
    /// The sessions.
    pub registry: Arc<Registry>,
    /// The database.
    pub store: Store,
}

/// See the module's documentation. Clones are the same.
#[derive(Clone)]
pub struct Operations(Arc<Inner>);

struct Inner {
    queue: Mutex<Queue>,
    /// Told when an operation has ended.
    ended: Notify,
    tools: Tools,
}

impl Operations {
    /// None yet; `n_at_once` run at the same time, and `max_waiting` are known that have not ended.
    pub fn new(tools: Tools, n_at_once: usize, max_waiting: usize) -> Self {
        let tag = tools.store.own_name().map_or_else(String::new, |name| format!("{}-", operation_tag(name)));
        let queue = Mutex::new(Queue::new(Limits { n_at_once, max_unfinished: max_waiting, tag }));
        Self(Arc::new(Inner { queue, ended: Notify::new(), tools }))
    }

    /// Begins an operation, or has it wait for its turn.
    ///
    /// # Errors
    /// If another one works on a session of it or is to, or too many wait.
    pub fn begin(
        &self,
        caller: &Caller,
        kind: Kind,
        session: &SessionId,
        from: Option<&SessionId>,
    ) -> Result<Operation, ApiError> {
        self.0.tools.registry.check_open()?;
        let created_at_ns = crate::clock::since_1970_ns();
        let owner = owner_of(session);
        let new = New { kind, session: session.clone(), from: from.cloned(), owner, created_at_ns };
        let begun = self.lock().begin(new)?;
        self.start_due();
        Ok(self.lock().get(&begun).unwrap_or_default().seen_by(caller))
    }

    /// An operation on a session that the caller sees.
    ///
    /// # Errors
    /// If there is none of this id.
    pub fn get(&self, caller: &Caller, id: &str) -> Result<Operation, ApiError> {
        let found = self.lock().get(id).filter(|operation| operation.is_seen_by(caller));
        found.map(|operation| operation.seen_by(caller)).ok_or_else(|| not_found(id))
    }

    /// Operations on the caller's sessions, or on one of them, the newest first.
    pub fn list(&self, caller: &Caller, session: Option<&SessionId>) -> Vec<Operation> {
        let all = self.lock().list();
        let of_session = |operation: &Operation| {
            session.is_none_or(|id| {
                operation.session.as_ref() == Some(id) || operation.from.as_ref() == Some(id)
            })
        };
        let seen = all.into_iter().filter(|operation| operation.is_seen_by(caller) && of_session(operation));
        seen.map(|operation| operation.seen_by(caller)).collect()
    }

    /// Asks an operation to end without a result.
    ///
    /// # Errors
    /// If there is none of this id.
    pub fn cancel(&self, caller: &Caller, id: &str) -> Result<Operation, ApiError> {
        self.get(caller, id)?;
        self.lock().cancel(id, crate::clock::since_1970_ns());
        self.0.ended.notify_waiters();
        self.get(caller, id)
    }

    /// Cancels every operation and waits until none runs.
    pub async fn shut_down(&self) {
        loop {
            let ended = self.0.ended.notified();
            tokio::pin!(ended);
            // Listening before looking, so that none ends in between.
            ended.as_mut().enable();
            if self.lock().cancel_all(crate::clock::since_1970_ns()) == 0 {
                return;
            }
            ended.await;
        }
    }

    /// Starts what has its turn.
    fn start_due(&self) {
        while let Some(turn) = self.lock().next() {
            let operations = self.clone();
            tokio::spawn(async move {
                let id = turn.id.clone();
                // On a task of its own: a panic of the engine is an error of this operation.
                let running = tokio::spawn(run::run(operations.0.tools.clone(), turn));
                let outcome = running.await.unwrap_or_else(|error| Err(ApiError::internal(error)));
                let ended_at_ns = crate::clock::since_1970_ns();
                operations.lock().end(&id, outcome, ended_at_ns);
                operations.0.ended.notify_waiters();
                operations.start_due();
            });
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.0.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whose session it is, as its key says.
fn owner_of(session: &SessionId) -> String {
    let key = session.as_str();
    key.split_once(crate::session::OWNER_END).map_or_else(String::new, |(owner, _)| owner.to_owned())
}

fn not_found(id: &str) -> ApiError {
    let shown: String = id.chars().take(64).collect();
    let sentence = format!(
        "there is no operation {shown:?}, or no longer: a restart of the server forgets them, and one that it cut short \
         has changed nothing"
    );
    ApiError::new(ErrorCode::OperationNotFound, sentence)
}
