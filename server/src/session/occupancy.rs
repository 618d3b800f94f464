//! Which sessions an operation works on, so that whoever wants one of them is told instead of waiting for
//! long.

use super::SessionId;
use crate::error::{ApiError, ErrorCode};
use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The sessions that operations work on.
#[derive(Debug, Default)]
pub struct Occupancy(Mutex<BTreeSet<SessionId>>);

/// The mark on sessions, as long as it is kept.
#[derive(Debug)]
pub struct Occupied<'a> {
    all: &'a Occupancy,
    ids: BTreeSet<SessionId>,
}

impl Occupancy {
    /// Marks sessions.
    ///
    /// # Errors
    /// If one of them is marked already; then none is.
    pub fn mark(&self, ids: &BTreeSet<SessionId>) -> Result<Occupied<'_>, ApiError> {
        let mut marked = self.lock();
        if let Some(taken) = ids.iter().find(|id| marked.contains(*id)) {
            return Err(busy(taken));
        }
        marked.extend(ids.iter().cloned());
        Ok(Occupied { all: self, ids: ids.clone() })
    }

    /// Whether a session may be used.
    ///
    /// # Errors
    /// If it is marked.
    pub fn check(&self, id: &SessionId) -> Result<(), ApiError> {
        if self.lock().contains(id) { Err(busy(id)) } else { Ok(()) }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeSet<SessionId>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Occupied<'_> {
    fn drop(&mut self) {
        let mut marked = self.all.lock();
        marked.retain(|id| !self.ids.contains(id));
    }
}

fn busy(id: &SessionId) -> ApiError {
    let sentence = format!(
        "an operation works on session {id}; wait until it has ended, or cancel it (operations list)"
    );
    ApiError::new(ErrorCode::SessionBusy, sentence)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_last_as_long_as_they_are_kept_and_all_or_none_is_marked() {
        let [a, b] = ["a", "b"].map(|name| SessionId::parse(name, "id").unwrap());
        let all = Occupancy::default();
        let first = all.mark(&BTreeSet::from([a.clone()])).unwrap();
        assert_eq!(
            all.mark(&BTreeSet::from([a.clone(), b.clone()])).unwrap_err().code,
            ErrorCode::SessionBusy
        );
        assert!(all.check(&a).is_err() && all.check(&b).is_ok());
        drop(first);
        assert!(all.check(&a).is_ok());
    }
}
