//! What is refused.

use serde::{Deserialize, Serialize};

/// What is refused, each with an error that says so.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Largest gRPC message, bytes. Default 64 MiB: the largest raw color image with room to spare.
    pub max_message_bytes: usize,
    /// Bytes of messages that are begun and not finished, or wait to be worked off, of all clients together;
    /// who brings more waits, and is refused after five seconds. Default 256 MiB, four of the largest
    /// messages. Over a WebSocket they count as they come.
    pub max_bytes_in_flight: usize,
    /// Largest image, pixels. Default 4096 * 3072. Checked before an image is decoded.
    pub max_image_pixels: u64,
    /// Sessions kept at most, loaded or not. Default 10 000.
    pub max_sessions: u64,
    /// Sessions in memory at most: each holds its map and two threads. Default 64.
    pub max_loaded_sessions: usize,
    /// Largest database, bytes; `None` is as large as the disk. Frames are refused when it is full.
    pub max_database_bytes: Option<u64>,
    /// Operations known that have not ended, such as adjustments of maps; a quarter of them of one owner.
    /// Default 64.
    pub max_operations: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_message_bytes: 64 << 20,
            max_bytes_in_flight: 256 << 20,
            max_image_pixels: 4096 * 3072,
            max_sessions: 10_000,
            max_loaded_sessions: 64,
            max_database_bytes: None,
            max_operations: 64,
        }
    }
}
