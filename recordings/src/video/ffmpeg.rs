//! Frames from a child process `ffmpeg`: pixels come on its standard output, times and sizes on its standard
//! error.

use std::ffi::OsString;
use std::io::{BufReader, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use super::MAX_PIXELS;
use super::log::{FrameInfo, LogLine, read_line};
use crate::files::FileError;
use crate::frames::{FrameImage, FrameReader, PixelFormat, RawImage, TimedFrame};

/// Frames announced and not yet taken. `ffmpeg` itself holds some ten between its filters and its output;
/// were it more than this, both sides would wait for each other.
const MAX_ANNOUNCED: usize = 4096;

/// Complaints that are passed on; the first are the ones that say why.
const MAX_COMPLAINTS: usize = 3;

/// Its exit status when it was interrupted from the keyboard, as this program is then too: how a camera's
/// stream ends.
const INTERRUPTED: i32 = 255;

/// Where a video comes from.
pub enum VideoInput {
    /// A file.
    File(PathBuf),
    /// A camera of this machine, such as `/dev/video0`.
    Device(PathBuf),
    /// An address that `ffmpeg` knows how to open, such as that of a network camera.
    Address(String),
    /// The bytes of a container or stream that need no seeking.
    Pipe(Box<dyn Read + Send>),
}

impl VideoInput {
    /// What errors name.
    fn name(&self) -> PathBuf {
        match self {
            Self::File(path) | Self::Device(path) => path.clone(),
            Self::Address(address) => PathBuf::from(address),
            Self::Pipe(_) => PathBuf::from("standard input"),
        }
    }

    fn arguments(&self) -> Vec<OsString> {
        // With `file:` a name is a name, also if it begins with a dash or has a colon.
        let file = |path: &Path| {
            let mut name = OsString::from("file:");
            name.push(path);
            name
        };
        let words = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
        match self {
            Self::File(path) => vec!["-i".into(), file(path)],
            Self::Address(address) => vec!["-i".into(), address.into()],
            Self::Pipe(_) => words(&["-i", "pipe:0"]),
            Self::Device(path) => {
                let format = match std::env::consts::OS {
                    "macos" => "avfoundation",
                    "windows" => "dshow",
                    _ => "v4l2",
                };
                let mut arguments = words(&["-f", format, "-i"]);
                arguments.push(path.into());
                arguments
            }
        }
    }
}

/// The program `ffmpeg`.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    program: PathBuf,
    /// The option that keeps every frame at its own time; its name changed with version 5.1.
    passthrough: &'static str,
}

impl Ffmpeg {
    /// The one that is installed.
    ///
    /// # Errors
    /// A [`FileError`] that says how to install it if there is none.
    pub fn find() -> Result<Self, FileError> {
        Self::at(Path::new("ffmpeg"))
    }

    /// The program at this path.
    ///
    /// # Errors
    /// As [`Ffmpeg::find`].
    pub fn at(program: &Path) -> Result<Self, FileError> {
        let mut command = Command::new(program);
        command.arg("-version").stdin(Stdio::null()).stderr(Stdio::null());
        let output = command.output().map_err(|error| refused(program, error))?;
        let text = String::from_utf8_lossy(&output.stdout);
        if !output.status.success() || !text.starts_with("ffmpeg version") {
            return Err(FileError::content(program, "this is not ffmpeg: it does not tell its version"));
        }
        let passthrough = if is_before_5_1(&text) { "-vsync" } else { "-fps_mode" };
        Ok(Self { program: program.to_owned(), passthrough })
    }

    /// Opens a video.
    ///
    /// # Errors
    /// A [`FileError`] if the program cannot be started. What is wrong with the video is told by its first
    /// frame.
    pub fn open(&self, input: VideoInput) -> Result<VideoReader, FileError> {
        let name = input.name();
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-nostats", "-loglevel", "level+info"]);
        if !matches!(input, VideoInput::Pipe(_)) {
            command.arg("-nostdin");
        }
        command.args(input.arguments());
        // Nanoseconds as the unit of time, and a line on each frame.
        command.args(["-map", "0:v:0", "-vf", "settb=1/1000000000,showinfo=checksum=0"]);
        command.args([self.passthrough, "passthrough", "-f", "rawvideo", "-pix_fmt", "gray", "pipe:1"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let feed = if let VideoInput::Pipe(pipe) = input { Some(pipe) } else { None };
        command.stdin(if feed.is_some() { Stdio::piped() } else { Stdio::null() });
        let child = command.spawn().map_err(|error| refused(&self.program, error))?;
        VideoReader::of(name, child, feed)
    }
}

/// Why a program could not be started.
fn refused(program: &Path, error: std::io::Error) -> FileError {
    if error.kind() == ErrorKind::NotFound {
        let message = "is not installed; it is what reads videos and cameras. Install it (`apt install ffmpeg`, \
                       `brew install ffmpeg`, `winget install ffmpeg`) or give a folder of images instead";
        return FileError::content(program, message);
    }
    FileError::io(program, error)
}

/// Whether `ffmpeg version N.M…` is older than 5.1. Builds from a repository have no such number and are
/// newer.
fn is_before_5_1(text: &str) -> bool {
    let version = text.trim_start_matches("ffmpeg version ").trim_start_matches('n');
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) => (major, minor) < (5, 1),
        _ => false,
    }
}

/// Reads a video. The child process ends with it.
pub struct VideoReader {
    name: PathBuf,
    child: Child,
    pixels: BufReader<ChildStdout>,
    announced: Receiver<FrameInfo>,
    complaints: Arc<Mutex<Vec<String>>>,
    /// Width and height of the first frame.
    size: Option<(u32, u32)>,
    is_at_end: bool,
}

