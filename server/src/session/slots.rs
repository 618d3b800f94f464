//! Places of sessions in memory, without I/O: who may load a session, change it or take it out of memory.
//!
//! Whoever does holds the session's place ([`Held`]) meanwhile, so that a session is in memory once at most,
//! also while it is deleted and made anew. That, and that nobody waits for another's stream, is checked by
//! trying orders of steps (`server/models`).

use super::sync::{AsyncMutex, Mutex, MutexGuard, OwnedMutexGuard, OwnedSemaphorePermit, Semaphore};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::{Arc, PoisonError};

/// A session in memory.
pub trait Resident {
    /// Whether a client streams into it.
    fn is_busy(&self) -> bool;
    /// Asks it to leave memory once nobody streams into it.
    fn leave(&self);
    /// Ends the stream into it, if there is one, and asks it to leave memory.
    fn end(&self);
    /// Whether the stream into it has not been used for so long that another session may have its place.
    fn is_dormant(&self) -> bool {
        false
    }
    /// As [`Self::end`], telling the client that its place was needed.
    fn give_way(&self) {
        self.end();
    }
    /// Whether it has left memory.
    fn has_ended(&self) -> bool;
    /// Waits until it has. Its [`Room`] is free by then.
    fn ended(&self) -> impl Future<Output = ()> + Send;
}

/// See the module's documentation. `T` stays while sessions come and go.
pub struct Slots<K, R, T> {
    places: Mutex<Places<K, R, T>>,
    room: Arc<Semaphore>,
}

struct Places<K, R, T> {
    slots: BTreeMap<K, Arc<Slot<R, T>>>,
    is_closing: bool,
}

struct Slot<R, T> {
    opening: Arc<AsyncMutex<()>>,
    resident: Mutex<Option<Arc<R>>>,
    lasting: T,
}

/// The right to change what is in memory of one session, and the only one there is.
pub struct Held<R, T> {
    slot: Arc<Slot<R, T>>,
    _opening: OwnedMutexGuard<()>,
}

/// Room for one session in memory, as long as it is kept.
pub type Room = OwnedSemaphorePermit;

/// The server is shutting down.
#[derive(Debug, PartialEq, Eq)]
pub struct Closing;

/// Every place in memory is taken by a session in use.
#[derive(Debug, PartialEq, Eq)]
pub struct Full;

impl<K: Ord + Clone, R: Resident, T: Clone + Default> Slots<K, R, T> {
    /// No session, and room for so many in memory.
    pub fn new(max_residents: usize) -> Self {
        let places = Mutex::new(Places { slots: BTreeMap::new(), is_closing: false });
        let n_rooms = max_residents.min(Semaphore::MAX_PERMITS);
        Self { places, room: Arc::new(Semaphore::new(n_rooms)) }
    }

    /// Waits for the session's place and holds it.
    pub async fn hold(&self, key: &K) -> Held<R, T> {
        loop {
            let slot = self.slot(key);
            let opening = slot.opening.clone().lock_owned().await;
            // Whoever deleted the session meanwhile has removed this slot, and there may be a new one.
            if lock(&self.places).slots.get(key).is_some_and(|current| Arc::ptr_eq(current, &slot)) {
                return Held { slot, _opening: opening };
            }
        }
    }

    /// Whether sessions may be loaded.
    ///
    /// # Errors
    /// If the server is shutting down.
    pub fn check_open(&self) -> Result<(), Closing> {
        if lock(&self.places).is_closing { Err(Closing) } else { Ok(()) }
    }

    /// The session, if it is in memory.
    pub fn resident(&self, key: &K) -> Option<Arc<R>> {
        let slot = lock(&self.places).slots.get(key).cloned()?;
        slot.resident()
    }

    /// The sessions in memory.
    pub fn residents(&self) -> Vec<Arc<R>> {
        self.all().iter().filter_map(|slot| slot.resident()).collect()
    }

