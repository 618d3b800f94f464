//! When it is worth trying to start a map again.

use crate::report::InitializationWait;

/// Share of the views until the parallax should suffice, at the pace it has grown, that are passed over.
const PASSED_SHARE: f64 = 0.5;
/// Views in a row that are passed over at most: a tenth of a second of video, by which a map begins later
/// where the camera has begun to move fast.
const MAX_PASSED: f64 = 3.0;

/// The parallax of a slow camera grows from view to view. Where it is far from what a map needs, a search for
/// the motion, which costs as much as two frames tracked, is not worth it at every one.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// View and parallax, degrees, of the last attempt.
    last: (usize, f64),
    /// The first view that is to be tried again.
    next: usize,
    wait: Option<InitializationWait>,
}

impl Pace {
    /// Why this view, by its number, is not tried; `None` if it is to be.
    pub fn wait_at(&self, view: usize) -> Option<InitializationWait> {
        self.wait.filter(|_| view < self.next)
    }

    /// Takes note of why an attempt with a view, by its number, did not start a map.
    pub fn note(&mut self, view: usize, wait: InitializationWait) {
        let InitializationWait::TooLittleParallax { parallax_deg, required_deg } = wait else {
            *self = Self { last: (view, 0.0), ..Self::default() };
            return;
        };
        let (last_view, last_deg) = self.last;
        let growth_deg = (parallax_deg - last_deg) / view.saturating_sub(last_view).max(1) as f64;
        // None where it has not grown.
        let n_missing = (required_deg - parallax_deg) / growth_deg.max(f64::MIN_POSITIVE);
        let n_passed = (PASSED_SHARE * n_missing).clamp(0.0, MAX_PASSED) as usize;
        *self = Self { last: (view, parallax_deg), next: view + 1 + n_passed, wait: Some(wait) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The views that are tried until the parallax suffices, which grows by so much from view to view.
    fn tried(growth_deg: f64) -> Vec<usize> {
        let (mut pace, mut tried) = (Pace::default(), Vec::new());
        pace.note(0, InitializationWait::FirstView);
        for view in 1.. {
            if pace.wait_at(view).is_some() {
                continue;
            }
            tried.push(view);
            let parallax_deg = growth_deg * view as f64;
            if parallax_deg >= 1.0 {
                break;
            }
            pace.note(view, InitializationWait::TooLittleParallax { parallax_deg, required_deg: 1.0 });
        }
        tried
    }

    #[test]
    fn a_slow_camera_is_tried_seldom_and_at_the_end_often() {
        let slow = tried(0.025);
        assert!(slow.len() <= 14 && slow.last() == Some(&40), "{slow:?}");
        assert_eq!(tried(0.4), [1, 2, 3], "every view of a fast one");
    }

    #[test]
    fn other_reasons_to_wait_are_tried_again_at_once() {
        let mut pace = Pace::default();
        pace.note(1, InitializationWait::TooLittleParallax { parallax_deg: 0.1, required_deg: 1.0 });
        assert!(pace.wait_at(2).is_some());
        pace.note(5, InitializationWait::TooFewMatches { n_matches: 3, n_required: 80 });
        assert!(pace.wait_at(6).is_none());
    }
}
