//! Clients open, delete and make sessions while the server shuts down or runs out of room: in no order of
//! steps is a session in memory twice, are there too many, or does anybody wait for another's stream.

use models::slots::{Held, Resident, Room, Slots};
use models::sync::{Mutex, Notify};
use shuttle::future::block_on;
use shuttle::sync::Arc;
use shuttle::sync::atomic::{AtomicUsize, Ordering};
use shuttle::thread;

/// Orders of steps that each check tries.
const N_ORDERS: usize = 20_000;

type Server = Slots<&'static str, Session, ()>;

/// A session in memory. A thread would own the engine; here the steps that end it are taken by whoever may
/// take them.
struct Session {
    state: Mutex<State>,
    changed: tokio::sync::watch::Sender<()>,
    count: Arc<Count>,
}

#[derive(Default)]
struct State {
    is_busy: bool,
    is_dormant: bool,
    is_leaving: bool,
    room: Option<Room>,
    has_ended: bool,
}

/// Sessions in memory, now and at most.
#[derive(Default)]
struct Count {
    now: AtomicUsize,
    most: AtomicUsize,
}

impl Count {
    fn add(&self) {
        let now = self.now.fetch_add(1, Ordering::SeqCst) + 1;
        self.most.fetch_max(now, Ordering::SeqCst);
    }
}

impl Session {
    fn new(room: Room, count: &Arc<Count>) -> Self {
        count.add();
        let state = Mutex::new(State { room: Some(room), ..State::default() });
        Self { state, changed: tokio::sync::watch::Sender::new(()), count: count.clone() }
    }

    /// A stream begins, unless the session is about to leave.
    fn begin(&self) -> bool {
        let mut state = self.state.lock().unwrap();
        state.is_busy = !state.is_leaving;
        state.is_busy
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.state.lock().unwrap();
        change(&mut state);
        if state.is_leaving && !state.is_busy && !state.has_ended {
            self.count.now.fetch_sub(1, Ordering::SeqCst);
            state.room = None;
            state.has_ended = true;
        }
        drop(state);
        self.changed.send_replace(());
    }
}

impl Resident for Session {
    fn is_busy(&self) -> bool {
        self.state.lock().unwrap().is_busy
    }

    fn leave(&self) {
        self.change(|state| state.is_leaving = true);
    }

    fn end(&self) {
        self.change(|state| (state.is_busy, state.is_leaving) = (false, true));
    }

    fn is_dormant(&self) -> bool {
        let state = self.state.lock().unwrap();
        state.is_busy && state.is_dormant
    }

    fn has_ended(&self) -> bool {
        self.state.lock().unwrap().has_ended
    }

    async fn ended(&self) {
        let mut changed = self.changed.subscribe();
        while !self.has_ended() {
            let _ = changed.changed().await;
        }
    }
}

/// Opens a stream as `session/registry.rs` does; `None` if the server is closing or has no room.
async fn open(server: &Server, key: &'static str, count: &Arc<Count>) -> Option<Arc<Session>> {
    let held = server.hold(&key).await;
    loop {
        server.check_open().ok()?;
        let session = load(server, &held, count).await?;
        if session.begin() {
            if server.check_open().is_err() {
                session.end();
            }
            return Some(session);
        }
        session.ended().await;
    }
}

async fn load(server: &Server, held: &Held<Session, ()>, count: &Arc<Count>) -> Option<Arc<Session>> {
    if let Some(session) = held.resident() {
        return Some(session);
    }
    let session = Arc::new(Session::new(server.make_room().await.ok()?, count));
    held.settle(session.clone());
    Some(session)
}

/// Deletes a session unless a client streams into it.
async fn delete(server: &Server, key: &'static str) -> bool {
    let held = server.hold(&key).await;
    if let Some(session) = held.resident() {
        if session.is_busy() {
            return false;
        }
        session.leave();
        session.ended().await;
    }
    server.remove(&key, held);
    true
}

/// One after the other in a thread of its own.
fn client(work: impl Future<Output = ()> + Send + 'static) -> thread::JoinHandle<()> {
    thread::spawn(move || block_on(work))
}

