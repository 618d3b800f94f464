//! A tracking thread hands updates over, a writer saves them: in no order of steps is one lost, or does
//! anybody wait for ever.

use models::updates::{Bounds, Update, Updates};
use shuttle::future::block_on;
use shuttle::sync::{Arc, Mutex};
use shuttle::thread;

/// Orders of steps that each check tries.
const N_ORDERS: usize = 20_000;
const MAX_AHEAD: usize = 2;

/// The numbers of frames.
#[derive(Debug)]
struct Frames(Vec<u32>);

impl Update for Frames {
    fn join(&mut self, later: Self) {
        self.0.extend(later.0);
    }

    fn ballast_bytes(&self) -> usize {
        0
    }

    fn drop_ballast(&mut self) {}
}

fn updates(one_by_one: bool) -> Arc<Updates<Frames>> {
    Arc::new(Updates::new(Bounds { one_by_one, max_ahead: MAX_AHEAD, max_ballast_bytes: 0 }))
}

/// A disk that fails at some attempts, counted from 0.
struct Disk {
    saved: Mutex<Vec<u32>>,
    fails: fn(usize) -> bool,
}

/// The writer's task, as `session/writer.rs` has it; a wait between attempts is as long as it takes to be
/// woken.
async fn write(updates: &Updates<Frames>, disk: &Disk) {
    let mut n_attempts = 0;
    while let Some(taken) = updates.next().await {
        let has_failed = (disk.fails)(n_attempts);
        n_attempts += 1;
        if has_failed {
            let is_last_attempt = taken.is_last_attempt;
            updates.put_back(taken);
            if is_last_attempt {
                break;
            }
            shuttle::future::yield_now().await;
        } else {
            updates.saved();
            disk.saved.lock().unwrap().extend(taken.update.0);
        }
    }
    updates.end();
}

/// Hands over frames `0..n` and closes; what the disk holds when the writer has ended.
fn saved(one_by_one: bool, n: u32, fails: fn(usize) -> bool) -> Vec<u32> {
    let (updates, disk) = (updates(one_by_one), Arc::new(Disk { saved: Mutex::default(), fails }));
    let writer = {
        let (updates, disk) = (updates.clone(), disk.clone());
        thread::spawn(move || block_on(write(&updates, &disk)))
    };
    for frame in 0..n {
        updates.push(Frames(vec![frame]));
    }
    updates.close();
    writer.join().unwrap();
    let saved = disk.saved.lock().unwrap();
    saved.clone()
}

#[test]
fn no_update_is_lost_between_the_last_look_and_the_end() {
    let check = |one_by_one| {
        shuttle::check_random(move || assert_eq!(saved(one_by_one, 5, |_| false), [0, 1, 2, 3, 4]), N_ORDERS);
    };
    check(false);
    check(true);
}

#[test]
fn no_update_is_lost_when_the_disk_fails_for_a_while() {
    let check = |one_by_one| {
        let fails = |attempt| attempt == 0;
        shuttle::check_random(
            move || {
                // A failure of the very last attempt is final, and keeps the order.
                let saved = saved(one_by_one, 4, fails);
                assert!(saved.is_empty() || saved == [0, 1, 2, 3], "{saved:?}");
            },
            N_ORDERS,
        );
    };
    check(false);
    check(true);
}

/// Updates are joined for as long as nobody waits for them, which here is for ever.
#[test]
fn whoever_waits_for_the_disk_is_not_kept_waiting_for_updates_to_join() {
    shuttle::check_random(
        || {
            let (updates, disk) = (updates(false), Arc::new(Mutex::new(Vec::new())));
            let writer = {
                let (updates, disk) = (updates.clone(), disk.clone());
                thread::spawn(move || {
                    block_on(async {
                        while let Some(taken) = updates.next().await {
                            updates.saved();
                            disk.lock().unwrap().extend(taken.update.0);
                            updates.hurried().await;
                        }
                    });
                })
            };
            for frame in 0..4 {
                updates.push(Frames(vec![frame]));
            }
            updates.hurry();
            // Ends only if the writer saves all of it without anything further.
            while disk.lock().unwrap().len() < 4 {
                thread::yield_now();
            }
            updates.push(Frames(vec![4]));
            updates.close();
            writer.join().unwrap();
            assert_eq!(*disk.lock().unwrap(), [0, 1, 2, 3, 4]);
        },
        N_ORDERS,
    );
}

#[test]
fn nobody_waits_for_a_writer_that_has_ended() {
    shuttle::check_random(
        || {
            let updates = updates(true);
            let writer = {
                let updates = updates.clone();
                thread::spawn(move || {
                    let first = block_on(updates.next());
                    assert!(first.is_some());
                    updates.end();
                })
            };
            for frame in 0..3 * MAX_AHEAD as u32 {
                updates.push(Frames(vec![frame]));
            }
            writer.join().unwrap();
            assert_eq!(updates.n_pushed(), 3 * MAX_AHEAD as u64);
        },
        N_ORDERS,
    );
}

#[test]
fn nobody_waits_for_a_disk_that_fails_and_the_queue_stays_bounded() {
    shuttle::check_random(
        || {
            let updates = updates(true);
            let writer = {
                let updates = updates.clone();
                thread::spawn(move || {
                    if let Some(taken) = block_on(updates.next()) {
                        updates.put_back(taken);
                    }
                })
            };
            for frame in 0..3 * MAX_AHEAD as u32 {
                updates.push(Frames(vec![frame]));
            }
            writer.join().unwrap();
            updates.close();
            let mut transactions = Vec::new();
            block_on(async {
                while let Some(taken) = updates.next().await {
                    transactions.push(taken.update.0);
                }
            });
            assert_eq!(transactions.concat(), (0..3 * MAX_AHEAD as u32).collect::<Vec<_>>());
            // One more than may wait: the one that came back.
            assert!(transactions.len() <= MAX_AHEAD + 1, "{transactions:?}");
        },
        N_ORDERS,
    );
}
