//! Recordings: folders of images with times and a calibration, in the layouts in use.
//!
//! | layout | recognized by | times | calibration | ground truth |
//! |---|---|---|---|---|
//! | `folder` | `rgb.txt`, `calib.json` | `rgb.txt` | `calib.json` | `groundtruth.txt` |
//! | `euroc` | `mav0/cam0/data.csv` | `data.csv` | `sensor.yaml`, or a camchain of Kalibr | `state_groundtruth_estimate0`, brought to the camera by `T_BS` |
//! | `kitti` | `image_0/` to `image_3/`, `times.txt` | `times.txt` | `calib.txt` | `poses.txt` or `../../poses/NN.txt` |
//! | `tum` | `rgb.txt`, `freiburg1`-`3` in the folder's name or in a comment | `rgb.txt` | published, by camera | `groundtruth.txt` |
//! | `icl` | `rgb/` and `associations.txt` or `*.gt.freiburg` | numbers / 30 Hz | published | `*.gt.freiburg`, mirrored |
//! | `7scenes` | `frame-000000.color.png` | numbers / 30 Hz | published | `*.pose.txt` |
//! | `scannet` | `color/`, `intrinsic/intrinsic_color.txt` | numbers / 30 Hz | `intrinsic_color.txt` | `pose/` |
//! | `pictures` | pictures in it, or in `images/`, `rgb/`, … | a rate, or their names | `calib.json` | `groundtruth.txt` |

mod euroc;
mod folder;
mod icl;
mod kitti;
mod listing;
mod options;
mod pictures;
mod playback;
mod seven_scenes;
mod tum;

pub use options::{CameraOfSize, OpenOptions};
pub use playback::Playback;

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use geometry::Camera;
use options::Reading;

use crate::Trajectory;
use crate::files::FileError;

/// The calibration beside a recording's images.
const CALIBRATION: &str = "calib.json";

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
    /// 7-Scenes.
    SevenScenes,
    /// ScanNet, unpacked.
    ScanNet,
    /// Pictures without a list.
    Pictures,
}

impl Layout {
    /// All layouts, in the order in which they are tried: those with a calibration of their own first.
    pub const ALL: [Self; 8] = [
        Self::Folder,
        Self::Euroc,
        Self::Kitti,
        Self::Tum,
        Self::Icl,
        Self::SevenScenes,
        Self::ScanNet,
        Self::Pictures,
    ];

    /// The name users write.
    pub fn name(self) -> &'static str {
        match self {
            Self::Folder => "folder",
            Self::Euroc => "euroc",
            Self::Kitti => "kitti",
            Self::Tum => "tum",
            Self::Icl => "icl",
            Self::SevenScenes => "7scenes",
            Self::ScanNet => "scannet",
            Self::Pictures => "pictures",
        }
    }

    /// The layout of the recording in `root`, if it is one we know. Where the camera is given, the recording
    /// need not bring its calibration.
    fn recognize(root: &Path, has_camera: bool) -> Option<Self> {
        Self::ALL.into_iter().find(|layout| match layout {
            Self::Folder => folder::is_recording(root, has_camera),
            Self::Euroc => euroc::is_recording(root),
            Self::Kitti => kitti::is_recording(root),
            Self::Tum => tum::is_recording(root),
            Self::Icl => icl::is_recording(root),
            Self::SevenScenes => seven_scenes::is_seven_scenes(root),
            Self::ScanNet => seven_scenes::is_scannet(root),
            // A list without a calibration lacks the calibration, and no rate.
            Self::Pictures => !root.join(folder::LIST).is_file() && pictures::is_recording(root),
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
    /// An image file.
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
    /// What the user should know of how it was read: the unit of its times, lines that were left out.
    pub remarks: Vec<String>,
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
        Self::open_with(root, &OpenOptions { layout, ..OpenOptions::default() })
    }

    /// As [`open`](Self::open), read as the options say.
    ///
    /// # Errors
    /// A [`FileError`] that names the file and line, and what would be right.
    pub fn open_with(root: &Path, options: &OpenOptions<'_>) -> Result<Self, FileError> {
        // Resolves `.` and links, since a recording's name is its folder's.
        let root = &root.canonicalize().map_err(|source| FileError::io(root, source))?;
        let Some(layout) = options.layout.or_else(|| Layout::recognize(root, options.camera.is_some()))
        else {
            return Err(FileError::content(root, unknown_layout(root)));
        };
        let reading = Reading::new(options);
        let content = match layout {
            Layout::Folder => folder::read(root, &reading),
            Layout::Euroc => euroc::read(root, &reading),
            Layout::Kitti => kitti::read(root, &reading),
            Layout::Tum => tum::read(root, &reading),
            Layout::Icl => icl::read(root, &reading),
            Layout::SevenScenes => seven_scenes::read_seven_scenes(root, &reading),
            Layout::ScanNet => seven_scenes::read_scannet(root, &reading),
            Layout::Pictures => pictures::read(root, &reading),
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
            remarks: reading.into_remarks(root),
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
             the folder's name. Give the calibration with --camera FILE, the field of view with --fov, or have it found \
             with --camera unknown (for other recordings name the layout with --layout)",
        );
    }
    let names = Layout::ALL.map(Layout::name).join(", ");
    format!("no recording of a known layout here ({names}), and no pictures")
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
mod people_tests;
#[cfg(test)]
mod tests;
