//! Messages of either kind of file, in the order in which they are there.

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;

use mcap::McapError;
use mcap::sans_io::LinearReaderOptions;
use thiserror::Error;

use super::MAX_BYTES;
use super::fields::Encoding;
use super::ros1::Ros1Reader;
use crate::files::FileError;

/// What keeps a file from being read on.
#[derive(Debug, Error)]
pub(super) enum Damage {
    #[error("it ends early")]
    EndsEarly,
    #[error("it is damaged: {0}")]
    Content(String),
    #[error("{0}")]
    Io(std::io::Error),
}

impl Damage {
    pub(super) fn content(message: impl Into<String>) -> Self {
        Self::Content(message.into())
    }

    /// As an error of the file.
    pub(super) fn of_file(self, path: &Path) -> FileError {
        match self {
            Self::Io(error) => FileError::io(path, error),
            damage => FileError::content(path, damage.to_string()),
        }
    }
}

impl From<std::io::Error> for Damage {
    fn from(error: std::io::Error) -> Self {
        if error.kind() == ErrorKind::UnexpectedEof { Self::EndsEarly } else { Self::Io(error) }
    }
}

/// Messages that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MessageKind {
    Image,
    CompressedImage,
    CameraInfo,
}

impl MessageKind {
    /// Of a type's name in ROS 1 or ROS 2.
    pub(super) fn of_type(name: &str) -> Option<Self> {
        match name {
            "sensor_msgs/Image" | "sensor_msgs/msg/Image" => Some(Self::Image),
            "sensor_msgs/CompressedImage" | "sensor_msgs/msg/CompressedImage" => Some(Self::CompressedImage),
            "sensor_msgs/CameraInfo" | "sensor_msgs/msg/CameraInfo" => Some(Self::CameraInfo),
            _ => None,
        }
    }

    pub(super) fn is_image(self) -> bool {
        self != Self::CameraInfo
    }
}

/// One message.
pub(super) struct RosMessage {
    pub(super) topic: String,
    pub(super) kind: MessageKind,
    pub(super) encoding: Encoding,
    /// When it was written to the file.
    pub(super) log_time_ns: i64,
    pub(super) data: Vec<u8>,
}

/// The messages of a file.
pub(super) enum Messages {
    Mcap(Box<mcap::io::MessageReader<BufReader<File>>>),
    Ros1(Box<Ros1Reader<BufReader<File>>>),
}

impl Messages {
    pub(super) fn open(path: &Path) -> Result<Self, FileError> {
        let is_mcap = match start_of(path).map_err(|error| FileError::io(path, error))? {
            start if start.starts_with(mcap::MAGIC) => true,
            start if start.starts_with(super::ros1::MAGIC) => false,
            _ => {
                let message = "it is neither an MCAP file nor a ROS 1 bag of version 2.0";
                return Err(FileError::content(path, message));
            }
        };
        let file = BufReader::new(File::open(path).map_err(|error| FileError::io(path, error))?);
        if !is_mcap {
            let reader = Ros1Reader::new(file).map_err(|damage| damage.of_file(path))?;
            return Ok(Self::Ros1(Box::new(reader)));
        }
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_BYTES);
        Ok(Self::Mcap(Box::new(mcap::io::MessageReader::new_with_options(file, options))))
    }

    /// The next message that is understood and wanted by its kind and topic.
    pub(super) fn next(
        &mut self,
        is_wanted: impl Fn(MessageKind, &str) -> bool,
    ) -> Result<Option<RosMessage>, Damage> {
        match self {
            Self::Ros1(reader) => reader.next(is_wanted),
            Self::Mcap(reader) => {
                for message in reader {
                    let message = message.map_err(damage_of_mcap)?;
                    if let Some(message) = of_mcap(message, &is_wanted)? {
                        return Ok(Some(message));
                    }
                }
                Ok(None)
            }
        }
    }
}

fn of_mcap(
    message: mcap::Message<'_>,
    is_wanted: &impl Fn(MessageKind, &str) -> bool,
) -> Result<Option<RosMessage>, Damage> {
    let channel = &message.channel;
    let Some(schema) = &channel.schema else { return Ok(None) };
    let Some(kind) = MessageKind::of_type(&schema.name) else { return Ok(None) };
    if !is_wanted(kind, &channel.topic) {
        return Ok(None);
    }
    let data = message.data.into_owned();
    let encoding = match channel.message_encoding.as_str() {
        "cdr" => Encoding::of_cdr(&data)
            .map_err(|reason| Damage::content(format!("a message of {}: {reason}", channel.topic)))?,
        "ros1" => Encoding::Ros1,
        other => {
            let message =
                format!("messages of {} are encoded as `{other}`, not as cdr or ros1", channel.topic);
            return Err(Damage::content(message));
        }
    };
    let log_time_ns = i64::try_from(message.log_time).unwrap_or(i64::MAX);
    Ok(Some(RosMessage { topic: channel.topic.clone(), kind, encoding, log_time_ns, data }))
}

fn damage_of_mcap(error: McapError) -> Damage {
    match error {
        McapError::UnexpectedEof => Damage::EndsEarly,
        McapError::Io(error) => match Damage::from(error) {
            // A chunk that cannot be unpacked is told so too.
            Damage::Io(error) => Damage::content(error.to_string()),
            damage => damage,
        },
        error => Damage::content(error.to_string()),
    }
}

/// Whether a file begins as one that is read here.
pub(super) fn begins_as_one(path: &Path) -> bool {
    start_of(path).is_ok_and(|start| start.starts_with(mcap::MAGIC) || start.starts_with(super::ros1::MAGIC))
}

fn start_of(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::new();
    File::open(path)?.take(16).read_to_end(&mut start)?;
    Ok(start)
}