impl VideoReader {
    fn of(name: PathBuf, mut child: Child, feed: Option<Box<dyn Read + Send>>) -> Result<Self, FileError> {
        let lost = || FileError::content(&name, "ffmpeg was started without its pipes");
        if let Some(feed) = feed {
            let mut stdin = child.stdin.take().ok_or_else(lost)?;
            // It ends when the pipe does or when the child goes away.
            thread::spawn(move || copy(feed, &mut stdin));
        }
        let pixels = BufReader::new(child.stdout.take().ok_or_else(lost)?);
        let stderr = child.stderr.take().ok_or_else(lost)?;
        let complaints = Arc::new(Mutex::new(Vec::new()));
        let (sender, announced) = sync_channel(MAX_ANNOUNCED);
        let heard = complaints.clone();
        thread::spawn(move || listen(stderr, &sender, &heard));
        Ok(Self { name, child, pixels, announced, complaints, size: None, is_at_end: false })
    }

    fn check_size(&mut self, info: FrameInfo) -> Result<usize, FileError> {
        let FrameInfo { width, height, .. } = info;
        let n_pixels = u64::from(width) * u64::from(height);
        if n_pixels == 0 || n_pixels > MAX_PIXELS {
            let message = format!("{width}x{height} pixels are too many or too few for an image");
            return Err(FileError::content(&self.name, message));
        }
        let (first_width, first_height) = *self.size.get_or_insert((width, height));
        if (width, height) != (first_width, first_height) {
            let message = format!(
                "its images change from {first_width}x{first_height} to {width}x{height} pixels; one camera has \
                 one size"
            );
            return Err(FileError::content(&self.name, message));
        }
        usize::try_from(n_pixels).map_err(|_| FileError::content(&self.name, "images too large"))
    }

    /// How the child ended.
    fn end(&mut self) -> Result<Option<TimedFrame>, FileError> {
        self.is_at_end = true;
        let status = self.child.wait().map_err(|error| FileError::io(&self.name, error))?;
        let said = self.said();
        if said.is_empty() && status.code() == Some(INTERRUPTED) {
            return Ok(None);
        }
        if said.contains("matches no streams") {
            return Err(FileError::content(&self.name, "there is no video in it"));
        }
        if !status.success() {
            return Err(FileError::content(&self.name, format!("ffmpeg cannot read it: {said}")));
        }
        if self.size.is_none() {
            let said = if said.is_empty() { String::new() } else { format!(" (ffmpeg says: {said})") };
            return Err(FileError::content(&self.name, format!("there is no image in it{said}")));
        }
        Ok(None)
    }

    fn said(&self) -> String {
        self.complaints.lock().unwrap_or_else(PoisonError::into_inner).join("; ")
    }
}

impl FrameReader for VideoReader {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        if self.is_at_end {
            return Ok(None);
        }
        let Ok(info) = self.announced.recv() else { return self.end() };
        let n_bytes = self.check_size(info)?;
        let Some(timestamp_ns) = info.timestamp_ns else {
            return Err(FileError::content(&self.name, "a frame has no time"));
        };
        let mut data = vec![0; n_bytes];
        match self.pixels.read_exact(&mut data) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return self.end(),
            Err(error) => return Err(FileError::io(&self.name, error)),
        }
        let FrameInfo { width, height, .. } = info;
        let image = RawImage { format: PixelFormat::Gray8, width, height, row_stride: width, data };
        Ok(Some(TimedFrame { timestamp_ns, image: FrameImage::Raw(image) }))
    }

    fn remark(&self) -> Option<String> {
        let said = self.said();
        let is_remark = self.is_at_end && !said.is_empty();
        is_remark.then(|| format!("{}: it was not read as a whole, ffmpeg says: {said}", self.name.display()))
    }
}

impl Drop for VideoReader {
    fn drop(&mut self) {
        // An error means that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Feeds a child until either end is gone.
fn copy(mut from: Box<dyn Read + Send>, to: &mut impl Write) {
    let _ = std::io::copy(&mut from, to);
}

/// Sorts what the child says until it has ended.
fn listen(stderr: ChildStderr, frames: &SyncSender<FrameInfo>, complaints: &Mutex<Vec<String>>) {
    let mut reader = BufReader::new(stderr);
    let mut line = String::new();
    while let Ok(true) = read_line(&mut reader, &mut line) {
        match LogLine::parse(&line) {
            // Without a receiver the child is about to be ended.
            LogLine::Frame(info) => drop(frames.send(info)),
            LogLine::Complaint(complaint) => {
                let mut complaints = complaints.lock().unwrap_or_else(PoisonError::into_inner);
                if complaints.len() < MAX_COMPLAINTS && !complaints.contains(&complaint) {
                    complaints.push(complaint);
                }
            }
            LogLine::Other => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_told_apart() {
        for (text, is_before) in [
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", true),
            ("ffmpeg version 5.0 Copyright", true),
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright", false),
            ("ffmpeg version n7.1 Copyright", false),
            ("ffmpeg version 8.0 Copyright", false),
            ("ffmpeg version N-113-g5a Copyright", false),
        ] {
            assert_eq!(is_before_5_1(text), is_before, "{text}");
        }
    }

    #[test]
    fn an_absent_program_is_told_with_the_way_to_get_it() {
        let refused = Ffmpeg::at(Path::new("/nowhere/ffmpeg")).unwrap_err().to_string();
        assert!(refused.contains("is not installed") && refused.contains("apt install ffmpeg"), "{refused}");
    }
}
