//! Writes a sequence as a folder: `images/*.png`, `rgb.txt`, `calib.json`, `groundtruth.txt`.

use std::fmt::Write as _;
use std::fs;
use std::io::{self, BufWriter};
use std::path::Path;

use geometry::CameraParameters;

use crate::image::GrayImage;
use crate::sequence::Sequence;

impl GrayImage {
    /// Writes a PNG file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_png(&self, path: impl AsRef<Path>) -> io::Result<()> {
        let file = BufWriter::new(fs::File::create(path)?);
        let mut encoder = png::Encoder::new(file, self.width(), self.height());
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().map_err(io::Error::other)?;
        writer.write_image_data(self.pixels()).map_err(io::Error::other)?;
        writer.finish().map_err(io::Error::other)
    }
}

impl Sequence {
    /// Renders all frames into `dir`, which is made if it is not there.
    ///
    /// `rgb.txt` has lines `timestamp path`, `groundtruth.txt` lines `t tx ty tz qx qy qz qw` of
    /// `world_from_camera` (TUM format), both with times in seconds; `calib.json` has the keys `model, width,
    /// height, fx, fy, cx, cy, dist`.
    ///
    /// # Errors
    /// If a folder or file cannot be written.
    pub fn write_dataset(&self, dir: impl AsRef<Path>) -> io::Result<()> {
        let dir = dir.as_ref();
        fs::create_dir_all(dir.join("images"))?;
        let mut list = String::new();
        for (i, frame) in self.frames().enumerate() {
            let name = format!("images/{i:06}.png");
            frame.image.save_png(dir.join(&name))?;
            writeln!(list, "{} {name}", seconds(frame.timestamp_ns)).expect("writing to a string");
        }
        fs::write(dir.join("rgb.txt"), list)?;
        fs::write(dir.join("groundtruth.txt"), self.ground_truth_tum())?;
        fs::write(dir.join("calib.json"), calibration_json(self.camera().parameters()))
    }

    /// The true trajectory in TUM format, camera to world.
    pub fn ground_truth_tum(&self) -> String {
        let mut lines = String::new();
        for (timestamp_ns, pose) in self.ground_truth() {
            let (t, q) = (pose.translation, pose.rotation.coords);
            writeln!(
                lines,
                "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
                seconds(timestamp_ns),
                t.x,
                t.y,
                t.z,
                q.x,
                q.y,
                q.z,
                q.w
            )
            .expect("writing to a string");
        }
        lines
    }
}

fn seconds(timestamp_ns: i64) -> String {
    format!("{}.{:09}", timestamp_ns / 1_000_000_000, timestamp_ns % 1_000_000_000)
}

fn calibration_json(camera: &CameraParameters) -> String {
    let model = camera.model.name();
    let CameraParameters { width, height, fx, fy, cx, cy, distortion, .. } = camera;
    // `{:?}` keeps the decimal point of whole numbers and all digits of others.
    format!(
        "{{\"model\": \"{model}\", \"width\": {width}, \"height\": {height}, \"fx\": {fx:?}, \"fy\": {fy:?}, \
         \"cx\": {cx:?}, \"cy\": {cy:?}, \"dist\": {distortion:?}}}\n"
    )
}
