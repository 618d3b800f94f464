//! Images on a pipe: JPEG files one behind the other (MJPEG), or bare gray pixels.

use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::PathBuf;
use std::time::Instant;

use super::MAX_PIXELS;
use super::ffmpeg::{Ffmpeg, VideoInput};
use crate::files::FileError;
use crate::frames::{FrameImage, FrameReader, PixelFormat, RawImage, TimedFrame};

/// Largest JPEG file taken from a pipe, bytes: one that never ends would fill the memory.
const MAX_JPEG: usize = 64 << 20;

/// When the images of a pipe were taken: it does not say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrameTimes {
    /// When they arrive, counted from the first.
    Arrival,
    /// So many a second.
    PerSecond(f64),
}

/// Tells the time of each image.
struct Clock {
    times: FrameTimes,
    n_frames: u64,
    started: Option<Instant>,
}

impl Clock {
    fn new(times: FrameTimes) -> Self {
        Self { times, n_frames: 0, started: None }
    }

    fn next_ns(&mut self) -> i64 {
        let nanoseconds = match self.times {
            FrameTimes::PerSecond(rate) => (1e9 * self.n_frames as f64 / rate).round() as i64,
            FrameTimes::Arrival => {
                let elapsed = self.started.get_or_insert_with(Instant::now).elapsed();
                i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX)
            }
        };
        self.n_frames += 1;
        nanoseconds
    }
}

fn name() -> PathBuf {
    PathBuf::from("standard input")
}

/// Reads what comes on a pipe: JPEG files, or whatever else the installed `ffmpeg` takes from one.
///
/// # Errors
/// A [`FileError`] if nothing comes, or what comes needs `ffmpeg` and there is none.
pub fn read_pipe(pipe: Box<dyn Read + Send>, times: FrameTimes) -> Result<Box<dyn FrameReader>, FileError> {
    let mut pipe = BufReader::new(pipe);
    let start = pipe.fill_buf().map_err(|error| FileError::io(&name(), error))?;
    if start.is_empty() {
        return Err(FileError::content(&name(), "nothing comes on it"));
    }
    // A JPEG file, or the boundary line that network cameras put between them.
    if start.starts_with(&[0xff, 0xd8]) || start.starts_with(b"--") {
        return Ok(Box::new(MjpegReader::new(pipe, times)));
    }
    Ok(Box::new(Ffmpeg::find()?.open(VideoInput::Pipe(Box::new(pipe)))?))
}

/// JPEG files one behind the other; what stands between them is passed over.
pub struct MjpegReader<R> {
    bytes: R,
    clock: Clock,
    is_cut: bool,
}

impl<R: BufRead + Send> MjpegReader<R> {
    /// Of a stream of bytes.
    pub fn new(bytes: R, times: FrameTimes) -> Self {
        Self { bytes, clock: Clock::new(times), is_cut: false }
    }

    /// The next JPEG file as a whole.
    fn next_file(&mut self) -> Result<Option<Vec<u8>>, FileError> {
        if !self.find_start()? {
            return Ok(None);
        }
        let mut file = vec![0xff, 0xd8];
        match self.read_segments(&mut file) {
            Ok(()) => Ok(Some(file)),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                self.is_cut = true;
                Ok(None)
            }
            Err(error) => Err(FileError::io(&name(), error)),
        }
    }

    /// Goes behind the next two bytes that begin a JPEG file. Whether there are some.
    fn find_start(&mut self) -> Result<bool, FileError> {
        let mut last = 0;
        loop {
            let available = self.bytes.fill_buf().map_err(|error| FileError::io(&name(), error))?;
            let Some(first) = available.first().copied() else { return Ok(false) };
            self.bytes.consume(1);
            if (last, first) == (0xff, 0xd8) {
                return Ok(true);
            }
            last = first;
        }
    }

    /// The segments of a file up to its end marker. A file inside a segment, such as a thumbnail, is passed
    /// over with it.
    fn read_segments(&mut self, file: &mut Vec<u8>) -> std::io::Result<()> {
        let mut marker = self.read_marker(file)?;
        loop {
            match marker {
                0xd9 => return Ok(()),
                // Markers that stand alone.
                0x01 | 0xd0..=0xd8 => marker = self.read_marker(file)?,
                _ => {
                    self.read_segment(file)?;
                    // What follows a start of scan is coded and ends with a marker.
                    let is_scan = marker == 0xda;
                    marker = if is_scan { self.read_scan(file)? } else { self.read_marker(file)? };
                }
            }
        }
    }

    fn read_marker(&mut self, file: &mut Vec<u8>) -> std::io::Result<u8> {
        if self.read_byte(file)? != 0xff {
            return Err(std::io::Error::other("this is no JPEG file: a marker is missing"));
        }
        loop {
            // A marker may be filled up with bytes of 0xff.
            match self.read_byte(file)? {
                0xff => {}
                marker => return Ok(marker),
            }
        }
    }

    fn read_segment(&mut self, file: &mut Vec<u8>) -> std::io::Result<()> {
        let length = u16::from_be_bytes([self.read_byte(file)?, self.read_byte(file)?]);
        for _ in 2..length {
            self.read_byte(file)?;
        }
        Ok(())
    }

    /// Coded data up to the next marker, which is returned.
    fn read_scan(&mut self, file: &mut Vec<u8>) -> std::io::Result<u8> {
        loop {
            if self.read_byte(file)? != 0xff {
                continue;
            }
            let mut marker = self.read_byte(file)?;
            while marker == 0xff {
                marker = self.read_byte(file)?;
            }
            // 0 is a coded 0xff, the others begin anew inside a scan.
            if !matches!(marker, 0 | 0xd0..=0xd7) {
                return Ok(marker);
            }
        }
    }

    fn read_byte(&mut self, file: &mut Vec<u8>) -> std::io::Result<u8> {
        if file.len() == MAX_JPEG {
            return Err(std::io::Error::other(format!("a JPEG file is larger than {} MiB", MAX_JPEG >> 20)));
        }
        let available = self.bytes.fill_buf()?;
        let byte = available.first().copied().ok_or(ErrorKind::UnexpectedEof)?;
        self.bytes.consume(1);
        file.push(byte);
        Ok(byte)
    }
}

