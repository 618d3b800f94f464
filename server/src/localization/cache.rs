//! What was made of a session's map, kept for the next question as long as the map stays what it was.

use crate::session::{Revision, SessionId};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use store::{SessionCounts, SessionOptions, SessionRecord};

/// Which state of which session something was made of. A session that was deleted and made anew has another.
#[derive(Clone, Debug, PartialEq)]
pub struct MapState {
    created_at_ns: i64,
    revision: Option<Revision>,
    last_frame: Option<(u64, i64)>,
    counts: SessionCounts,
    options: SessionOptions,
}

impl MapState {
    /// As the row and the journal say. The journal is asked first, so that what is read afterwards is at
    /// least as new.
    pub fn of(record: &SessionRecord, revision: Option<Revision>) -> Self {
        Self {
            created_at_ns: record.created_at_ns,
            revision,
            last_frame: record.last_frame,
            counts: record.counts,
            options: record.options.clone(),
        }
    }
}

/// Things made of maps; the ones that were not used for longest go first.
pub struct Cache<V> {
    entries: Mutex<BTreeMap<SessionId, Entry<V>>>,
    /// What all of it may weigh.
    capacity: usize,
}

struct Entry<V> {
    state: MapState,
    value: V,
    weight: usize,
    used: Instant,
}

impl<V> Cache<V> {
    pub fn new(capacity: usize) -> Self {
        Self { entries: Mutex::default(), capacity }
    }

    /// Takes out what was made of this state; what was made of another one is dropped.
    pub fn take(&self, id: &SessionId, state: &MapState) -> Option<V> {
        let entry = self.lock().remove(id)?;
        (entry.state == *state).then_some(entry.value)
    }

    /// Keeps something, if there is room for it once older things have gone.
    pub fn put(&self, id: SessionId, state: MapState, weight: usize, value: V) {
        if weight > self.capacity {
            return;
        }
        let mut entries = self.lock();
        entries.insert(id, Entry { state, value, weight, used: Instant::now() });
        let mut total: usize = entries.values().map(|entry| entry.weight).sum();
        while total > self.capacity {
            let oldest = entries.iter().min_by_key(|(_, entry)| entry.used).map(|(id, _)| id.clone());
            let Some(gone) = oldest.and_then(|id| entries.remove(&id)) else { break };
            total -= gone.weight;
        }
    }

    /// Drops what was not used for some time.
    pub fn forget_unused(&self, longer_than: Duration) {
        self.lock().retain(|_, entry| entry.used.elapsed() < longer_than);
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<SessionId, Entry<V>>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(created_at_ns: i64) -> MapState {
        MapState {
            created_at_ns,
            revision: None,
            last_frame: None,
            counts: SessionCounts::default(),
            options: SessionOptions::default(),
        }
    }

    fn id(name: &str) -> SessionId {
        SessionId::parse(name, "id").unwrap()
    }

    #[test]
    fn another_state_is_another_map_and_the_oldest_makes_room() {
        let cache = Cache::new(10);
        cache.put(id("a"), state(1), 6, "a");
        assert_eq!(cache.take(&id("a"), &state(2)), None);
        assert_eq!(cache.take(&id("a"), &state(1)), None, "it was dropped");
        cache.put(id("a"), state(1), 6, "a");
        cache.put(id("b"), state(1), 4, "b");
        cache.put(id("c"), state(1), 3, "c");
        assert_eq!(cache.take(&id("a"), &state(1)), None);
        assert_eq!(cache.take(&id("b"), &state(1)), Some("b"));
        cache.put(id("d"), state(1), 11, "too heavy");
        assert_eq!(cache.take(&id("d"), &state(1)), None);
        assert_eq!(cache.take(&id("c"), &state(1)), Some("c"));
        cache.put(id("e"), state(1), 1, "e");
        cache.forget_unused(Duration::ZERO);
        assert_eq!(cache.take(&id("e"), &state(1)), None);
    }
}
