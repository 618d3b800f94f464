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
    /// Adjusting a session's map was begun.
    Optimized,
    /// Joining another session with it was begun.
    Merged,
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
            Self::Optimized => "session.optimize",
            Self::Merged => "session.merge",
            Self::Streamed => "session.stream",
        }
    }
}

/// Notes that a caller changed a session.
pub fn record(caller: &Caller, change: Change, id: &SessionId) {
    let (action, who, role, session) = (change.name(), caller.name(), caller.role().name(), id.as_str());
    tracing::info!(target: "audit", action, who, role, session, "{who} did {action} on {session}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_line_says_who_did_what_to_which_session() {
        let log = Log::default();
        let writer = log.clone();
        let lines = tracing_subscriber::fmt().json().with_writer(move || writer.clone()).finish();
        let id = SessionId::within(Some("ann"), "kitchen", "id").unwrap();
        tracing::subscriber::with_default(lines, || record(&Caller::open(), Change::Deleted, &id));
        let line: serde_json::Value = serde_json::from_slice(&log.0.lock().unwrap()).unwrap();
        assert_eq!(line["target"], "audit");
        let fields = &line["fields"];
        assert_eq!((&fields["action"], &fields["who"]), (&"session.delete".into(), &"local".into()));
        assert_eq!((&fields["role"], &fields["session"]), (&"admin".into(), &"ann~kitchen".into()));
    }
}
