//! What changed in a session's map, revision by revision, for viewers that have seen an earlier one.
//!
//! A revision is a commit: whoever reads the database after learning of it sees it, or something newer. The
//! journal is bounded; a viewer that has been away for longer than it reaches back reads the whole map again.

use slam::MapUpdate;
use slam::map::MapChanges;
use std::collections::{BTreeSet, VecDeque};
use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Ids of changed rows kept at most, over all revisions: some megabytes, minutes of mapping.
const MAX_IDS: usize = 200_000;
/// Revisions kept at most.
const MAX_ENTRIES: usize = 4096;

/// A state of a session's map, to be handed back as it was given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Revision {
    /// Which journal counted: another one begins with each start of the server.
    epoch: u64,
    number: u64,
}

/// What changed since a revision.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneChanges {
    /// Rows of the map.
    pub map: MapChanges,
    /// Frames that were added, or placed anew.
    pub sequences: BTreeSet<u64>,
}

/// What a viewer has to read to be up to date.
#[derive(Clone, Debug)]
pub struct Since {
    /// The newest revision; what is read from the database from now on is at least as new.
    pub revision: Revision,
    /// What changed since the revision asked for; `None` if that is not known any more: read everything.
    pub changes: Option<SceneChanges>,
}

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct Journal(Arc<Mutex<Inner>>);

#[derive(Debug)]
struct Inner {
    revision: Revision,
    /// What each of the last revisions changed, the newest last.
    entries: VecDeque<SceneChanges>,
    /// Ids in all entries.
    n_ids: usize,
}

impl Default for Journal {
    fn default() -> Self {
        // Exact in JavaScript's numbers too.
        let epoch = rand::random_range(0..1_u64 << 48);
        let revision = Revision { epoch, number: 0 };
        Self(Arc::new(Mutex::new(Inner { revision, entries: VecDeque::new(), n_ids: 0 })))
    }
}

impl Journal {
    /// Notes an update that is in the database now.
    pub fn note(&self, update: &MapUpdate) -> Revision {
        let sequences = update.frames.iter().map(|frame| frame.sequence).collect();
        let changes = SceneChanges { map: update.changes.clone(), sequences };
        let mut inner = self.lock();
        inner.revision.number += 1;
        inner.n_ids += changes.n_ids();
        inner.entries.push_back(changes);
        while inner.n_ids > MAX_IDS || inner.entries.len() > MAX_ENTRIES {
            let Some(oldest) = inner.entries.pop_front() else { break };
            inner.n_ids -= oldest.n_ids();
        }
        inner.revision
    }

    /// Forgets what changed, when the session leaves memory: whoever has the newest revision still has it.
    pub fn forget(&self) {
        let mut inner = self.lock();
        inner.entries.clear();
        inner.n_ids = 0;
    }

    /// What changed since a revision.
    pub fn since(&self, known: Option<Revision>) -> Since {
        let inner = self.lock();
        let n_behind = known
            .filter(|known| known.epoch == inner.revision.epoch)
            .and_then(|known| usize::try_from(inner.revision.number.checked_sub(known.number)?).ok())
            .filter(|n_behind| *n_behind <= inner.entries.len());
        let changes = n_behind.map(|n_behind| {
            let mut all = SceneChanges::default();
            for later in inner.entries.iter().skip(inner.entries.len() - n_behind) {
                all.map.merge(later.map.clone());
                all.sequences.extend(&later.sequences);
            }
            all
        });
        Since { revision: inner.revision, changes }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SceneChanges {
    fn n_ids(&self) -> usize {
        let map = &self.map;
        let kept = map.keyframes.len() + map.points.len() + map.lines.len() + map.primitives.len();
        let removed = map.removed_keyframes.len() + map.removed_points.len();
        let removed = removed + map.removed_lines.len() + map.removed_primitives.len();
        kept + removed + self.sequences.len()
    }
}

impl fmt::Display for Revision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.epoch, self.number)
    }
}

impl FromStr for Revision {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (epoch, number) = text.split_once('-').ok_or(())?;
        Ok(Self { epoch: epoch.parse().map_err(|_| ())?, number: number.parse().map_err(|_| ())? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slam::Map;
    use slam::map::PointId;

    fn update(changed: &[u64], removed: &[u64]) -> MapUpdate {
        let ids = |ids: &[u64]| ids.iter().filter_map(|id| PointId::new(*id)).collect();
        let changes =
            MapChanges { points: ids(changed), removed_points: ids(removed), ..MapChanges::default() };
        MapUpdate { map: Arc::new(Map::default()), changes, frames: Vec::new() }
    }

    fn points(since: &Since) -> Option<(Vec<u64>, Vec<u64>)> {
        let map = &since.changes.as_ref()?.map;
        let numbers = |ids: &BTreeSet<PointId>| ids.iter().map(|id| id.get()).collect();
        Some((numbers(&map.points), numbers(&map.removed_points)))
    }

    #[test]
    fn a_viewer_is_told_what_changed_since_it_looked() {
        let journal = Journal::default();
        let first = journal.note(&update(&[1, 2], &[]));
        let second = journal.note(&update(&[2, 3], &[]));
        journal.note(&update(&[4], &[3]));
        assert_eq!(points(&journal.since(Some(first))), Some((vec![2, 4], vec![3])));
        assert_eq!(points(&journal.since(Some(second))), Some((vec![4], vec![3])));
        let newest = journal.since(Some(second)).revision;
        assert_eq!(points(&journal.since(Some(newest))), Some((vec![], vec![])));
    }

    #[test]
    fn an_unknown_revision_means_everything() {
        let (journal, other) = (Journal::default(), Journal::default());
        let known = journal.note(&update(&[1], &[]));
        assert!(journal.since(None).changes.is_none());
        assert!(other.since(Some(known)).changes.is_none(), "a revision of another start of the server");
        let ahead = Revision { number: known.number + 1, ..known };
        assert!(journal.since(Some(ahead)).changes.is_none());
    }

    #[test]
    fn a_forgotten_journal_still_knows_who_is_up_to_date() {
        let journal = Journal::default();
        let first = journal.note(&update(&[1], &[]));
        let newest = journal.note(&update(&[2], &[]));
        journal.forget();
        assert_eq!(points(&journal.since(Some(newest))), Some((vec![], vec![])));
        assert!(journal.since(Some(first)).changes.is_none());
        let later = journal.note(&update(&[3], &[]));
        assert_eq!(points(&journal.since(Some(newest))), Some((vec![3], vec![])));
        assert_eq!(journal.since(None).revision, later);
    }

    #[test]
    fn the_journal_stays_within_its_bounds() {
        let journal = Journal::default();
        let first = journal.note(&update(&[1], &[]));
        let many: Vec<u64> = (1..=1000).collect();
        (0..2 * MAX_IDS / many.len()).for_each(|_| _ = journal.note(&update(&many, &[])));
        let inner = journal.lock();
        assert!(inner.n_ids <= MAX_IDS && inner.n_ids > MAX_IDS / 2, "{}", inner.n_ids);
        drop(inner);
        assert!(journal.since(Some(first)).changes.is_none());
    }

    #[test]
    fn revisions_come_back_from_their_text() {
        let revision = Journal::default().note(&update(&[], &[]));
        assert_eq!(revision.to_string().parse(), Ok(revision));
        for text in ["", "7", "-", "7-", "a-1", "1-2-3"] {
            assert!(text.parse::<Revision>().is_err(), "{text}");
        }
    }
}
