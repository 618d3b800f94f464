//! Where frames come from: a recording on disk, or anything else that can give them in the order of time.

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

/// One frame of a source.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceFrame {
    /// When it was taken, nanoseconds; increases from frame to frame.
    pub timestamp_ns: i64,
    /// The image, as it is sent.
    pub image: v1::Image,
}

/// Frames in the order of time. After a broken connection the server may ask for some that were sent before,
/// so a source gives frames again: all of them, or, of a camera, the latest.
pub trait FrameSource: Send + Sync + 'static {
    /// The number of frames; `None` as long as it is not known, as of a camera or a video that is still read.
    fn n_frames(&self) -> Option<usize>;

    /// Frame `frame_idx`, counted from zero, or `None` if the source ends before it. Waits for a frame that
    /// is still to be taken.
    ///
    /// # Errors
    /// If it cannot be read.
    fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError>;

    /// Time of frame `frame_idx`, where it can be told without its image.
    ///
    /// # Errors
    /// If it cannot be read.
    fn timestamp_ns(&self, frame_idx: usize) -> Result<Option<i64>, FrameError> {
        Ok(self.frame(frame_idx)?.map(|frame| frame.timestamp_ns))
    }

    /// The first frame that can still be had.
    fn first_kept(&self) -> usize {
        0
    }

    /// Whether the frames are those of this moment, and no other run of a program gets the same ones.
    fn is_live(&self) -> bool {
        false
    }
}

impl FrameSource for Recording {
    fn n_frames(&self) -> Option<usize> {
        Some(self.frames.len())
    }

    /// The bytes of the file; the server tells PNG from JPEG.
    fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
        let Some(frame) = self.frames.get(frame_idx) else { return Ok(None) };
        let path = &frame.path;
        let encoded = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let image = v1::Image { data: encoded.into(), ..v1::Image::default() };
        Ok(Some(SourceFrame { timestamp_ns: frame.timestamp_ns, image }))
    }

    fn timestamp_ns(&self, frame_idx: usize) -> Result<Option<i64>, FrameError> {
        Ok(self.frames.get(frame_idx).map(|frame| frame.timestamp_ns))
    }
}

/// A frame that is ready to be sent.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadyFrame {
    /// Its place in the source.
    pub frame_idx: usize,
    /// The frame.
    pub frame: SourceFrame,
}

/// Reads the frames of a range in turn on a thread of their own, a few ahead of the receiver; when the
/// channel is full the thread waits, and when its receiver is dropped it ends. The list ends with the source,
/// or with the error of a frame that cannot be read.
pub fn read_ahead(
    source: Arc<dyn FrameSource>,
    range: Range<usize>,
) -> mpsc::Receiver<Result<ReadyFrame, ClientError>> {
    let (sender, receiver) = mpsc::channel(DEPTH);
    thread::spawn(move || {
        for frame_idx in range {
            let ready = match source.frame(frame_idx) {
                Ok(Some(frame)) => Ok(ReadyFrame { frame_idx, frame }),
                Ok(None) => break,
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
        fn n_frames(&self) -> Option<usize> {
            Some(6)
        }

        fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
            match frame_idx {
                3 => Err("3.png is gone".into()),
                6.. => Ok(None),
                _ => {
                    let image = v1::Image { data: vec![frame_idx as u8].into(), ..Default::default() };
                    Ok(Some(SourceFrame { timestamp_ns: 1000 * frame_idx as i64, image }))
                }
            }
        }
    }

    #[test]
    fn frames_come_in_order_and_one_that_cannot_be_read_ends_the_list() {
        let mut receiver = read_ahead(Arc::new(Numbered), 1..5);
        for frame_idx in [1usize, 2] {
            let ready = receiver.blocking_recv().unwrap().unwrap();
            assert_eq!((ready.frame_idx, ready.frame.timestamp_ns), (frame_idx, 1000 * frame_idx as i64));
            assert_eq!(&ready.frame.image.data[..], [frame_idx as u8]);
        }
        assert_eq!(receiver.blocking_recv().unwrap().unwrap_err().to_string(), "frame 3: 3.png is gone");
        assert!(receiver.blocking_recv().is_none());
    }

    #[test]
    fn the_list_ends_with_the_source() {
        let mut receiver = read_ahead(Arc::new(Numbered), 5..usize::MAX);
        assert_eq!(receiver.blocking_recv().unwrap().unwrap().frame_idx, 5);
        assert!(receiver.blocking_recv().is_none());
    }
}
