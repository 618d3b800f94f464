//! What was changed by whom, as lines of the log with the target `audit`.

use super::Caller;
use crate::session::SessionId;

/// What was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A session was made.
    Created,
    /// A session was deleted.
    Deleted,
    /// A session's options were changed.
    Updated,
    /// A session's scale was set or freed.
    Scaled,
    /// A stream of frames into a session was opened.
    Streamed,
}

impl Change {
    /// The stable name of the change.
    pub fn name(self) -> &'static str {
        match self {
            Self::Created => "session.create",
            Self::Deleted => "session.delete",
            Self::Updated => "session.update",
            Self::Scaled => "session.scale",
            Self::Streamed => "session.stream",
        }
    }
}

/// Notes that a caller changed a session.
pub fn record(caller: &Caller, change: Change, id: &SessionId) {
    let (action, who, role, session) = (change.name(), caller.name(), caller.role().name(), id.as_str());
    tracing::info!(target: "audit", action, who, role, session, "{who} did {action} on {session}");
}
