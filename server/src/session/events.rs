//! What happens in a session, for whoever watches.

use super::frame::FrameOutcome;
use super::gallery::{Gallery, ShownFrame};
use super::journal::{Journal, Revision};
use slam::MapUpdate;
use slam::map::{KeyframeId, PrimitiveId};
use std::sync::Arc;
use tokio::sync::broadcast;

/// Events kept for a watcher that does not read: two seconds of video. What a slower one misses it is told.
const CAPACITY: usize = 64;

/// Something that happened in a session.
#[derive(Clone, Debug)]
pub enum SessionEvent {
    /// A frame was tracked, or tried to be.
    Frame {
        /// What came of it.
        report: Arc<FrameOutcome>,
        /// Metres per map unit; `None` while the scale is free.
        metres_per_unit: Option<f64>,
    },
    /// The map was changed.
    Map(Arc<MapChange>),
    /// The database holds a newer state of the map.
    Saved(Revision),
    /// The session's options or scale were changed.
    Settings,
}

/// In which way a map was changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapChange {
    /// Keyframes that are new, moved, or see other landmarks than before.
    pub changed_keyframes: Vec<KeyframeId>,
    /// Keyframes that were removed.
    pub removed_keyframes: Vec<KeyframeId>,
    /// Points that are new or changed, and points that were removed.
    pub n_points: [usize; 2],
    /// Lines that are new or changed, and lines that were removed.
    pub n_lines: [usize; 2],
    /// Global primitives that are new or changed.
    pub changed_primitives: Vec<PrimitiveId>,
    /// Global primitives that were removed.
    pub removed_primitives: Vec<PrimitiveId>,
    /// Keyframes, points, lines and primitives the map has now.
    pub totals: [usize; 4],
}

impl MapChange {
    fn of(update: &MapUpdate) -> Self {
        let (changes, map) = (&update.changes, &update.map);
        Self {
            changed_keyframes: changes.keyframes.iter().copied().collect(),
            removed_keyframes: changes.removed_keyframes.iter().copied().collect(),
            n_points: [changes.points.len(), changes.removed_points.len()],
            n_lines: [changes.lines.len(), changes.removed_lines.len()],
            changed_primitives: changes.primitives.iter().copied().collect(),
            removed_primitives: changes.removed_primitives.iter().copied().collect(),
            totals: [map.n_keyframes(), map.n_points(), map.n_lines(), map.n_primitives()],
        }
    }
}

/// Where a session's events go, and what is remembered of them. Costs next to nothing while nobody watches.
#[derive(Clone, Debug)]
pub struct Events {
    sender: broadcast::Sender<SessionEvent>,
    journal: Journal,
    gallery: Gallery,
}

impl Default for Events {
    fn default() -> Self {
        let (journal, gallery) = (Journal::default(), Gallery::default());
        Self { sender: broadcast::Sender::new(CAPACITY), journal, gallery }
    }
}

impl Events {
    /// The events from now on.
    pub fn watch(&self) -> broadcast::Receiver<SessionEvent> {
        self.sender.subscribe()
    }

    /// What changed in the map, commit by commit.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// The last images.
    pub fn gallery(&self) -> &Gallery {
        &self.gallery
    }

    /// A frame was tracked, or tried to be. `shown` is asked for only if somebody watches.
    pub fn frame(
        &self,
        report: &FrameOutcome,
        metres_per_unit: Option<f64>,
        shown: impl FnOnce() -> Option<ShownFrame>,
    ) {
        if self.sender.receiver_count() > 0 {
            if let Some(shown) = shown() {
                self.gallery.show(shown);
            }
            let _ =
                self.sender.send(SessionEvent::Frame { report: Arc::new(report.clone()), metres_per_unit });
        }
    }

    /// The map was changed.
    pub fn map(&self, update: &MapUpdate) {
        if self.sender.receiver_count() > 0 && !update.changes.is_empty() {
            let _ = self.sender.send(SessionEvent::Map(Arc::new(MapChange::of(update))));
        }
    }

    /// An update is in the database.
    pub fn saved(&self, update: &MapUpdate) {
        let revision = self.journal.note(update);
        let _ = self.sender.send(SessionEvent::Saved(revision));
    }

    /// The session left memory: nothing is remembered of it but how new it is.
    pub fn unloaded(&self) {
        self.journal.forget();
        self.gallery.clear();
    }

    /// The options or the scale were changed.
    pub fn settings(&self) {
        let _ = self.sender.send(SessionEvent::Settings);
    }
}
