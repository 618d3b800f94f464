//! Recordings of robots: MCAP files as ROS 2 writes them, and bag files of ROS 1 (version 2.0).
//!
//! Images are `sensor_msgs/Image` and `sensor_msgs/CompressedImage` of one topic, the calibration is the
//! `sensor_msgs/CameraInfo` beside it. Times are those of the messages' headers. A file is read from its
//! beginning to its end, once to see what is in it and whether it is whole, and once for the frames; neither
//! needs its index, and no more of it is in memory than one chunk.

mod calibration;
mod container;
mod fields;
mod image;
mod ros1;
mod survey;

use std::path::{Path, PathBuf};

use geometry::Camera;

use crate::files::FileError;
use crate::frames::{FrameReader, TimedFrame};
use container::{Damage, MessageKind, Messages};
use survey::Survey;

/// Largest message, and largest chunk of messages, that is read, bytes: many times what a camera gives.
const MAX_BYTES: usize = 256 << 20;

/// An opened MCAP or bag file and the topic whose images are wanted.
#[derive(Clone, Debug)]
pub struct Bag {
    path: PathBuf,
    topic: String,
    n_images: usize,
    /// The recorded calibration, or what is wrong with it.
    camera: Option<Result<Camera, String>>,
    remark: Option<String>,
}

impl Bag {
    /// Whether a file begins as an MCAP or a bag file does, or has the name of one.
    pub fn is_bag(path: &Path) -> bool {
        let has_name = path.extension().is_some_and(|extension| extension == "mcap" || extension == "bag");
        path.is_file() && (has_name || container::begins_as_one(path))
    }

    /// Reads through a file and chooses the topic of that name, or the only one with images.
    ///
    /// # Errors
    /// A [`FileError`] if the file is no such file or damaged, or if the topic is not clear: then it lists
    /// those there are. A file that only ends early is taken as far as it goes.
    pub fn open(path: &Path, topic: Option<&str>) -> Result<Self, FileError> {
        let survey = Survey::of(path)?;
        let (topic, n_images) = survey.choose(path, topic)?;
        let camera = survey.camera(&topic);
        Ok(Self { path: path.to_owned(), topic, n_images, camera, remark: survey.remark })
    }

    /// The topic of the images.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// The number of its images.
    pub fn n_images(&self) -> usize {
        self.n_images
    }

    /// The calibration that is recorded beside the topic, if there is one.
    ///
    /// # Errors
    /// A [`FileError`] if it is none that can be used.
    pub fn camera(&self) -> Result<Option<&Camera>, FileError> {
        match &self.camera {
            None => Ok(None),
            Some(Ok(camera)) => Ok(Some(camera)),
            Some(Err(reason)) => Err(FileError::content(&self.path, reason)),
        }
    }

    /// Reads the images.
    ///
    /// # Errors
    /// A [`FileError`] if the file cannot be opened.
    pub fn frames(&self) -> Result<BagReader, FileError> {
        let messages = Messages::open(&self.path)?;
        let path = self.path.clone();
        let (topic, remark) = (self.topic.clone(), self.remark.clone());
        Ok(BagReader { path, topic, messages, remark, last_ns: None, n_left_out: 0 })
    }
}

/// Reads the images of one topic in the order of the file.
pub struct BagReader {
    path: PathBuf,
    topic: String,
    messages: Messages,
    /// What the survey had to say.
    remark: Option<String>,
    last_ns: Option<i64>,
    /// Images whose time is not after that of the one before.
    n_left_out: usize,
}

impl FrameReader for BagReader {
    fn next_frame(&mut self) -> Result<Option<TimedFrame>, FileError> {
        loop {
            let is_wanted = |kind: MessageKind, topic: &str| kind.is_image() && topic == self.topic;
            let message = match self.messages.next(is_wanted) {
                Ok(Some(message)) => message,
                Ok(None) | Err(Damage::EndsEarly) => return Ok(None),
                Err(damage) => return Err(damage.of_file(&self.path)),
            };
            let frame = image::decode(&message).map_err(|reason| {
                FileError::content(&self.path, format!("an image of {}: {reason}", self.topic))
            })?;
            if self.last_ns.is_some_and(|last_ns| frame.timestamp_ns <= last_ns) {
                self.n_left_out += 1;
                continue;
            }
            self.last_ns = Some(frame.timestamp_ns);
            return Ok(Some(frame));
        }
    }

    fn remark(&self) -> Option<String> {
        let left_out = (self.n_left_out > 0).then(|| {
            let (path, n) = (self.path.display(), self.n_left_out);
            format!("{path}: {n} images were left out, their times are not after those of the ones before")
        });
        let remarks: Vec<String> = self.remark.iter().cloned().chain(left_out).collect();
        (!remarks.is_empty()).then(|| remarks.join("\n"))
    }
}
