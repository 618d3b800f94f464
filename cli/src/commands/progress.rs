//! What the user sees of work that takes its time: frames that are streamed, files that come, steps. A bar on
//! a terminal, on standard error; elsewhere a line now and then of a stream, and nothing of the rest.

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
            bar.with_style(style(template))
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

/// Bytes of a file that comes.
pub struct ByteBar {
    bar: ProgressBar,
}

impl ByteBar {
    /// Of a file.
    pub fn new(name: &str) -> Self {
        let bar = if stderr().is_terminal() { ProgressBar::no_length() } else { ProgressBar::hidden() };
        bar.set_style(style("{spinner} {msg}: {bytes}, {bytes_per_sec}"));
        bar.set_message(name.to_owned());
        Self { bar }
    }

    /// So many bytes are there, of so many.
    pub fn show(&mut self, n_bytes: u64, of: Option<u64>) {
        if let Some(of) = of
            && self.bar.length() != Some(of)
        {
            self.bar.set_length(of);
            self.bar.set_style(style("{bar:40} {msg}: {bytes} of {total_bytes}, {eta} left"));
        }
        self.bar.set_position(n_bytes);
    }
}

impl Drop for ByteBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Steps of the same kind.
pub struct StepBar {
    bar: ProgressBar,
}

impl StepBar {
    /// So many of them.
    pub fn new(what: &str, n_steps: usize) -> Self {
        let bar = ProgressBar::new(n_steps as u64);
        let bar = if stderr().is_terminal() { bar } else { ProgressBar::hidden() };
        bar.set_style(style("{bar:40} {pos}/{len} {msg}, {eta} left"));
        bar.set_message(what.to_owned());
        Self { bar }
    }

    /// One more is done.
    pub fn advance(&self) {
        self.bar.inc(1);
    }
}

impl Drop for StepBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).expect("the template is valid")
}
