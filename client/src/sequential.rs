//! Frames that come one after the other: videos, cameras, pipes, bags.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use proto::v1;
use recordings::{FileError, FrameImage, FrameReader, PixelFormat, TimedFrame};

use crate::source::{FrameError, FrameSource, SourceFrame};

/// Frames kept to be sent again: more than wait to be answered, so that after a broken connection a camera's
/// stream goes on without a gap, and a video need not be read from its beginning.
const MAX_KEPT: usize = 64;

/// Bytes kept at most, but always the latest frame: 64 frames of 1280x720, and some of any larger size.
const MAX_KEPT_BYTES: usize = 64 << 20;

/// Opens what is to be read.
type Open = dyn Fn() -> Result<Box<dyn FrameReader>, FileError> + Send + Sync;

/// A source of frames that are read in turn. The latest are kept; an earlier one is had by reading anew from
/// the beginning, where that is possible.
pub struct Sequential {
    /// Opens it again; `None` for a camera or a pipe.
    reopen: Option<Box<Open>>,
    state: Mutex<State>,
    is_stopped: AtomicBool,
    /// Frames whose times go back are put behind the last one.
    continues_times: bool,
}

/// Between the last frame and the first after the clock was set back, nanoseconds: how long that took is not
/// known, and tracking begins anew in any case.
const GAP_NS: i64 = 1_000_000_000;

struct State {
    reader: Box<dyn FrameReader>,
    /// The number of the next frame that is read.
    next_idx: usize,
    /// The frames just before it.
    kept: VecDeque<SourceFrame>,
    n_kept_bytes: usize,
    n_frames: Option<usize>,
    /// What is added to the times that are read, nanoseconds, and how often it was changed.
    shift_ns: i64,
    n_shifts: usize,
}

impl State {
    fn of(reader: Box<dyn FrameReader>) -> Self {
        let kept = VecDeque::new();
        Self { reader, next_idx: 0, kept, n_kept_bytes: 0, n_frames: None, shift_ns: 0, n_shifts: 0 }
    }

    fn first_kept(&self) -> usize {
        self.next_idx - self.kept.len()
    }

    /// Reads and keeps the next frame. Whether there is one.
    fn advance(&mut self, continues_times: bool) -> Result<bool, FileError> {
        let Some(frame) = self.reader.next_frame()? else {
            self.n_frames = Some(self.next_idx);
            return Ok(false);
        };
        let mut frame = as_sent(frame);
        if continues_times {
            self.continue_time(&mut frame);
        }
        self.n_kept_bytes += n_bytes(&frame);
        self.kept.push_back(frame);
        self.next_idx += 1;
        while self.kept.len() > MAX_KEPT || (self.n_kept_bytes > MAX_KEPT_BYTES && self.kept.len() > 1) {
            let gone = self.kept.pop_front();
            self.n_kept_bytes -= gone.as_ref().map_or(0, n_bytes);
        }
        Ok(true)
    }

    /// Puts a frame whose clock was set back behind the last one, and those after it likewise.
    fn continue_time(&mut self, frame: &mut SourceFrame) {
        let read_ns = frame.timestamp_ns;
        frame.timestamp_ns = read_ns.saturating_add(self.shift_ns);
        if let Some(last) = self.kept.back()
            && frame.timestamp_ns <= last.timestamp_ns
        {
            frame.timestamp_ns = last.timestamp_ns.saturating_add(GAP_NS);
            self.shift_ns = frame.timestamp_ns.saturating_sub(read_ns);
            self.n_shifts += 1;
        }
    }
}

