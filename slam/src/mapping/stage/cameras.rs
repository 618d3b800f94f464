//! The cameras that have one map extended: what each is told, and which have been where.

use super::lock;
use crate::map::{CameraId, SubmapId};
use crate::report::MapEvent;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};

/// Corrections of the map that may wait for one camera; beyond it the oldest go, of a camera that shows
/// nothing while others do.
const MAX_WAITING_EVENTS: usize = 256;

/// See the module's documentation.
#[derive(Default)]
pub(super) struct Cameras {
    present: Mutex<Vec<Weak<OneCamera>>>,
    visitors: Mutex<BTreeMap<SubmapId, BTreeSet<CameraId>>>,
}

/// One of them, for as long as its pipeline lives.
pub(super) struct OneCamera {
    pub id: CameraId,
    /// Whether it has had frames processed since it last settled.
    is_active: AtomicBool,
    events: Mutex<Vec<MapEvent>>,
}

impl OneCamera {
    pub fn set_active(&self, is_active: bool) {
        self.is_active.store(is_active, Ordering::Relaxed);
    }

    /// Corrections of the map since the last call, oldest first.
    pub fn take_events(&self) -> Vec<MapEvent> {
        std::mem::take(&mut *lock(&self.events))
    }
}

impl Cameras {
    pub fn add(&self, id: CameraId) -> Arc<OneCamera> {
        let camera = Arc::new(OneCamera { id, is_active: AtomicBool::new(false), events: Mutex::default() });
        let mut present = lock(&self.present);
        present.retain(|other| other.strong_count() > 0);
        present.push(Arc::downgrade(&camera));
        camera
    }

    /// Whether one of them has frames processed.
    pub fn is_any_active(&self) -> bool {
        self.all().iter().any(|camera| camera.is_active.load(Ordering::Relaxed))
    }

    /// Tells every camera what corrected the map.
    pub fn tell(&self, events: &[MapEvent]) {
        if events.is_empty() {
            return;
        }
        for camera in self.all() {
            let mut waiting = lock(&camera.events);
            waiting.extend_from_slice(events);
            let n_surplus = waiting.len().saturating_sub(MAX_WAITING_EVENTS);
            waiting.drain(..n_surplus);
        }
    }

    /// Notes that a camera is in a submap.
    pub fn visit(&self, submap: SubmapId, camera: CameraId) {
        lock(&self.visitors).entry(submap).or_default().insert(camera);
    }

    /// The cameras that have been in a submap.
    pub fn were_in(&self, submap: SubmapId) -> BTreeSet<CameraId> {
        lock(&self.visitors).get(&submap).cloned().unwrap_or_default()
    }

    fn all(&self) -> Vec<Arc<OneCamera>> {
        lock(&self.present).iter().filter_map(Weak::upgrade).collect()
    }
}
