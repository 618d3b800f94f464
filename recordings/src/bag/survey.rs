//! What is in a file: its topics with images, and the calibrations.

use std::collections::BTreeMap;
use std::path::Path;

use geometry::Camera;

use super::calibration;
use super::container::{Damage, MessageKind, Messages, RosMessage};
use crate::files::FileError;

/// Topics that are kept; a robot has dozens of cameras at most.
const MAX_TOPICS: usize = 1024;

/// What was found.
pub(super) struct Survey {
    /// Number of images by topic.
    images: BTreeMap<String, usize>,
    /// The first calibration of each topic that has some.
    calibrations: BTreeMap<String, RosMessage>,
    /// What is wrong with the file without keeping it from being read.
    pub(super) remark: Option<String>,
}

impl Survey {
    /// Reads through a file.
    pub(super) fn of(path: &Path) -> Result<Self, FileError> {
        let mut survey = Self { images: BTreeMap::new(), calibrations: BTreeMap::new(), remark: None };
        let mut messages = Messages::open(path)?;
        loop {
            match messages.next(|_, _| true) {
                Ok(Some(message)) => survey.note(message).map_err(|damage| damage.of_file(path))?,
                Ok(None) => break,
                // A recording that was interrupted is good as far as it goes.
                Err(Damage::EndsEarly) if !survey.images.is_empty() => {
                    let end = "it ends early; what is there was read";
                    survey.remark = Some(format!("{}: {end}", path.display()));
                    break;
                }
                Err(damage) => return Err(damage.of_file(path)),
            }
        }
        Ok(survey)
    }

    fn note(&mut self, message: RosMessage) -> Result<(), Damage> {
        if self.images.len().max(self.calibrations.len()) >= MAX_TOPICS {
            return Err(Damage::content("it has more topics with images than a robot has cameras"));
        }
        if message.kind == MessageKind::CameraInfo {
            self.calibrations.entry(message.topic.clone()).or_insert(message);
        } else {
            *self.images.entry(message.topic).or_default() += 1;
        }
        Ok(())
    }

    /// The topic of that name, or the only one, and the number of its images.
    pub(super) fn choose(&self, path: &Path, wanted: Option<&str>) -> Result<(String, usize), FileError> {
        let refused = |message: String| Err(FileError::content(path, message));
        let list =
            self.images.iter().map(|(topic, n)| format!("{topic} ({n})")).collect::<Vec<_>>().join(", ");
        match (wanted, self.images.len()) {
            (_, 0) => refused("there are no images in it (sensor_msgs/Image or CompressedImage)".to_owned()),
            (Some(topic), _) => match self.images.get(topic) {
                Some(n_images) => Ok((topic.to_owned(), *n_images)),
                None => {
                    refused(format!("there are no images of the topic {topic}; there are some of {list}"))
                }
            },
            (None, 1) => {
                let only = self.images.iter().next().map(|(topic, n)| (topic.clone(), *n));
                only.map_or_else(|| refused(list), Ok)
            }
            (None, _) => {
                refused(format!("there are images of several topics, choose one by --topic: {list}"))
            }
        }
    }

    /// The calibration beside a topic of images, if there is one, or what is wrong with it.
    pub(super) fn camera(&self, topic: &str) -> Option<Result<Camera, String>> {
        let namespace = namespace(topic);
        let beside = self.calibrations.iter().find(|(name, _)| self::namespace(name) == namespace);
        // A camera's own topic may be deeper: /camera/image and /camera/left/camera_info do not go together.
        let only =
            (self.calibrations.len() == 1 && self.images.len() == 1).then(|| self.calibrations.iter().next());
        let (name, message) = beside.or(only.flatten())?;
        let is_rectified = topic.contains("rect");
        let camera = calibration::decode(message, is_rectified);
        Some(camera.map_err(|reason| format!("the calibration of {name}: {reason}")))
    }
}

/// What a camera's topics have in common: `/left` of `/left/image_raw/compressed` and `/left/camera_info`.
fn namespace(topic: &str) -> &str {
    let transports = ["/compressed", "/theora", "/compressedDepth"];
    let plain = transports.iter().find_map(|transport| topic.strip_suffix(transport)).unwrap_or(topic);
    plain.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_of_a_camera_have_the_same_namespace() {
        for topic in ["/left/image_raw", "/left/image_raw/compressed", "/left/camera_info"] {
            assert_eq!(namespace(topic), "/left");
        }
        assert_eq!(namespace("/image"), "");
        assert_eq!(namespace("image"), "");
    }
}
