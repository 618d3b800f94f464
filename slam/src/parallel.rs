//! Two pieces of work at the same time (fork and join).

use std::sync::{Mutex, PoisonError};

/// Runs both, the second on a thread of its own of this name; one after the other where no thread can be
/// started.
pub(crate) fn join<A, B: Send>(
    name: &str,
    first: impl FnOnce() -> A,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    // Whichever thread comes first takes it: this one, if the other could not be started.
    let waiting = Mutex::new(Some(second));
    let take = || waiting.lock().unwrap_or_else(PoisonError::into_inner).take();
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new()
            .name(format!("slam-{name}"))
            .spawn_scoped(scope, || take().map(|second| second()));
        let first = first();
        let second = match thread {
            Ok(thread) => match thread.join() {
                Ok(result) => result,
                Err(panic) => std::panic::resume_unwind(panic),
            },
            Err(_) => None,
        };
        let second = second.or_else(|| take().map(|second| second()));
        (first, second.expect("one of the two threads ran it"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_run_and_may_borrow() {
        let (left, right) = (vec![1, 2, 3], vec![4, 5]);
        let this_thread = std::thread::current().id();
        let (sum, (product, thread)) = join(
            "test",
            || left.iter().sum::<i32>(),
            || (right.iter().product::<i32>(), std::thread::current().id()),
        );
        assert_eq!((sum, product), (6, 20));
        assert_ne!(thread, this_thread);
    }

    #[test]
    fn a_panic_of_either_reaches_the_caller() {
        let of_second = std::panic::catch_unwind(|| join("test", || 1, || -> i32 { panic!("second") }));
        assert_eq!(of_second.unwrap_err().downcast_ref::<&str>(), Some(&"second"));
        let of_first = std::panic::catch_unwind(|| join("test", || -> i32 { panic!("first") }, || 1));
        assert_eq!(of_first.unwrap_err().downcast_ref::<&str>(), Some(&"first"));
    }
}
