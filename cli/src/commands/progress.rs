//! What the user sees while frames are streamed.

use std::io::{IsTerminal, stderr};
use std::time::{Duration, Instant};

use client::{FrameAnswer, StreamEvent};
use indicatif::{ProgressBar, ProgressStyle};
use proto::v1::TrackingState;

/// Time between lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// A bar on a terminal, a line now and then elsewhere, both on standard error.
pub struct Progress {
    bar: Option<ProgressBar>,
    first_idx: usize,
    n_frames: Option<usize>,
    n_tracked: usize,
    last_line: Instant,
}

impl Progress {
    /// For `n_frames` frames, or nobody knows how many, from number `first_idx` of their source on.
    pub fn new(first_idx: usize, n_frames: Option<usize>) -> Self {
        let bar = stderr().is_terminal().then(|| {
            let (bar, template) = match n_frames {
                Some(n) => {
                    (ProgressBar::new(n as u64), "{bar:40} {pos}/{len} frames, {per_sec}, {eta} left, {msg}")
                }
                None => (ProgressBar::no_length(), "{spinner} {pos} frames, {per_sec}, {elapsed}, {msg}"),
            };
            bar.with_style(ProgressStyle::with_template(template).expect("the template is valid"))
        });
        Self { bar, first_idx, n_frames, n_tracked: 0, last_line: Instant::now() }
    }

    /// Shows an event.
    pub fn show(&mut self, event: &StreamEvent<'_>) {
        match event {
            StreamEvent::Answered { frame_idx, answer } => {
                self.show_answer(frame_idx - self.first_idx + 1, answer)
            }
            StreamEvent::Reconnecting { error, after } => {
                self.say(&format!("{error}; trying again in {:.1} s", after.as_secs_f64()));
            }
        }
    }

    /// Takes the bar away.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }

    fn show_answer(&mut self, n_answered: usize, answer: &FrameAnswer) {
        let state = match answer {
            FrameAnswer::Result(result) => match result.state() {
                TrackingState::Tracked => "tracked",
                TrackingState::Weak => "weak",
                TrackingState::Lost => "lost",
                TrackingState::Initialising => "initialising",
                TrackingState::Unspecified => "known already",
            },
            FrameAnswer::Dropped => "dropped",
            FrameAnswer::Rejected(reason) => {
                self.say(&format!("frame {} was rejected: {reason}", n_answered - 1 + self.first_idx));
                "rejected"
            }
        };
        self.n_tracked += usize::from(state == "tracked" || state == "weak");
        match &self.bar {
            Some(bar) => {
                bar.set_position(n_answered as u64);
                bar.set_message(state);
            }
            None if self.last_line.elapsed() >= LINE_INTERVAL => {
                self.last_line = Instant::now();
                let of = self.n_frames.map_or_else(String::new, |n| format!(" of {n}"));
                eprintln!("{n_answered}{of} frames, {} with a pose, now {state}", self.n_tracked);
            }
            None => {}
        }
    }

    fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => eprintln!("{line}"),
        }
    }
}
