//! What the front end measures in one image, in the coordinates the back end works in.

use geometry::nalgebra::Vector2;
use geometry::{Camera, Pinhole, PinholeCorrection};
use std::sync::Arc;
use vision::{Descriptor, Features, GridBounds, Keypoint, KeypointGrid};

/// The resolutions features are looked for in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PyramidGeometry {
    /// How many levels there are.
    pub n_levels: u8,
    /// Ratio of the sizes of neighboring levels, above 1.
    pub scale_factor: f64,
}

impl PyramidGeometry {
    /// Pixels of the full image per pixel of the level: also the standard deviation of a keypoint's position
    /// found there, in pixels of the full image.
    #[inline]
    pub fn scale(self, octave: u8) -> f64 {
        self.scale_factor.powi(i32::from(octave))
    }

    /// The level at which something seen at `octave_scale` for the full range `farthest` appears at
    /// `distance`.
    #[inline]
    pub fn predict_octave(self, farthest: f64, distance: f64) -> u8 {
        let octave = ((farthest / distance).ln() / self.scale_factor.ln()).ceil();
        octave.clamp(0.0, f64::from(self.n_levels - 1)) as u8
    }
}

/// A segment of one frame, as the back end uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineFeature {
    /// Where it begins, without lens distortion, pixels of the ideal pinhole camera.
    pub start: Vector2<f64>,
    /// Where it ends, likewise. The brighter side is to the right of the way from start to end.
    pub end: Vector2<f64>,
    /// Standard deviation of the line's position at the ends, across it, pixels.
    pub sigma_px: f64,
    /// Descriptor (LBD) of the segment's surroundings.
    pub descriptor: Descriptor,
    /// Number of the track through the frames that the segment belongs to. Begins anew with each run of a
    /// session.
    pub track: u64,
}

impl LineFeature {
    /// Length, pixels.
    pub fn length(&self) -> f64 {
        (self.end - self.start).norm()
    }

    /// The point half way, pixels.
    pub fn midpoint(&self) -> Vector2<f64> {
        (self.start + self.end) / 2.0
    }
}

/// A frame as the front end leaves it: whose it is, and what it shows.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub sequence: u64,
    pub timestamp_ns: i64,
    pub features: Arc<FrameFeatures>,
}

impl View {
    /// Has its rays be those of a camera corrected this way.
    pub fn correct_camera(&mut self, correction: &PinholeCorrection) {
        if !self.features.has_correction(correction) {
            self.features = Arc::new(self.features.with_correction(correction));
        }
    }
}

/// The points and lines of one frame. Immutable once made and shared between the frame, its keyframe and the
/// store.
#[derive(Clone, Debug)]
pub struct FrameFeatures {
    /// Keypoints as detected, in pixels of the working image.
    pub keypoints: Vec<Keypoint>,
    /// The same keypoints without lens distortion, in pixels of the ideal pinhole camera.
    pub undistorted: Vec<Vector2<f64>>,
    /// One binary descriptor per keypoint.
    pub descriptors: Vec<Descriptor>,
    /// Line segments.
    pub lines: Vec<LineFeature>,
    /// The ideal camera of the calibration, in whose pixels the undistorted coordinates are.
    pub nominal_pinhole: Pinhole,
    /// The ideal camera that sees these pixels: the nominal one, corrected as far as the session knows
    /// better.
    pub pinhole: Pinhole,
    /// The resolutions the keypoints were looked for in.
    pub pyramid: PyramidGeometry,
    /// Where undistorted pixels of the image can lie.
    pub bounds: GridBounds,
    /// Index of the undistorted positions for window queries.
    pub(crate) grid: KeypointGrid,
}

