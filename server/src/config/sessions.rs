//! How sessions run.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How sessions run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SessionConfig {
    /// Seconds without a writer after which a session leaves memory. Default 60.
    pub idle_unload_s: f64,
    /// Frames that wait for tracking in a LOSSLESS stream before the client is held back. Default 4: enough
    /// to keep tracking busy, few enough that large raw images do not fill the memory.
    pub lossless_queue_frames: usize,
    /// Newest frames kept waiting in a REALTIME stream; older ones are dropped. Default 2.
    pub realtime_queue_frames: usize,
    /// Seconds after which a frame of a REALTIME stream that newer ones follow is dropped when its turn
    /// comes. Default 0.5: where many streams share the cores, answers are of what is, and not of what was.
    pub realtime_max_wait_s: f64,
    /// Keep the images of keyframes, as they were sent (raw ones as PNG). Default true.
    pub keep_keyframe_images: bool,
    /// Seconds from the beginning of one transaction of a session to that of the next, at least. Default 0.5:
    /// most landmarks of a keyframe move again with the next, and are written once for both. What is answered
    /// as durable is so much later at most; the end of a stream waits for nothing.
    pub save_interval_s: f64,
    /// Seconds between attempts to save after one failed, as when the disk is full. Default 1.
    pub save_retry_s: f64,
    /// Single images located at the same time; further ones wait their turn. Default 1: each takes a core and
    /// as much memory as its map.
    #[serde(alias = "n_localisations")]
    pub n_localizations: usize,
    /// How far a frame's sequence may be beyond the one that is expected; one further is refused. Default
    /// 1_000_000_000: a year at 30 frames a second. What is more is no count of frames, and a few such leaps
    /// would leave no numbers.
    pub max_sequence_leap: u64,
    /// Seconds a frame's time may be after that of the one before; one later is refused, unless it begins a
    /// new segment. Default 31 622 400, a leap year: what is more comes from a clock that was set, and would
    /// keep the session from going on once that is set right.
    pub max_time_leap_s: f64,
    /// Seconds that are spent on locating a single image, its turn not counted. Default 10: a large map is
    /// read and searched in two.
    pub localize_timeout_s: f64,
    /// Seconds after which a stream that sends nothing gives up its session's place in memory when another
    /// session needs one. Default 30: a camera that sends less than a frame in half a minute maps nothing.
    pub idle_stream_s: f64,
    /// Operations that run at the same time. Default 1: each takes every core for parts of its time.
    pub n_operations: usize,
    /// Threads that track, map and adjust maps at the same time, of all sessions together, which share them
    /// alike; decoding, the network and single images go beside. Default twice as many as the machine has
    /// cores: who has a turn is not interrupted for tens of milliseconds, and with no more turns than cores
    /// frames wait for the mapping of other sessions, where the system lets them go between.
    pub n_cores: Option<usize>,
    /// Memory for what maps look like, to find the one that an image shows, MiB. Default 256: some 200 maps
    /// of 150 keyframes; with less, maps are read again for each image.
    pub localization_index_mb: usize,
    /// Keyframes of maps that are kept ready to locate images in. Default 400, some 80 MB; 0 keeps none. What
    /// is not used for `idle_unload_s` goes.
    pub localization_keyframes: usize,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            idle_unload_s: 60.0,
            lossless_queue_frames: 4,
            realtime_queue_frames: 2,
            realtime_max_wait_s: 0.5,
            keep_keyframe_images: true,
            save_interval_s: 0.5,
            save_retry_s: 1.0,
            n_localizations: 1,
            localize_timeout_s: 10.0,
            max_sequence_leap: 1_000_000_000,
            max_time_leap_s: 31_622_400.0,
            idle_stream_s: 30.0,
            n_operations: 1,
            n_cores: None,
            localization_index_mb: 256,
            localization_keyframes: 400,
        }
    }
}

impl SessionConfig {
    /// [`Self::idle_unload_s`] as a span of time.
    pub fn idle_unload(&self) -> Duration {
        Duration::from_secs_f64(self.idle_unload_s)
    }

    /// [`Self::idle_stream_s`] as a span of time.
    pub fn idle_stream(&self) -> Duration {
        Duration::from_secs_f64(self.idle_stream_s)
    }

    /// [`Self::n_cores`], or twice as many as the machine has.
    pub fn n_cores(&self) -> usize {
        self.n_cores.unwrap_or_else(|| 2 * std::thread::available_parallelism().map_or(1, usize::from))
    }
}
