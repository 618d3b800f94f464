//! Recordings: folders of images with times and a calibration, in the layouts in use.
//!
//! | layout | recognized by | times | calibration | ground truth |
//! |---|---|---|---|---|
//! | `folder` | `rgb.txt`, `calib.json` | `rgb.txt` | `calib.json` | `groundtruth.txt` |
//! | `euroc` | `mav0/cam0/data.csv` | `data.csv` | `sensor.yaml` | `state_groundtruth_estimate0`, brought to the camera by `T_BS` |
//! | `kitti` | `image_0/`, `times.txt` | `times.txt` | `calib.txt` | `poses.txt` or `../../poses/NN.txt` |
//! | `tum` | `rgb.txt`, `freiburg1`-`3` in the folder's name or in a comment | `rgb.txt` | published, by camera | `groundtruth.txt` |
//! | `icl` | `rgb/` and `associations.txt` or `*.gt.freiburg` | numbers / 30 Hz | published | `*.gt.freiburg`, mirrored |

mod euroc;
mod folder;
mod icl;
mod kitti;
mod listing;
mod playback;
mod tum;

pub use folder::read_calibration;
pub use playback::Playback;

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use geometry::{Camera, CameraParameters};

use crate::Trajectory;
use crate::files::FileError;

/// How a recording is laid out in its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `rgb.txt` with `calib.json`.
    Folder,
    /// EuRoC, also known as ASL.
    Euroc,
    /// KITTI odometry.
    Kitti,
    /// TUM RGB-D.
    Tum,
    /// ICL-NUIM in the form compatible with TUM RGB-D.
    Icl,
}

impl Layout {
    /// All layouts, in the order in which they are tried: those with a calibration of their own first.
    pub const ALL: [Self; 5] = [Self::Folder, Self::Euroc, Self::Kitti, Self::Tum, Self::Icl];

    /// The name users write.
    pub fn name(self) -> &'static str {
        match self {
            Self::Folder => "folder",
            Self::Euroc => "euroc",
            Self::Kitti => "kitti",
            Self::Tum => "tum",
            Self::Icl => "icl",
        }
    }

    /// The layout of the recording in `root`, if it is one we know.
    pub fn recognize(root: &Path) -> Option<Self> {
        Self::ALL.into_iter().find(|layout| match layout {
            Self::Folder => folder::is_recording(root),
            Self::Euroc => euroc::is_recording(root),
            Self::Kitti => kitti::is_recording(root),
            Self::Tum => tum::is_recording(root),
            Self::Icl => icl::is_recording(root),
        })
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|layout| layout.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("`{text}` is not a layout: {names}")
        })
    }
}

/// One image of a recording, not yet read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameFile {
    /// Time of the image, nanoseconds.
    pub timestamp_ns: i64,
    /// A PNG or JPEG file.
    pub path: PathBuf,
}

/// A recording on disk: its images in the order of time, its camera, and its ground truth if it has one.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The folder's name.
    pub name: String,
    /// How it is laid out.
    pub layout: Layout,
    /// The camera all images were taken with.
    pub camera: Camera,
    /// The images, at least one; times strictly increase.
    pub frames: Vec<FrameFile>,
    /// The true `world_from_camera`, where it is known.
    pub ground_truth: Option<Trajectory>,
}

impl Recording {
    /// Opens the recording in the folder `root`, of the given layout or of the one recognized.
    ///
    /// The calibration is checked, as are the times and that every image is there with the first of the
    /// calibrated size; images are not decoded.
    ///
    /// # Errors
    /// A [`FileError`] that names the file and line.
    pub fn open(root: &Path, layout: Option<Layout>) -> Result<Self, FileError> {
        // Resolves `.` and links, since a recording's name is its folder's.
        let root = &root.canonicalize().map_err(|source| FileError::io(root, source))?;
        let Some(layout) = layout.or_else(|| Layout::recognize(root)) else {
            return Err(FileError::content(root, unknown_layout(root)));
        };
        let content = match layout {
            Layout::Folder => folder::read(root),
            Layout::Euroc => euroc::read(root),
            Layout::Kitti => kitti::read(root),
            Layout::Tum => tum::read(root),
            Layout::Icl => icl::read(root),
        }?;
        check_frames(root, &content)?;
        let name =
            root.file_name().map_or_else(|| layout.to_string(), |name| name.to_string_lossy().into_owned());
        Ok(Self {
            name,
            layout,
            camera: content.camera,
            frames: content.frames,
            ground_truth: content.ground_truth,
        })
    }
}

/// What a layout's reader finds.
struct Content {
    camera: Camera,
    frames: Vec<FrameFile>,
    ground_truth: Option<Trajectory>,
}

fn unknown_layout(root: &Path) -> String {
    if root.join("rgb.txt").is_file() {
        return String::from(
            "the camera is not known: there is neither a calib.json nor a freiburg1, freiburg2 or freiburg3 in \
             the folder's name (for other recordings name the layout with --layout)",
        );
    }
    let names = Layout::ALL.map(Layout::name).join(", ");
    format!("no recording of a known layout here ({names})")
}

/// Checks a calibration that was read from `path`.
fn checked_camera(path: &Path, parameters: CameraParameters) -> Result<Camera, FileError> {
    Camera::new(parameters).map_err(|refused| FileError::content(path, refused.message))
}

fn check_frames(root: &Path, content: &Content) -> Result<(), FileError> {
    let Some(first) = content.frames.first() else {
        return Err(FileError::content(root, "the recording has no images"));
    };
    for pair in content.frames.windows(2) {
        if pair[1].timestamp_ns <= pair[0].timestamp_ns {
            let message =
                format!("taken at {} ns, not after {} ns", pair[1].timestamp_ns, pair[0].timestamp_ns);
            return Err(FileError::content(&pair[1].path, message));
        }
    }
    let (width, height) = image_size(&first.path)?;
    let (calibrated_width, calibrated_height) = (content.camera.width(), content.camera.height());
    if (width, height) != (calibrated_width, calibrated_height) {
        return Err(FileError::content(
            &first.path,
            format!(
                "{width}x{height} pixels, but the camera is calibrated for {calibrated_width}x{calibrated_height}"
            ),
        ));
    }
    Ok(())
}

/// Width and height of an image from its header, pixels.
fn image_size(path: &Path) -> Result<(u32, u32), FileError> {
    let size = imagesize::size(path).map_err(|refused| match refused {
        imagesize::ImageError::IoError(source) => FileError::io(path, source),
        refused => FileError::content(path, refused.to_string()),
    })?;
    let pixels = |n: usize| {
        u32::try_from(n).map_err(|_| FileError::content(path, format!("{n} pixels are no image's side")))
    };
    Ok((pixels(size.width)?, pixels(size.height)?))
}

#[cfg(test)]
mod tests;
