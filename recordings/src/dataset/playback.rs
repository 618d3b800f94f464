//! Recordings played otherwise than they were made.

use std::fmt;
use std::num::NonZeroUsize;

use super::Recording;
use crate::files::FileError;
use crate::trajectory::{StampedPose, Trajectory};

/// Which frames of a recording are played, and in which order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Playback {
    /// The first frame, counted from zero.
    pub start: usize,
    /// The frame to stop before; the recording's end if absent.
    pub end: Option<usize>,
    /// Of how many frames one is played, the first of them.
    pub every: NonZeroUsize,
    /// Last frame first, as a camera would see it that goes the same way back.
    pub backwards: bool,
}

impl Default for Playback {
    /// Every frame, as recorded.
    fn default() -> Self {
        Self { start: 0, end: None, every: NonZeroUsize::MIN, backwards: false }
    }
}

impl fmt::Display for Playback {
    /// What is unusual about it, or nothing.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut words = Vec::new();
        match (self.start, self.end) {
            (0, None) => {}
            (start, None) => words.push(format!("from frame {start}")),
            (start, Some(end)) => words.push(format!("frames {start}..{end}")),
        }
        if self.every.get() > 1 {
            words.push(format!("1 in {}", self.every));
        }
        if self.backwards {
            words.push("backwards".to_owned());
        }
        f.write_str(&words.join(", "))
    }
}

impl Recording {
    /// The recording as it would be if it had been made so. Times backwards count from the same first to the
    /// same last one.
    ///
    /// # Errors
    /// A [`FileError`] if no frame is left.
    pub fn played(mut self, playback: &Playback) -> Result<Self, FileError> {
        if *playback == Playback::default() {
            return Ok(self);
        }
        let n_frames = self.frames.len();
        self.frames.truncate(playback.end.unwrap_or(n_frames));
        self.frames.drain(..playback.start.min(self.frames.len()));
        let (Some(first), Some(last)) = (self.frames.first(), self.frames.last()) else {
            let message = format!("no frame is left of {n_frames} ({playback})");
            return Err(FileError::content(self.name.as_ref(), message));
        };
        if playback.backwards {
            let (first_ns, last_ns) = (first.timestamp_ns, last.timestamp_ns);
            let mirrored = |timestamp_ns: i64| last_ns.saturating_sub(timestamp_ns.saturating_sub(first_ns));
            self.frames.reverse();
            for frame in &mut self.frames {
                frame.timestamp_ns = mirrored(frame.timestamp_ns);
            }
            self.ground_truth = self.ground_truth.map(|truth| {
                let poses = truth.poses().iter();
                let mirrored =
                    poses.map(|pose| StampedPose { timestamp_ns: mirrored(pose.timestamp_ns), ..*pose });
                Trajectory::new(mirrored.collect())
            });
        }
        self.frames = self.frames.into_iter().step_by(playback.every.get()).collect();
        self.name = format!("{} ({playback})", self.name);
        Ok(self)
    }
}
