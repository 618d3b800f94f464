//! How a recording is to be read, and what was remarked while it was.

use std::cell::RefCell;
use std::path::Path;

use geometry::Camera;

use super::{FrameFile, Layout, image_size};
use crate::files::FileError;
use crate::units::TimeUnit;

/// Gives the camera of images of a size, width and height in pixels.
pub type CameraOfSize<'a> = &'a dyn Fn((u32, u32)) -> Result<Camera, FileError>;

/// How a recording is to be read.
#[derive(Clone, Copy, Default)]
pub struct OpenOptions<'a> {
    /// Its layout; the one recognized if absent.
    pub layout: Option<Layout>,
    /// Frames a second, of images that have no times.
    pub fps: Option<f64>,
    /// The unit of the times of its list; told by their size and rate if absent.
    pub times: Option<TimeUnit>,
    /// Brings a list into the order of time.
    pub sort: bool,
    /// Leaves out lines of a list that cannot be used.
    pub skip_bad: bool,
    /// The camera, instead of the one the recording brings.
    pub camera: Option<CameraOfSize<'a>>,
}

/// The lines named when some were left out.
const MAX_NAMED: usize = 3;

/// A recording that is being read.
pub(super) struct Reading<'a> {
    pub options: &'a OpenOptions<'a>,
    remarks: RefCell<Vec<String>>,
    skipped: RefCell<Vec<FileError>>,
}

impl<'a> Reading<'a> {
    pub fn new(options: &'a OpenOptions<'a>) -> Self {
        Self { options, remarks: RefCell::default(), skipped: RefCell::default() }
    }

    /// Says something that keeps nothing from being read.
    pub fn remark(&self, sentence: String) {
        self.remarks.borrow_mut().push(sentence);
    }

    /// Passes over a line if that is wanted.
    pub fn bad_line(&self, error: FileError) -> Result<(), FileError> {
        if !self.options.skip_bad {
            return Err(error);
        }
        self.skipped.borrow_mut().push(error);
        Ok(())
    }

    /// The camera that is given, or else the recording's.
    pub fn camera(
        &self,
        frames: &[FrameFile],
        of_recording: impl FnOnce() -> Result<Camera, FileError>,
    ) -> Result<Camera, FileError> {
        match (self.options.camera, frames.first()) {
            (Some(of_size), Some(first)) => of_size(image_size(&first.path)?),
            _ => of_recording(),
        }
    }

    /// What there is to say.
    pub fn into_remarks(self, root: &Path) -> Vec<String> {
        let (mut remarks, skipped) = (self.remarks.into_inner(), self.skipped.into_inner());
        if !skipped.is_empty() {
            let named: Vec<String> = skipped.iter().take(MAX_NAMED).map(ToString::to_string).collect();
            let more = if skipped.len() > MAX_NAMED { ", and others" } else { "" };
            let message = format!("{} lines are left out: {}{more}", skipped.len(), named.join("; "));
            remarks.push(FileError::content(root, message).to_string());
        }
        remarks
    }
}
