//! The machine's cores, shared fairly among sessions.
//!
//! Each session has threads of its own, but only as many of all of them work at a time as there are cores:
//! who works has a *turn*. A turn that ends goes to the session that has had least so far, and among the
//! threads of one session to the one that waits longest. Nobody is interrupted, but long work asks now and
//! then whether others should come first ([`let_others`]), and who waits for another thread gives its turn
//! away meanwhile ([`wait`]). What is computed does not depend on any of it.
//!
//! Which session a thread works for is known to the thread ([`Cores::join`]) and handed on to those that it
//! starts ([`Share::of_this_thread`]). Threads of no session work as they please.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Work that can be interrupted goes on for this long before it lets others: a third of a frame at 30 a
/// second, and long beside what changing hands costs.
const SLICE: Duration = Duration::from_millis(10);

/// A session that was away keeps as much of its claims: a camera's pause from frame to frame is none.
const CREDIT: Duration = Duration::from_millis(100);

/// See the module's documentation. Clones are of the same cores.
#[derive(Clone)]
pub struct Cores(Arc<Shared>);

struct Shared {
    state: Mutex<State>,
    now: Box<dyn Fn() -> Duration + Send + Sync>,
}

#[derive(Default)]
struct State {
    n_free: usize,
    n_turns: u64,
    n_members: u64,
    members: BTreeMap<u64, Member>,
    waiting: Vec<Waiting>,
    /// What the member whose turn began last had had: who comes anew begins with it, and who comes back with
    /// little less, so that nobody makes up for what it did not want.
    had_last: Duration,
}

#[derive(Default)]
struct Member {
    /// How long its threads have had turns.
    had: Duration,
    /// Turns that it has or waits for.
    n_turns: usize,
}

struct Waiting {
    ticket: u64,
    member: u64,
    called: Arc<Condvar>,
}

/// A session's share of the cores.
#[derive(Clone)]
pub(crate) struct Share {
    cores: Cores,
    member: Arc<Membership>,
}

struct Membership {
    id: u64,
    cores: Cores,
}

/// This thread, and those that it starts, work for one session as long as this is there.
#[must_use]
pub struct Joined {
    before: Option<Share>,
    /// What it changes is of one thread.
    _of_this_thread: std::marker::PhantomData<*const ()>,
}

thread_local! {
    static SHARE: RefCell<Option<Share>> = const { RefCell::new(None) };
    /// When the turn that this thread has began.
    static BEGAN: RefCell<Option<Duration>> = const { RefCell::new(None) };
}

impl fmt::Debug for Cores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = self.lock();
        write!(f, "Cores({} free, {} waiting)", state.n_free, state.waiting.len())
    }
}

impl Cores {
    /// So many cores, at least one; `now` tells the time since some fixed moment and never goes back.
    pub fn new(n_cores: usize, now: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        let state = Mutex::new(State { n_free: n_cores.max(1), ..State::default() });
        Self(Arc::new(Shared { state, now: Box::new(now) }))
    }

    /// Has this thread work for a session of its own.
    pub fn join(&self) -> Joined {
        let id = {
            let mut state = self.lock();
            state.n_members += 1;
            let (id, had) = (state.n_members, state.had_last);
            state.members.insert(id, Member { had, n_turns: 0 });
            id
        };
        let member = Arc::new(Membership { id, cores: self.clone() });
        Share { cores: self.clone(), member }.enter()
    }

    /// Turns that are waited for.
    pub fn n_waiting(&self) -> usize {
        self.lock().waiting.len()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code that can panic runs while it is locked.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.cores.lock().members.remove(&self.id);
    }
}

impl Drop for Joined {
    fn drop(&mut self) {
        let before = self.before.take();
        // The share is dropped outside of the cell.
        let left = SHARE.with(|share| share.replace(before));
        drop(left);
    }
}

impl Share {
    /// That of this thread, to be entered by one that it starts.
    pub fn of_this_thread() -> Option<Self> {
        SHARE.with(|share| share.borrow().clone())
    }

    /// Has this thread work for the session.
    pub fn enter(self) -> Joined {
        let before = SHARE.with(|share| share.replace(Some(self)));
        Joined { before, _of_this_thread: std::marker::PhantomData }
    }