impl Sequential {
    /// What can be read again from its beginning, such as a file.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn new(
        open: impl Fn() -> Result<Box<dyn FrameReader>, FileError> + Send + Sync + 'static,
    ) -> Result<Self, FileError> {
        let state = Mutex::new(State::of(open()?));
        let is_stopped = AtomicBool::new(false);
        Ok(Self { reopen: Some(Box::new(open)), state, is_stopped, continues_times: false })
    }

    /// The same, frames whose times go back put behind the last one: where a clock is set back, a new segment
    /// begins a second later.
    #[must_use]
    pub fn with_continued_times(self) -> Self {
        Self { continues_times: true, ..self }
    }

    /// The same of so many frames, or fewer: what reads them finds the end.
    #[must_use]
    pub fn of_length(self, n_frames: usize) -> Self {
        self.state().n_frames = Some(n_frames);
        self
    }

    /// What passes once: a camera, or a pipe.
    pub fn live(reader: Box<dyn FrameReader>) -> Self {
        let (state, is_stopped) = (Mutex::new(State::of(reader)), AtomicBool::new(false));
        Self { reopen: None, state, is_stopped, continues_times: false }
    }

    /// Ends it before the next frame.
    pub fn stop(&self) {
        self.is_stopped.store(true, Ordering::Relaxed);
    }

    /// What was wrong without keeping frames from being read.
    pub fn remark(&self) -> Option<String> {
        let state = self.state();
        let n_shifts = state.n_shifts;
        let shifts = (n_shifts > 0).then(|| {
            format!("the clock of the source went back {n_shifts} times; what followed was put a second behind the last frame")
        });
        let sentences: Vec<String> = [state.reader.remark(), shifts].into_iter().flatten().collect();
        (!sentences.is_empty()).then(|| sentences.join("\n"))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FrameSource for Sequential {
    fn n_frames(&self) -> Option<usize> {
        self.state().n_frames
    }

    fn frame(&self, frame_idx: usize) -> Result<Option<SourceFrame>, FrameError> {
        let mut state = self.state();
        if frame_idx < state.first_kept() {
            let Some(open) = &self.reopen else {
                let first = state.first_kept();
                return Err(format!("it is not kept any more; the first that is, is {first}").into());
            };
            let n_frames = state.n_frames;
            *state = State { n_frames, ..State::of(open()?) };
        }
        while state.next_idx <= frame_idx {
            if self.is_stopped.load(Ordering::Relaxed) {
                state.n_frames = Some(state.next_idx);
                return Ok(None);
            }
            if !state.advance(self.continues_times)? {
                return Ok(None);
            }
        }
        let place = frame_idx - state.first_kept();
        Ok(state.kept.get(place).cloned())
    }

    fn first_kept(&self) -> usize {
        if self.reopen.is_some() { 0 } else { self.state().first_kept() }
    }

    fn is_live(&self) -> bool {
        self.reopen.is_none()
    }
}

fn n_bytes(frame: &SourceFrame) -> usize {
    frame.image.data.len()
}

fn as_sent(frame: TimedFrame) -> SourceFrame {
    let image = match frame.image {
        FrameImage::Encoded(data) => v1::Image { data: data.into(), ..v1::Image::default() },
        FrameImage::Raw(image) => {
            let encoding = match image.format {
                PixelFormat::Gray8 => v1::ImageEncoding::Gray8,
                PixelFormat::Gray16 => v1::ImageEncoding::Gray16,
                PixelFormat::Rgb8 => v1::ImageEncoding::Rgb8,
                PixelFormat::Bgr8 => v1::ImageEncoding::Bgr8,
                PixelFormat::Rgba8 => v1::ImageEncoding::Rgba8,
                PixelFormat::Bgra8 => v1::ImageEncoding::Bgra8,
            };
            v1::Image {
                encoding: encoding.into(),
                width: image.width,
                height: image.height,
                row_stride: image.row_stride,
                data: image.data.into(),
            }
        }
    };
    SourceFrame { timestamp_ns: frame.timestamp_ns, image }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// So many frames, each with its number as its data, `n_bytes` of it.
    struct Counter {
        next: usize,
        n_frames: usize,
        n_bytes: usize,
    }

    impl FrameReader for Counter {
        fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
            if self.next == self.n_frames {
                return Ok(None);
            }
            let frame = TimedFrame {
                timestamp_ns: 10 * self.next as i64,
                image: FrameImage::Encoded(vec![self.next as u8; self.n_bytes]),
            };
            self.next += 1;
            Ok(Some(frame))
        }
    }

    fn counter(n_frames: usize, n_bytes: usize) -> Box<dyn FrameReader> {
        Box::new(Counter { next: 0, n_frames, n_bytes })
    }

    #[test]
    fn a_file_gives_any_frame_again() {
        let source = Sequential::new(|| Ok(counter(200, 1))).unwrap();
        assert_eq!(source.n_frames(), None);
        for frame_idx in [0, 150, 149, 3, 199, 0] {
            let frame = source.frame(frame_idx).unwrap().unwrap();
            assert_eq!((frame.timestamp_ns, frame.image.data[0]), (10 * frame_idx as i64, frame_idx as u8));
        }
        assert_eq!(source.frame(200).unwrap(), None);
        assert_eq!((source.n_frames(), source.first_kept(), source.is_live()), (Some(200), 0, false));
    }

    #[test]
    fn a_camera_gives_the_latest_frames_again_and_ends_when_it_is_stopped() {
        let source = Sequential::live(counter(200, 1));
        assert_eq!(source.timestamp_ns(100).unwrap(), Some(1000));
        assert_eq!(source.first_kept(), 101 - MAX_KEPT);
        assert!(source.frame(101 - MAX_KEPT).unwrap().is_some());
        let refused = source.frame(100 - MAX_KEPT).unwrap_err().to_string();
        assert!(refused.contains("not kept any more"), "{refused}");
        source.stop();
        assert_eq!(source.frame(101).unwrap(), None);
        assert_eq!(source.n_frames(), Some(101));
    }

    /// A clock that is set back by ten seconds at the third frame.
    struct SetBack(usize);

    impl FrameReader for SetBack {
        fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
            let times_s = [100, 101, 91, 92, 93];
            let Some(time_s) = times_s.get(self.0) else { return Ok(None) };
            self.0 += 1;
            let image = FrameImage::Encoded(vec![0]);
            Ok(Some(TimedFrame { timestamp_ns: time_s * 1_000_000_000, image }))
        }
    }

    #[test]
    fn times_go_on_behind_a_clock_that_was_set_back() {
        let times = |source: Sequential| -> Vec<i64> {
            let seconds = |i| source.timestamp_ns(i).unwrap().unwrap() / 1_000_000_000;
            let times = (0..5).map(seconds).collect();
            assert_eq!(seconds(0), 100, "the same when it is read again");
            times
        };
        let open = || Ok(Box::new(SetBack(0)) as Box<dyn FrameReader>);
        assert_eq!(times(Sequential::new(open).unwrap()), [100, 101, 91, 92, 93]);
        let continued = Sequential::new(open).unwrap().with_continued_times();
        assert_eq!(times(continued), [100, 101, 102, 103, 104]);
    }

    #[test]
    fn what_is_kept_is_bounded_in_bytes_as_well() {
        let source = Sequential::live(counter(10, MAX_KEPT_BYTES / 2));
        source.frame(5).unwrap();
        assert_eq!(source.first_kept(), 4);
        let source = Sequential::live(counter(10, MAX_KEPT_BYTES + 1));
        assert!(source.frame(5).unwrap().is_some());
        assert_eq!(source.first_kept(), 5);
    }
}