#[test]
fn a_session_deleted_and_made_anew_is_in_memory_once() {
    shuttle::check_random(
        || {
            let server = Arc::new(Server::new(8));
            let count = Arc::new(Count::default());
            let opener = || {
                let (server, count) = (server.clone(), count.clone());
                client(async move {
                    // The stream ends when the next client takes over: it only must not be there beside it.
                    if let Some(session) = open(&server, "a", &count).await {
                        session.change(|state| state.is_busy = false);
                    }
                })
            };
            let deleter = {
                let server = server.clone();
                client(async move {
                    delete(&server, "a").await;
                })
            };
            let clients = [opener(), opener(), opener(), deleter];
            clients.into_iter().for_each(|client| client.join().unwrap());
            assert!(count.most.load(Ordering::SeqCst) <= 1, "the session was in memory twice");
        },
        N_ORDERS,
    );
}

#[test]
fn there_are_never_more_sessions_in_memory_than_allowed() {
    shuttle::check_random(
        || {
            let server = Arc::new(Server::new(2));
            let count = Arc::new(Count::default());
            let clients = ["a", "b", "c", "d"].map(|key| {
                let (server, count) = (server.clone(), count.clone());
                client(async move {
                    if let Some(session) = open(&server, key, &count).await {
                        session.change(|state| state.is_busy = false);
                    }
                })
            });
            clients.into_iter().for_each(|client| client.join().unwrap());
            assert!(count.most.load(Ordering::SeqCst) <= 2);
        },
        N_ORDERS,
    );
}

#[test]
fn nobody_who_needs_room_waits_for_anothers_stream() {
    shuttle::check_random(
        || {
            let server = Arc::new(Server::new(1));
            let count = Arc::new(Count::default());
            let idle = block_on(open(&server, "a", &count)).unwrap();
            idle.change(|state| state.is_busy = false);
            let answered = Arc::new(Notify::new());
            let streaming = {
                let (server, count, answered) = (server.clone(), count.clone(), answered.clone());
                client(async move {
                    // Streams until the other client has been answered, one way or the other.
                    if let Some(session) = open(&server, "a", &count).await {
                        answered.notified().await;
                        session.change(|state| state.is_busy = false);
                    }
                })
            };
            let needing = client(async move {
                let other = open(&server, "b", &count).await;
                answered.notify_one();
                if let Some(session) = other {
                    session.change(|state| state.is_busy = false);
                }
            });
            streaming.join().unwrap();
            needing.join().unwrap();
        },
        N_ORDERS,
    );
}

#[test]
fn whoever_needs_room_gets_that_of_a_stream_that_is_not_used() {
    shuttle::check_random(
        || {
            let server = Arc::new(Server::new(1));
            let count = Arc::new(Count::default());
            let unused = block_on(open(&server, "a", &count)).unwrap();
            unused.change(|state| state.is_dormant = true);
            let clients = ["b", "c"].map(|key| {
                let (server, count) = (server.clone(), count.clone());
                client(async move {
                    let Some(session) = open(&server, key, &count).await else { return };
                    session.change(|state| state.is_busy = false);
                })
            });
            clients.into_iter().for_each(|client| client.join().unwrap());
            assert!(unused.has_ended(), "its client still has the place it did not use");
            assert!(count.most.load(Ordering::SeqCst) <= 1);
        },
        N_ORDERS,
    );
}

#[test]
fn nothing_is_in_memory_after_the_server_has_shut_down() {
    shuttle::check_random(
        || {
            let server = Arc::new(Server::new(2));
            let count = Arc::new(Count::default());
            let opener = |key| {
                let (server, count) = (server.clone(), count.clone());
                // The stream goes on until the server ends it.
                client(async move { drop(open(&server, key, &count).await) })
            };
            let deleter = {
                let server = server.clone();
                client(async move {
                    delete(&server, "a").await;
                })
            };
            let clients = [opener("a"), opener("a"), opener("b"), deleter];
            block_on(server.shut_down());
            assert_eq!(count.now.load(Ordering::SeqCst), 0, "a session is left in memory");
            clients.into_iter().for_each(|client| client.join().unwrap());
            assert_eq!(count.now.load(Ordering::SeqCst), 0, "a session was loaded after the end");
        },
        N_ORDERS,
    );
}