    /// Waits for a turn.
    fn begin(&self) {
        let mut state = self.cores.lock();
        let (had_last, id) = (state.had_last, self.member.id);
        let member = state.members.entry(id).or_default();
        if member.n_turns == 0 {
            member.had = member.had.max(had_last.saturating_sub(CREDIT));
        }
        member.n_turns += 1;
        if state.n_free > 0 {
            state.n_free -= 1;
            state.note_begin(id);
        } else {
            let (ticket, called) = (state.n_turns, Arc::new(Condvar::new()));
            state.n_turns += 1;
            state.waiting.push(Waiting { ticket, member: id, called: called.clone() });
            while state.waiting.iter().any(|waiting| waiting.ticket == ticket) {
                state = called.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
        drop(state);
        BEGAN.set(Some((self.cores.0.now)()));
    }

    /// Ends the turn, if this thread has one, and calls who comes next.
    fn end(&self) {
        let Some(began) = BEGAN.take() else { return };
        let now = (self.cores.0.now)();
        let mut state = self.cores.lock();
        if let Some(member) = state.members.get_mut(&self.member.id) {
            member.had += now.saturating_sub(began);
            member.n_turns = member.n_turns.saturating_sub(1);
        }
        match state.next() {
            None => state.n_free += 1,
            Some(index) => {
                let Waiting { member, called, .. } = state.waiting.remove(index);
                state.note_begin(member);
                called.notify_one();
            }
        }
    }

    /// Whether somebody waits who has had no more than this session, the present turn included.
    fn should_let_others(&self) -> bool {
        let Some(began) = BEGAN.with(|began| *began.borrow()) else { return false };
        let held = (self.cores.0.now)().saturating_sub(began);
        if held < SLICE {
            return false;
        }
        let state = self.cores.lock();
        let own = state.had(self.member.id) + held;
        state.waiting.iter().any(|waiting| state.had(waiting.member) <= own)
    }
}

impl State {
    fn had(&self, member: u64) -> Duration {
        self.members.get(&member).map_or(Duration::ZERO, |member| member.had)
    }

    /// Who waits and comes next.
    fn next(&self) -> Option<usize> {
        let order = |waiting: &Waiting| (self.had(waiting.member), waiting.ticket);
        (0..self.waiting.len()).min_by_key(|index| order(&self.waiting[*index]))
    }

    fn note_begin(&mut self, member: u64) {
        self.had_last = self.had_last.max(self.had(member));
    }
}

/// Does work that keeps a core busy, once this thread has a turn; if it has one already, in that.
pub(crate) fn with_turn<T>(work: impl FnOnce() -> T) -> T {
    /// Also when the work panics.
    struct End(Share);
    impl Drop for End {
        fn drop(&mut self) {
            self.0.end();
        }
    }
    let has_turn = BEGAN.with(|began| began.borrow().is_some());
    let Some(share) = Share::of_this_thread().filter(|_| !has_turn) else { return work() };
    share.begin();
    let _end = End(share);
    work()
}

/// Waits for another thread. Meanwhile somebody else has the turn of this one, which it gets back before it
/// goes on.
pub(crate) fn wait<T>(waiting: impl FnOnce() -> T) -> T {
    let has_turn = BEGAN.with(|began| began.borrow().is_some());
    let Some(share) = Share::of_this_thread().filter(|_| has_turn) else { return waiting() };
    share.end();
    let result = waiting();
    share.begin();
    result
}

/// Lets those go first who wait and have had less, in the middle of long work.
pub(crate) fn let_others() {
    if let Some(share) = Share::of_this_thread().filter(Share::should_let_others) {
        share.end();
        share.begin();
    }
}

/// Whether somebody waits for a turn: then nothing is gained by two threads for one turn.
pub(crate) fn are_wanted() -> bool {
    Share::of_this_thread().is_some_and(|share| share.cores.n_waiting() > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
    use std::time::Instant;

    fn cores(n_cores: usize) -> Cores {
        let start = Instant::now();
        Cores::new(n_cores, move || start.elapsed())
    }

    /// Keeps a thread busy for a while.
    fn work() {
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(4) {
            std::hint::spin_loop();
        }
    }

    type Working = std::thread::JoinHandle<Duration>;

    /// Threads that work for one session until `stop`; how long they had turns.
    fn session(cores: &Cores, n_threads: usize, stop: &Arc<AtomicBool>) -> Vec<Working> {
        let joined = cores.join();
        let share = Share::of_this_thread().expect("joined");
        drop(joined);
        let run = |_| {
            let (share, stop) = (share.clone(), stop.clone());
            std::thread::spawn(move || {
                let _joined = share.enter();
                let mut had = Duration::ZERO;
                while !stop.load(Ordering::Relaxed) {
                    had += with_turn(|| {
                        let begun = Instant::now();
                        work();
                        begun.elapsed()
                    });
                }
                had
            })
        };
        (0..n_threads).map(run).collect()
    }

    #[test]
    fn a_session_of_many_threads_gets_no_more_than_one_of_few() {
        let (cores, stop) = (cores(1), Arc::new(AtomicBool::new(false)));
        // Of two there is always one that waits.
        let threads = [session(&cores, 8, &stop), session(&cores, 2, &stop)];
        std::thread::sleep(Duration::from_secs(1));
        stop.store(true, Ordering::Relaxed);
        let had = threads.map(|threads| threads.into_iter().map(|one| one.join().unwrap()).sum::<Duration>());
        let [many, few] = had.map(|had| had.as_secs_f64());
        assert!(few > 0.1 && few / many > 0.6 && few / many < 1.7, "{many} s and {few} s");
        assert_eq!((cores.n_waiting(), cores.lock().n_free), (0, 1));
    }

    #[test]
    fn no_more_work_than_there_are_cores() {
        let cores = cores(2);
        let (busy, most) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let run = |_| {
            let (cores, busy, most) = (cores.clone(), busy.clone(), most.clone());
            std::thread::spawn(move || {
                let _joined = cores.join();
                for _ in 0..20 {
                    with_turn(|| {
                        most.fetch_max(busy.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                        work();
                        // Nobody else may take the place of one who waits for itself.
                        with_turn(work);
                        busy.fetch_sub(1, Ordering::SeqCst);
                        wait(|| std::thread::sleep(Duration::from_millis(1)));
                        busy.fetch_add(1, Ordering::SeqCst);
                        busy.fetch_sub(1, Ordering::SeqCst);
                    });
                }
            })
        };
        let threads: Vec<_> = (0..8).map(run).collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        assert_eq!(most.load(Ordering::SeqCst), 2);
        assert!(cores.lock().members.is_empty(), "all have left");
    }

    #[test]
    fn long_work_lets_others_and_a_panic_gives_its_turn_back() {
        let cores = cores(1);
        let _joined = cores.join();
        let n_done = Arc::new(AtomicU64::new(0));
        let other = {
            let (cores, n_done) = (cores.clone(), n_done.clone());
            std::thread::spawn(move || {
                let _joined = cores.join();
                while n_done.load(Ordering::SeqCst) < 3 {
                    with_turn(work);
                    n_done.fetch_add(1, Ordering::SeqCst);
                }
            })
        };
        let begun = Instant::now();
        with_turn(|| {
            while n_done.load(Ordering::SeqCst) < 3 && begun.elapsed() < Duration::from_secs(20) {
                work();
                let_others();
            }
        });
        assert!(n_done.load(Ordering::SeqCst) >= 3, "the other session starved");
        other.join().unwrap();
        let panicked = std::panic::catch_unwind(|| with_turn(|| panic!("in the middle")));
        assert!(panicked.is_err() && cores.lock().n_free == 1);
        with_turn(work);
    }

    #[test]
    fn who_comes_late_or_comes_back_has_no_claims() {
        let now = Arc::new(AtomicU64::new(0));
        let cores = Cores::new(1, {
            let now = now.clone();
            move || Duration::from_secs(now.load(Ordering::SeqCst))
        });
        let _first = cores.join();
        for _ in 0..3 {
            with_turn(|| now.fetch_add(10, Ordering::SeqCst));
        }
        let first = Share::of_this_thread().unwrap();
        let _second = cores.join();
        let second = Share::of_this_thread().unwrap();
        let had = |share: &Share| cores.lock().had(share.member.id).as_secs();
        assert_eq!((had(&first), had(&second)), (30, 20), "as what was had when a turn began last");
    }
}
