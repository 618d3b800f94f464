//! A long piece of work, as those see it that wait for it: how far it is, and the wish to give it up.

use crate::cores;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Parts of the whole that progress is told in.
const WHOLE: f64 = 1e6;

/// Shared between who works and who waits.
#[derive(Debug, Default)]
pub struct Work {
    is_cancelled: AtomicBool,
    n_iterations: AtomicU32,
    millionths: AtomicU32,
}

/// A part of the work, which knows nothing of the rest.
#[derive(Clone, Copy)]
pub(crate) struct Stretch<'a> {
    work: &'a Work,
    begin: f64,
    end: f64,
}

impl Work {
    /// Asks for the work to be given up.
    pub fn cancel(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether it is to be given up.
    pub fn is_cancelled(&self) -> bool {
        self.is_cancelled.load(Ordering::Relaxed)
    }

    /// The share that is done, 0 to 1; never goes back.
    pub fn share_done(&self) -> f64 {
        f64::from(self.millionths.load(Ordering::Relaxed)) / WHOLE
    }

    /// Iterations of optimization so far.
    pub fn n_iterations(&self) -> u32 {
        self.n_iterations.load(Ordering::Relaxed)
    }

    /// All of it.
    pub(crate) fn whole(&self) -> Stretch<'_> {
        Stretch { work: self, begin: 0.0, end: 1.0 }
    }
}

impl<'a> Stretch<'a> {
    /// From one share of this stretch to another.
    pub fn part(&self, begin: f64, end: f64) -> Stretch<'a> {
        let at = |share: f64| self.begin + share * (self.end - self.begin);
        Stretch { work: self.work, begin: at(begin), end: at(end) }
    }

    /// Notes that a share of this stretch is done, and lets others have the core if it is their turn. Returns
    /// whether to give up.
    pub fn reach(&self, share: f64) -> bool {
        cores::let_others();
        let done = self.begin + share.clamp(0.0, 1.0) * (self.end - self.begin);
        self.work.millionths.fetch_max((done * WHOLE) as u32, Ordering::Relaxed);
        self.work.is_cancelled()
    }

    /// Notes that another iteration begins.
    pub fn count_iteration(&self) {
        self.work.n_iterations.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether to give up.
    pub fn is_cancelled(&self) -> bool {
        self.work.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_parts_add_up_and_nothing_goes_back() {
        let work = Work::default();
        let second_half = work.whole().part(0.5, 1.0);
        assert!(!second_half.part(0.0, 0.5).reach(1.0));
        assert!((work.share_done() - 0.75).abs() < 1e-5);
        second_half.reach(0.0);
        assert!((work.share_done() - 0.75).abs() < 1e-5);
        work.cancel();
        assert!(second_half.reach(1.0));
    }
}