impl<R: BufRead + Send> FrameReader for MjpegReader<R> {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        let Some(file) = self.next_file()? else { return Ok(None) };
        Ok(Some(TimedFrame { timestamp_ns: self.clock.next_ns(), image: FrameImage::Encoded(file) }))
    }

    fn remark(&self) -> Option<String> {
        self.is_cut.then(|| format!("{}: it ends in the middle of an image", name().display()))
    }
}

/// Bare pixels of a byte each.
pub struct GrayReader<R> {
    bytes: R,
    width: u32,
    height: u32,
    clock: Clock,
    is_cut: bool,
}

impl<R: Read + Send> GrayReader<R> {
    /// Images of this size, one behind the other.
    ///
    /// # Errors
    /// A [`FileError`] if an image cannot have that size.
    pub fn new(bytes: R, (width, height): (u32, u32), times: FrameTimes) -> Result<Self, FileError> {
        let n_pixels = u64::from(width) * u64::from(height);
        if n_pixels == 0 || n_pixels > MAX_PIXELS {
            return Err(FileError::content(&name(), format!("{width}x{height} pixels are no image's size")));
        }
        Ok(Self { bytes, width, height, clock: Clock::new(times), is_cut: false })
    }
}

impl<R: Read + Send> FrameReader for GrayReader<R> {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        let n_bytes = self.width as usize * self.height as usize;
        let mut data = Vec::with_capacity(n_bytes);
        let read = (&mut self.bytes).take(n_bytes as u64).read_to_end(&mut data);
        read.map_err(|error| FileError::io(&name(), error))?;
        if data.len() < n_bytes {
            self.is_cut = !data.is_empty();
            return Ok(None);
        }
        let (width, height) = (self.width, self.height);
        let image = RawImage { format: PixelFormat::Gray8, width, height, row_stride: width, data };
        Ok(Some(TimedFrame { timestamp_ns: self.clock.next_ns(), image: FrameImage::Raw(image) }))
    }

    fn remark(&self) -> Option<String> {
        let Self { width, height, .. } = self;
        self.is_cut.then(|| {
            format!("{}: it ends in the middle of an image of {width}x{height} pixels", name().display())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg(width: u32, with_thumbnail: bool) -> Vec<u8> {
        let mut file = Vec::new();
        let pixels: Vec<u8> = (0..width * 8).map(|i| (i * 37 % 256) as u8).collect();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, 95);
        encoder.encode(&pixels, width, 8, image::ExtendedColorType::L8).unwrap();
        if with_thumbnail {
            let thumbnail = jpeg(8, false);
            let length = u16::try_from(thumbnail.len() + 2).unwrap().to_be_bytes();
            let segment: Vec<u8> = [&[0xff, 0xe1][..], &length, &thumbnail].concat();
            file.splice(2..2, segment);
        }
        file
    }

    fn read_all(mut reader: impl FrameReader) -> (Vec<(i64, u32)>, Option<String>) {
        let mut frames = Vec::new();
        while let Some(frame) = reader.next_frame().unwrap() {
            frames.push((frame.timestamp_ns, frame.image.size().unwrap().0));
        }
        (frames, reader.remark())
    }

    #[test]
    fn files_are_cut_apart_whatever_is_in_them_and_between_them() {
        let stream =
            [b"--boundary\r\n\r\n", &jpeg(16, false)[..], b"\r\n--\xff", &jpeg(24, true), &jpeg(32, false)]
                .concat();
        let reader = MjpegReader::new(&stream[..], FrameTimes::PerSecond(10.0));
        assert_eq!(read_all(reader), (vec![(0, 16), (100_000_000, 24), (200_000_000, 32)], None));
        let cut = &stream[..stream.len() - 3];
        let (frames, remark) = read_all(MjpegReader::new(cut, FrameTimes::PerSecond(10.0)));
        assert_eq!((frames.len(), remark.is_some()), (2, true));
    }

    #[test]
    fn what_is_no_file_is_refused() {
        let mut reader = MjpegReader::new(&b"\xff\xd8hello"[..], FrameTimes::Arrival);
        assert!(reader.next_frame().unwrap_err().to_string().contains("no JPEG file"));
        assert!(read_pipe(Box::new(&b""[..]), FrameTimes::Arrival).is_err());
    }

    #[test]
    fn gray_pixels_are_cut_into_images() {
        let bytes: Vec<u8> = (0..26).collect();
        let mut reader = GrayReader::new(&bytes[..], (4, 3), FrameTimes::PerSecond(4.0)).unwrap();
        let frame = reader.next_frame().unwrap().unwrap();
        assert_eq!((frame.timestamp_ns, frame.image.n_bytes()), (0, 12));
        let (frames, remark) = read_all(reader);
        assert_eq!(frames, [(250_000_000, 4)]);
        assert!(remark.unwrap().contains("4x3"));
        assert!(GrayReader::new(&bytes[..], (0, 3), FrameTimes::Arrival).is_err());
    }

    #[test]
    fn times_of_arrival_increase() {
        let mut clock = Clock::new(FrameTimes::Arrival);
        let first_ns = clock.next_ns();
        std::thread::sleep(std::time::Duration::from_millis(2));
        assert!(first_ns < 1_000_000 && clock.next_ns() >= 2_000_000);
    }
}