impl FrameFeatures {
    /// Takes over what the extractor found, leaving out keypoints where the lens model has no inverse.
    pub(crate) fn from_extracted(extracted: Features, camera: &Camera, pyramid: PyramidGeometry) -> Self {
        let n = extracted.keypoints.len();
        let (mut keypoints, mut undistorted, mut descriptors) =
            (Vec::with_capacity(n), Vec::with_capacity(n), Vec::with_capacity(n));
        for (keypoint, descriptor) in extracted.keypoints.into_iter().zip(extracted.descriptors) {
            let Some(position) = undistort(&keypoint, camera) else { continue };
            keypoints.push(keypoint);
            undistorted.push(position);
            descriptors.push(descriptor);
        }
        Self::assemble(keypoints, undistorted, descriptors, camera, pyramid)
    }

    /// Rebuilds stored features. `None` if the lengths differ or a keypoint lies where the lens model has no
    /// inverse.
    pub fn from_parts(
        keypoints: Vec<Keypoint>,
        descriptors: Vec<Descriptor>,
        working_camera: &Camera,
        pyramid: PyramidGeometry,
    ) -> Option<Self> {
        if keypoints.len() != descriptors.len() {
            return None;
        }
        let undistorted = keypoints
            .iter()
            .map(|keypoint| undistort(keypoint, working_camera))
            .collect::<Option<Vec<_>>>()?;
        Some(Self::assemble(keypoints, undistorted, descriptors, working_camera, pyramid))
    }

    fn assemble(
        keypoints: Vec<Keypoint>,
        undistorted: Vec<Vector2<f64>>,
        descriptors: Vec<Descriptor>,
        camera: &Camera,
        pyramid: PyramidGeometry,
    ) -> Self {
        let (min, max) = camera.undistorted_bounds();
        let bounds =
            GridBounds { min_x: min.x as f32, min_y: min.y as f32, max_x: max.x as f32, max_y: max.y as f32 };
        let entries =
            keypoints.iter().zip(&undistorted).map(|(keypoint, p)| (p.x as f32, p.y as f32, keypoint.octave));
        let grid = KeypointGrid::from_entries(entries, bounds);
        let (lines, nominal_pinhole, pinhole) = (Vec::new(), camera.nominal_pinhole(), camera.pinhole());
        Self { keypoints, undistorted, descriptors, lines, nominal_pinhole, pinhole, pyramid, bounds, grid }
    }

    /// The same features with these lines.
    #[must_use]
    pub fn with_lines(self, lines: Vec<LineFeature>) -> Self {
        Self { lines, ..self }
    }

    /// Whether the rays of its pixels are those of a camera corrected this way.
    pub(crate) fn has_correction(&self, correction: &PinholeCorrection) -> bool {
        self.pinhole == correction.apply(&self.nominal_pinhole)
    }

    /// The same features seen by a camera corrected this way: the pixels stay, the rays change.
    #[must_use]
    pub(crate) fn with_correction(&self, correction: &PinholeCorrection) -> Self {
        Self { pinhole: correction.apply(&self.nominal_pinhole), ..self.clone() }
    }

    /// How many keypoints there are.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there is no keypoint.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Standard deviation of a keypoint's position, pixels.
    #[inline]
    pub(crate) fn sigma_px(&self, feature_idx: usize) -> f64 {
        self.pyramid.scale(self.keypoints[feature_idx].octave)
    }

    /// Width of the undistorted image, pixels.
    #[inline]
    pub(crate) fn width_px(&self) -> f64 {
        f64::from(self.bounds.max_x - self.bounds.min_x)
    }

    /// Whether an undistorted pixel lies in the image.
    #[inline]
    pub(crate) fn contains(&self, pixel: &Vector2<f64>) -> bool {
        let (x, y) = (pixel.x as f32, pixel.y as f32);
        x >= self.bounds.min_x && x <= self.bounds.max_x && y >= self.bounds.min_y && y <= self.bounds.max_y
    }
}

fn undistort(keypoint: &Keypoint, camera: &Camera) -> Option<Vector2<f64>> {
    camera.undistort(&Vector2::new(f64::from(keypoint.x), f64::from(keypoint.y)))
}
