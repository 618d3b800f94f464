//! The last answers of a session, for clients that reconnect and repeat what they are not sure of.

use super::frame::FrameOutcome;
use std::collections::VecDeque;

/// Answers kept. A client repeats at most what was under way when its connection broke: a few queued frames,
/// or, if it goes back to the last saved frame, those of about one keyframe.
const CAPACITY: usize = 512;

/// See the module's documentation.
#[derive(Debug, Default)]
pub struct RecentAnswers {
    /// In the order of their sequence numbers.
    reports: VecDeque<FrameOutcome>,
}

impl RecentAnswers {
    /// Remembers an answer; its sequence is above every one before.
    pub fn remember(&mut self, report: FrameOutcome) {
        if self.reports.len() == CAPACITY {
            self.reports.pop_front();
        }
        self.reports.push_back(report);
    }

    /// The answer to a frame, if it is remembered.
    pub fn get(&self, sequence: u64) -> Option<&FrameOutcome> {
        let position = self.reports.binary_search_by_key(&sequence, |report| report.sequence).ok()?;
        self.reports.get(position)
    }
}
