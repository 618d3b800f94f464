//! A rendered sequence whose images are kept for the next run, and which may be played backwards.

use geometry::nalgebra::{Vector2, Vector3};
use geometry::{Camera, Pose};
use std::error::Error;
use std::path::{Path, PathBuf};
use synthetic::{Preset, Sequence, SequenceConfig, VisibleSegment, World};
use testkit::gray_image;
use testkit::laboratory::write_pose;
use vision::GrayImage;

pub struct Recording {
    sequence: Sequence,
    /// Where images are kept.
    images: Option<PathBuf>,
    backwards: bool,
}

impl Recording {
    /// Images are kept in `folder`, in a folder of this preset, seed and readout.
    pub fn new(
        preset: Preset,
        seed: u64,
        folder: Option<&Path>,
        backwards: bool,
        readout_ms: f64,
    ) -> Result<Self, Box<dyn Error>> {
        let rolling = if readout_ms == 0.0 { String::new() } else { format!("-readout-{readout_ms}") };
        let images = folder.map(|folder| folder.join(format!("{}-{seed}{rolling}", preset.name())));
        let mut config = SequenceConfig::preset(preset, seed);
        config.render.readout_s = readout_ms / 1e3;
        Ok(Self { sequence: Sequence::new(config)?, images, backwards })
    }

    pub fn len(&self) -> usize {
        self.sequence.len()
    }

    pub fn camera(&self) -> &Camera {
        self.sequence.camera()
    }

    pub fn world(&self) -> &World {
        self.sequence.world()
    }

    /// Of frame `index` as played.
    pub fn timestamp_ns(&self, index: usize) -> i64 {
        self.sequence.timestamp_ns(index)
    }

    /// The true trajectory.
    pub fn to_tum(&self) -> String {
        let mut text = String::new();
        for index in 0..self.len() {
            write_pose(&mut text, self.timestamp_ns(index), &self.camera_from_world(index).inverse());
        }
        text
    }

    /// Of frame `index` as played.
    pub fn camera_from_world(&self, index: usize) -> Pose {
        self.sequence.camera_from_world(self.rendered(index))
    }

    /// The visible edges of frame `index` as played with more contrast than that, ends in pixels without lens
    /// distortion.
    pub fn edges(&self, index: usize, min_contrast: f64) -> Vec<[Vector2<f64>; 2]> {
        let seen = self.sequence.visible_segments(self.rendered(index)).into_iter();
        let undistort = |pixel: &Vector2<f64>| self.camera().undistort(pixel);
        seen.filter(|edge| edge.contrast >= min_contrast)
            .filter_map(|edge| Some([undistort(&edge.ends_px[0])?, undistort(&edge.ends_px[1])?]))
            .collect()
    }

    /// The visible edges of frame `index` as played.
    pub fn visible_segments(&self, index: usize) -> Vec<VisibleSegment> {
        self.sequence.visible_segments(self.rendered(index))
    }

    /// What is seen in a direction, camera frame, of frame `index` as played.
    pub fn cast(&self, index: usize, bearing: &Vector3<f64>) -> Option<Vector3<f64>> {
        let world_from_camera = self.camera_from_world(index).inverse();
        let direction = world_from_camera.rotation * bearing.normalize();
        Some(self.world().cast_ray(&world_from_camera.translation, &direction)?.point)
    }

    /// Renders frame `index` as played, or takes it from where it was kept.
    pub fn image(&self, index: usize) -> Result<GrayImage, Box<dyn Error>> {
        let index = self.rendered(index);
        let (width, height) = (self.camera().width(), self.camera().height());
        let kept = self.images.as_ref().map(|folder| folder.join(format!("{index:05}.gray")));
        if let Some(pixels) = kept.as_ref().and_then(|path| std::fs::read(path).ok()) {
            return GrayImage::from_raw(width, height, pixels).map_err(|error| error.to_string().into());
        }
        let image = gray_image(self.sequence.frame(index).image);
        if let (Some(folder), Some(path)) = (&self.images, kept) {
            std::fs::create_dir_all(folder)?;
            // Several runs may share the folder: a file of that name is always whole.
            let partial = path.with_extension(std::process::id().to_string());
            std::fs::write(&partial, image.as_raw())?;
            std::fs::rename(&partial, path)?;
        }
        Ok(image)
    }

    fn rendered(&self, index: usize) -> usize {
        if self.backwards { self.len() - 1 - index } else { index }
    }
}
