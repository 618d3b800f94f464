//! Where frames come from: a recording on disk, or anything else that can make its frames in any order.

use std::ops::Range;
use std::sync::Arc;
use std::thread;

use proto::v1;
use recordings::Recording;
use tokio::sync::mpsc;

use crate::error::ClientError;

/// Frames kept ready. At 0.4 MB a frame, stalls of the disk of a few frames are hidden at a few MB of memory.
const DEPTH: usize = 8;

/// Why a source cannot give a frame, in its own words.
pub type FrameError = Box<dyn std::error::Error + Send + Sync>;

/// Frames in the order of time, each of which can be had again: after a broken connection the server may ask
/// for some that were sent before.
pub trait FrameSource: Send + Sync + 'static {
    /// The number of frames.
    fn len(&self) -> usize;

    /// Whether there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of frame `frame_idx < len()`, nanoseconds; strictly increasing.
    fn timestamp_ns(&self, frame_idx: usize) -> i64;

    /// The image of frame `frame_idx < len()`, as it is sent.
    ///
    /// # Errors
    /// If it cannot be read.
    fn image(&self, frame_idx: usize) -> Result<v1::Image, FrameError>;
}

impl FrameSource for Recording {
    fn len(&self) -> usize {
        self.frames.len()
    }

    fn timestamp_ns(&self, frame_idx: usize) -> i64 {
        self.frames[frame_idx].timestamp_ns
    }

    /// The bytes of the file; the server tells PNG from JPEG.
    fn image(&self, frame_idx: usize) -> Result<v1::Image, FrameError> {
        let path = &self.frames[frame_idx].path;
        let encoded = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(v1::Image { data: encoded.into(), ..v1::Image::default() })
    }
}

/// A frame that is ready to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadyFrame {
    /// Its place in the source.
    pub frame_idx: usize,
    /// Its time, nanoseconds.
    pub timestamp_ns: i64,
    /// Its image.
    pub image: v1::Image,
}

/// Makes the frames of a range in turn on a thread of their own, a few ahead of the receiver; when the
/// channel is full the thread waits, and when its receiver is dropped it ends. A frame that cannot be read
/// ends the list with its error.
pub fn read_ahead(
    source: Arc<dyn FrameSource>,
    range: Range<usize>,
) -> mpsc::Receiver<Result<ReadyFrame, ClientError>> {
    let (sender, receiver) = mpsc::channel(DEPTH);
    thread::spawn(move || {
        for frame_idx in range {
            let ready = match source.image(frame_idx) {
                Ok(image) => {
                    Ok(ReadyFrame { frame_idx, timestamp_ns: source.timestamp_ns(frame_idx), image })
                }
                Err(reason) => Err(ClientError::Frame { frame_idx, reason }),
            };
            let failed = ready.is_err();
            if sender.blocking_send(ready).is_err() || failed {
                break;
            }
        }
    });
    receiver
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames that carry their number; the fourth cannot be read.
    struct Numbered;

    impl FrameSource for Numbered {
        fn len(&self) -> usize {
            5
        }

        fn timestamp_ns(&self, frame_idx: usize) -> i64 {
            1000 * frame_idx as i64
        }

        fn image(&self, frame_idx: usize) -> Result<v1::Image, FrameError> {
            if frame_idx == 3 {
                return Err("3.png is gone".into());
            }
            Ok(v1::Image { data: vec![frame_idx as u8].into(), ..Default::default() })
        }
    }

    #[test]
    fn frames_come_in_order_and_one_that_cannot_be_read_ends_the_list() {
        let mut receiver = read_ahead(Arc::new(Numbered), 1..5);
        for frame_idx in [1usize, 2] {
            let ready = receiver.blocking_recv().unwrap().unwrap();
            assert_eq!((ready.frame_idx, ready.timestamp_ns), (frame_idx, 1000 * frame_idx as i64));
            assert_eq!(&ready.image.data[..], [frame_idx as u8]);
        }
        assert_eq!(receiver.blocking_recv().unwrap().unwrap_err().to_string(), "frame 3: 3.png is gone");
        assert!(receiver.blocking_recv().is_none());
    }
}