    /// What stays of the session while it comes and goes; made if it is not there.
    pub fn lasting(&self, key: &K) -> T {
        self.slot(key).lasting.clone()
    }

    /// What stays of the session, if it was ever held or asked for.
    pub fn known(&self, key: &K) -> Option<T> {
        lock(&self.places).slots.get(key).map(|slot| slot.lasting.clone())
    }

    /// Removes a session that is deleted; what stayed of it goes as well.
    pub fn remove(&self, key: &K, held: Held<R, T>) {
        let mut places = lock(&self.places);
        if places.slots.get(key).is_some_and(|current| Arc::ptr_eq(current, &held.slot)) {
            places.slots.remove(key);
        }
    }

    /// Room for one session more, taking one out of memory that nobody streams into where there is none, else
    /// one whose stream is not used. Its place is held until it is gone, so that nobody begins a stream that
    /// would have to be waited for.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn make_room(&self) -> Result<Room, Full> {
        loop {
            if let Some(room) = self.free_room() {
                return Ok(room);
            }
            if let Some((_held, idle)) = self.all().into_iter().find_map(|slot| hold(slot, |r| !r.is_busy()))
            {
                idle.leave();
                idle.ended().await;
                continue;
            }
            let dormant = self.all().into_iter().find_map(|slot| hold(slot, R::is_dormant));
            let Some((_held, dormant)) = dormant else {
                // One may have left by itself since.
                return self.free_room().ok_or(Full);
            };
            dormant.give_way();
            dormant.ended().await;
        }
    }

    fn free_room(&self) -> Option<Room> {
        self.room.clone().try_acquire_owned().ok()
    }

    /// Takes no session into memory from now on, ends those that are there, and waits until they are gone.
    pub async fn shut_down(&self) {
        lock(&self.places).is_closing = true;
        let residents = self.residents();
        residents.iter().for_each(|resident| resident.end());
        for resident in residents {
            resident.ended().await;
        }
        // Whoever held a place meanwhile has seen `is_closing`, or what was loaded ends here.
        for slot in self.all() {
            let _opening = slot.opening.lock().await;
            if let Some(resident) = slot.resident() {
                resident.end();
                resident.ended().await;
            }
        }
    }

    fn slot(&self, key: &K) -> Arc<Slot<R, T>> {
        let new = || {
            let (opening, resident) = (Arc::new(AsyncMutex::new(())), Mutex::new(None));
            Arc::new(Slot { opening, resident, lasting: T::default() })
        };
        lock(&self.places).slots.entry(key.clone()).or_insert_with(new).clone()
    }

    fn all(&self) -> Vec<Arc<Slot<R, T>>> {
        lock(&self.places).slots.values().cloned().collect()
    }
}

/// A session of this kind, with its place; `None` if it is not, or someone else holds the place.
fn hold<R: Resident, T>(
    slot: Arc<Slot<R, T>>,
    is_wanted: impl Fn(&R) -> bool,
) -> Option<(Held<R, T>, Arc<R>)> {
    let opening = slot.opening.clone().try_lock_owned().ok()?;
    let resident = slot.resident().filter(|resident| is_wanted(resident))?;
    Some((Held { slot, _opening: opening }, resident))
}

impl<R: Resident, T> Slot<R, T> {
    fn resident(&self) -> Option<Arc<R>> {
        let mut resident = lock(&self.resident);
        if resident.as_ref().is_some_and(|resident| resident.has_ended()) {
            *resident = None;
        }
        resident.clone()
    }
}

impl<R: Resident, T> Held<R, T> {
    /// The session, if it is in memory.
    pub fn resident(&self) -> Option<Arc<R>> {
        self.slot.resident()
    }

    /// Notes that the session is in memory.
    pub fn settle(&self, resident: Arc<R>) {
        *lock(&self.slot.resident) = Some(resident);
    }

    /// What stays while the session comes and goes.
    pub fn lasting(&self) -> &T {
        &self.slot.lasting
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
