//! The log of something that is looked at again and again: a change is told once, and what lasts once a
//! minute.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// How often a fault that lasts is told again: whoever looks at the log sees it, and it stays readable.
const AGAIN_AFTER: Duration = Duration::from_secs(60);

/// What was told last.
#[derive(Debug)]
pub struct Outage {
    /// What it means that it does not work.
    consequence: &'static str,
    /// What is wrong, and when that was told; `None` while all is well.
    told: Option<(String, Instant)>,
}

impl Outage {
    /// All is well so far. `consequence` says what it means when it is not.
    pub fn new(consequence: &'static str) -> Self {
        Self { consequence, told: None }
    }

    /// Notes how things are, and tells it where that is news or was told long ago; whether it did.
    pub fn note<T>(&mut self, outcome: &Result<T, impl Display>) -> bool {
        let consequence = self.consequence;
        let Err(error) = outcome else {
            let Some((was, _)) = self.told.take() else { return false };
            tracing::info!("over: {consequence}: {was}");
            return true;
        };
        let error = error.to_string();
        let is_old = |(told, when): &(String, Instant)| *told == error && when.elapsed() < AGAIN_AFTER;
        if self.told.as_ref().is_some_and(is_old) {
            return false;
        }
        tracing::error!("{consequence}: {error}");
        self.told = Some((error, Instant::now()));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lasts_is_not_told_each_second() {
        let mut log = Outage::new("nothing can be saved");
        let states = [Ok(()), Err("gone"), Err("gone"), Err("full"), Ok(()), Ok(()), Err("gone")];
        assert_eq!(states.map(|state| log.note(&state)), [false, true, false, true, true, false, true]);
        log.told = log.told.and_then(|(told, when)| Some((told, when.checked_sub(AGAIN_AFTER)?)));
        assert!(log.note::<()>(&Err("gone")), "after a minute it is told again");
    }
}
