//! Pictures one after the other, from files, folders and videos.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use recordings::{Ffmpeg, FrameImage, FrameReader, VideoInput};
use vision::GrayImage;
use vision::decode::{DecodeLimits, EncodedImage, PixelFormat, decode_gray};

/// Endings of files that are pictures; everything else is taken for a video.
const PICTURES: [&str; 9] = ["png", "jpg", "jpeg", "bmp", "webp", "tif", "tiff", "pgm", "ppm"];
/// Of a video, one frame in this time is looked at, nanoseconds.
const INTERVAL_NS: i64 = 333_000_000;
/// Pictures of phones have 12 to 50 megapixels.
const MAX_PIXELS: u64 = 100_000_000;

/// What is still to be looked at.
pub struct Pictures {
    sources: VecDeque<PathBuf>,
    video: Option<Video>,
    every: Option<usize>,
}

struct Video {
    name: String,
    reader: Box<dyn FrameReader>,
    n_frames: usize,
    last_ns: Option<i64>,
}

impl Pictures {
    /// Of files and folders, in their order. `every` thins out videos.
    pub fn of(sources: &[PathBuf], every: Option<usize>) -> Self {
        Self { sources: sources.iter().cloned().collect(), video: None, every }
    }

    /// Whether the last picture is of a video.
    pub fn is_video(&self) -> bool {
        self.video.is_some()
    }

    /// The next one with its name.
    pub fn next_picture(&mut self) -> Result<Option<(String, GrayImage)>> {
        loop {
            if let Some(frame) = self.next_of_video()? {
                return Ok(Some(frame));
            }
            let Some(path) = self.sources.pop_front() else { return Ok(None) };
            if path.is_dir() {
                for picture in pictures_of(&path)?.into_iter().rev() {
                    self.sources.push_front(picture);
                }
            } else if is_picture(&path) {
                let name =
                    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
                let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
                let image =
                    decode(&EncodedImage::Auto(&bytes)).with_context(|| path.display().to_string())?;
                return Ok(Some((name, image)));
            } else {
                let name = path.display().to_string();
                let reader = Box::new(Ffmpeg::find()?.open(VideoInput::File(path))?);
                self.video = Some(Video { name, reader, n_frames: 0, last_ns: None });
            }
        }
    }

    /// The next frame of the video that is to be looked at; closes it behind the last.
    fn next_of_video(&mut self) -> Result<Option<(String, GrayImage)>> {
        let Some(video) = &mut self.video else { return Ok(None) };
        while let Some(frame) = video.reader.next_frame()? {
            video.n_frames += 1;
            let is_due = match self.every {
                Some(every) => (video.n_frames - 1).is_multiple_of(every.max(1)),
                None => video.last_ns.is_none_or(|last| frame.timestamp_ns - last >= INTERVAL_NS),
            };
            if !is_due {
                continue;
            }
            video.last_ns = Some(frame.timestamp_ns);
            let name = format!("{} frame {}", video.name, video.n_frames - 1);
            let image = gray(&frame.image).with_context(|| name.clone())?;
            return Ok(Some((name, image)));
        }
        self.video = None;
        Ok(None)
    }
}

fn is_picture(path: &Path) -> bool {
    path.extension().is_some_and(|ending| PICTURES.iter().any(|known| ending.eq_ignore_ascii_case(known)))
}

fn pictures_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut pictures: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| is_picture(path)).collect();
    pictures.sort();
    if pictures.is_empty() {
        return Err(anyhow!("{}: there are no pictures in it", folder.display()));
    }
    Ok(pictures)
}

fn gray(image: &FrameImage) -> Result<GrayImage> {
    let raw = match image {
        FrameImage::Encoded(data) => return decode(&EncodedImage::Auto(data)),
        FrameImage::Raw(raw) => raw,
    };
    let format = match raw.format {
        recordings::PixelFormat::Gray8 => PixelFormat::Gray8,
        recordings::PixelFormat::Gray16 => PixelFormat::Gray16,
        recordings::PixelFormat::Rgb8 => PixelFormat::Rgb8,
        recordings::PixelFormat::Bgr8 => PixelFormat::Bgr8,
        recordings::PixelFormat::Rgba8 => PixelFormat::Rgba8,
        recordings::PixelFormat::Bgra8 => PixelFormat::Bgra8,
    };
    let (width, height, stride) = (raw.width, raw.height, raw.row_stride);
    decode(&EncodedImage::Raw { width, height, stride, format, data: &raw.data })
}

fn decode(image: &EncodedImage<'_>) -> Result<GrayImage> {
    let limits = DecodeLimits { max_pixels: MAX_PIXELS, max_bytes: 1 << 30, ..DecodeLimits::default() };
    Ok(decode_gray(image, &limits)?)
}
