//! 7-Scenes [Shotton et al., CVPR 2013]: `frame-000000.color.png` and `frame-000000.pose.txt`, four by four,
//! in a folder `seq-01`; no calibration, 30 Hz. And ScanNet [Dai et al., CVPR 2017], unpacked: `color/0.jpg`,
//! `pose/0.txt`, `intrinsic/intrinsic_color.txt`.

use std::path::{Path, PathBuf};

use geometry::nalgebra::{Matrix3, Vector3};
use geometry::{Camera, CameraModel, CameraParameters, Pose};

use super::options::Reading;
use super::{Content, FrameFile, image_size, pictures};
use crate::calibration::checked_camera;
use crate::files::{FileError, TextFile};
use crate::trajectory::{StampedPose, Trajectory, pose_of_matrix};

const COLOR_ENDING: &str = ".color.png";
const POSE_ENDING: &str = ".pose.txt";

/// Both were taken at this rate.
const FRAMES_PER_SECOND: f64 = 30.0;

pub(super) fn is_seven_scenes(root: &Path) -> bool {
    root.join("frame-000000.color.png").is_file()
}

pub(super) fn is_scannet(root: &Path) -> bool {
    root.join("color").is_dir() && root.join("intrinsic/intrinsic_color.txt").is_file()
}

pub(super) fn read_seven_scenes(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let is_color = |path: &PathBuf| path.to_string_lossy().ends_with(COLOR_ENDING);
    let images: Vec<PathBuf> = pictures::pictures(root)?.into_iter().filter(is_color).collect();
    let pose_file = |image: &Path| {
        let name = image.file_name().unwrap_or_default().to_string_lossy().into_owned();
        root.join(name.replace(COLOR_ENDING, POSE_ENDING))
    };
    // As published with the data set.
    let parameters = CameraParameters {
        model: CameraModel::Pinhole,
        width: 640,
        height: 480,
        fx: 585.0,
        fy: 585.0,
        cx: 320.0,
        cy: 240.0,
        distortion: Vec::new(),
    };
    content(images, pose_file, reading, |_| checked_camera(root, parameters))
}

pub(super) fn read_scannet(root: &Path, reading: &Reading<'_>) -> Result<Content, FileError> {
    let images = pictures::pictures(&root.join("color"))?;
    let pose_file = |image: &Path| {
        let stem = image.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        root.join("pose").join(format!("{stem}.txt"))
    };
    let camera = |frames: &[FrameFile]| {
        let path = root.join("intrinsic/intrinsic_color.txt");
        let file = TextFile::read(&path)?;
        let k = matrix(&file)?;
        let (width, height) = match frames.first() {
            Some(first) => image_size(&first.path)?,
            None => (0, 0),
        };
        let (fx, fy, cx, cy) = (k[0], k[5], k[2], k[6]);
        let parameters = CameraParameters {
            model: CameraModel::Pinhole,
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion: Vec::new(),
        };
        checked_camera(&path, parameters)
    };
    content(images, pose_file, reading, camera)
}

fn content(
    images: Vec<PathBuf>,
    pose_file: impl Fn(&Path) -> PathBuf,
    reading: &Reading<'_>,
    camera: impl FnOnce(&[FrameFile]) -> Result<Camera, FileError>,
) -> Result<Content, FileError> {
    let frames = pictures::numbered(images, reading.options.fps.unwrap_or(FRAMES_PER_SECOND));
    let mut poses = Vec::new();
    for frame in &frames {
        let path = pose_file(&frame.path);
        if path.is_file()
            && let Some(world_from_camera) = pose(&path)?
        {
            poses.push(StampedPose { timestamp_ns: frame.timestamp_ns, world_from_camera });
        }
    }
    let ground_truth = (!poses.is_empty()).then(|| Trajectory::new(poses));
    Ok(Content { camera: reading.camera(&frames, || camera(&frames))?, frames, ground_truth })
}

/// Sixteen numbers; what has no pose is infinite.
fn matrix(file: &TextFile) -> Result<[f64; 16], FileError> {
    let mut numbers = Vec::new();
    for line in file.lines() {
        for word in line.words() {
            numbers.push(word.parse().map_err(|_| line.error(format!("`{word}` is not a number")))?);
        }
    }
    let n_found = numbers.len();
    numbers
        .try_into()
        .map_err(|_| file.error(format!("four rows of four numbers expected, {n_found} numbers found")))
}

/// `world_from_camera`; `None` where it was not known.
fn pose(path: &Path) -> Result<Option<Pose>, FileError> {
    let file = TextFile::read(path)?;
    let m = matrix(&file)?;
    if !m.iter().all(|number: &f64| number.is_finite()) {
        return Ok(None);
    }
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let pose = pose_of_matrix(&rotation, Vector3::new(m[3], m[7], m[11]));
    pose.map(Some).ok_or_else(|| file.error("the first three columns are not a rotation"))
}
