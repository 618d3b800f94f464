//! Which frames of a recording are measured.

use std::num::NonZeroUsize;

use clap::Args;
use recordings::Playback;

/// Frames and order, where not all as recorded.
#[derive(Clone, Copy, Debug, Args)]
pub struct PlaybackArgs {
    /// First frame, counted from zero
    #[arg(long, value_name = "N", default_value_t = 0)]
    start: usize,
    /// Frame to stop before
    #[arg(long, value_name = "N")]
    end: Option<usize>,
    /// Play one of so many frames
    #[arg(long, value_name = "N", default_value = "1")]
    every: NonZeroUsize,
    /// Play the last frame first
    #[arg(long)]
    backwards: bool,
}

impl PlaybackArgs {
    /// As the recording takes it.
    pub fn playback(self) -> Playback {
        let Self { start, end, every, backwards } = self;
        Playback { start, end, every, backwards }
    }

    /// The words of the command line that say the same.
    pub fn words(self) -> Vec<String> {
        let usual = Playback::default();
        let mut words = Vec::new();
        words.extend((self.start != usual.start).then(|| format!("--start={}", self.start)));
        words.extend(self.end.map(|end| format!("--end={end}")));
        words.extend((self.every != usual.every).then(|| format!("--every={}", self.every)));
        words.extend(self.backwards.then(|| "--backwards".to_owned()));
        words
    }
}
