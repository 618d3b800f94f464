//! What the front end measures in one image, in the coordinates the back end works in.

use geometry::nalgebra::{Matrix2, SymmetricEigen, Vector2, Vector6};
use geometry::{Camera, CameraCorrection, CorrectedPixels, Pinhole};
use std::sync::Arc;
use vision::vanishing::SegmentPlane;
use vision::{Descriptor, Features, GridBounds, Keypoint, KeypointGrid};

/// Distance of the places at which a segment is undistorted, pixels: lens models bend little between them.
const UNDISTORTION_STEP_PX: f64 = 16.0;
/// The same at most, for segments across the whole image.
const MAX_UNDISTORTION_STEPS: usize = 32;

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
    pub fn correct_camera(&mut self, correction: &CameraCorrection) {
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
    /// The same keypoints without lens distortion, in pixels of the ideal pinhole camera: those of the
    /// calibration, and of its correction where that bends them.
    pub undistorted: Vec<Vector2<f64>>,
    /// One binary descriptor per keypoint.
    pub descriptors: Vec<Descriptor>,
    /// Line segments.
    pub lines: Vec<LineFeature>,
    /// The ideal camera of the calibration.
    pub nominal_pinhole: Pinhole,
    /// The ideal camera that sees the undistorted coordinates: the nominal one, corrected as far as the
    /// session knows better.
    pub pinhole: Pinhole,
    /// The resolutions the keypoints were looked for in.
    pub pyramid: PyramidGeometry,
    /// Where undistorted pixels of the image can lie.
    pub bounds: GridBounds,
    /// Index of the undistorted positions for window queries.
    pub(crate) grid: KeypointGrid,
    /// The camera's motion from the first row to the last that was taken out of the places: turn, then shift
    /// in map units, in its own frame. Zero where they are as they were detected, and for what was stored.
    pub(crate) unrolled: Vector6<f64>,
    /// How the camera differs from its calibration.
    correction: CameraCorrection,
    /// Where all lies by the calibration alone, if the correction bends that.
    nominal: Option<Arc<NominalPlaces>>,
}

/// Undistorted places by the calibration alone.
#[derive(Clone, Debug)]
struct NominalPlaces {
    points: Vec<Vector2<f64>>,
    lines: Vec<LineFeature>,
    bounds: GridBounds,
}

impl NominalPlaces {
    /// These places as far elsewhere as the corrected ones are.
    fn moved(&self, before: &FrameFeatures, after: &FrameFeatures) -> Self {
        let points = self.points.iter().zip(before.undistorted.iter().zip(&after.undistorted));
        let lines = self.lines.iter().zip(before.lines.iter().zip(&after.lines));
        Self {
            points: points.map(|(place, (before, after))| place + (after - before)).collect(),
            lines: lines
                .map(|(line, (before, after))| LineFeature {
                    start: line.start + (after.start - before.start),
                    end: line.end + (after.end - before.end),
                    ..*line
                })
                .collect(),
            bounds: self.bounds,
        }
    }
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
        let nominal_camera = camera.with_correction(CameraCorrection::default());
        let (min, max) = nominal_camera.undistorted_bounds();
        let bounds =
            GridBounds { min_x: min.x as f32, min_y: min.y as f32, max_x: max.x as f32, max_y: max.y as f32 };
        let grid = index(&keypoints, &undistorted, bounds);
        let (lines, nominal_pinhole) = (Vec::new(), camera.nominal_pinhole());
        let (pinhole, correction, nominal) = (nominal_pinhole, CameraCorrection::default(), None);
        Self {
            keypoints,
            undistorted,
            descriptors,
            lines,
            nominal_pinhole,
            pinhole,
            pyramid,
            bounds,
            grid,
            unrolled: Vector6::zeros(),
            correction,
            nominal,
        }
        .with_correction(&camera.correction())
    }

    /// The same features with these lines, undistorted by the calibration alone.
    #[must_use]
    pub fn with_lines(self, lines: Vec<LineFeature>) -> Self {
        let correction = self.correction;
        if !correction.bends() {
            return Self { lines, ..self };
        }
        Self { lines, ..self.with_correction(&CameraCorrection::default()) }.with_correction(&correction)
    }

    /// The lines undistorted by the calibration alone.
    pub fn nominal_lines(&self) -> &[LineFeature] {
        self.nominal.as_ref().map_or(&self.lines, |nominal| &nominal.lines)
    }

    /// A keypoint undistorted by the calibration alone, pixels of the nominal pinhole.
    #[inline]
    pub(crate) fn nominal_px(&self, feature_idx: usize) -> Vector2<f64> {
        self.nominal.as_ref().map_or(&self.undistorted, |nominal| &nominal.points)[feature_idx]
    }

    /// Least and greatest coordinates in the image, undistorted by the calibration alone.
    pub(crate) fn nominal_corners(&self) -> (Vector2<f64>, Vector2<f64>) {
        let GridBounds { min_x, min_y, max_x, max_y } =
            self.nominal.as_ref().map_or(self.bounds, |nominal| nominal.bounds);
        (Vector2::new(min_x, min_y).cast(), Vector2::new(max_x, max_y).cast())
    }

    /// How the camera whose rays these are differs from its calibration.
    pub fn correction(&self) -> CameraCorrection {
        self.correction
    }

    /// Whether the rays of its pixels are those of a camera corrected this way.
    pub(crate) fn has_correction(&self, correction: &CameraCorrection) -> bool {
        self.correction == *correction
    }

    /// The same features seen by a camera corrected this way. Undistorted pixels stay unless it bends them;
    /// the rays change. It does not matter which correction there was before.
    #[must_use]
    pub(crate) fn with_correction(&self, correction: &CameraCorrection) -> Self {
        let mut features = self.clone();
        features.pinhole = correction.apply(&self.nominal_pinhole);
        features.correction = *correction;
        if !correction.bends() && self.nominal.is_none() {
            return features;
        }
        let nominal = self.nominal.clone().unwrap_or_else(|| {
            Arc::new(NominalPlaces {
                points: self.undistorted.clone(),
                lines: self.lines.clone(),
                bounds: self.bounds,
            })
        });
        let pixels = CorrectedPixels::new(&self.nominal_pinhole, correction);
        features.undistorted = nominal.points.iter().map(|place| pixels.ideal(place)).collect();
        features.lines = nominal.lines.iter().map(|line| unbend(line, &pixels, correction)).collect();
        features.bounds = unbend_bounds(&nominal.bounds, &pixels);
        features.grid = index(&self.keypoints, &features.undistorted, features.bounds);
        features.nominal = correction.bends().then_some(nominal);
        features
    }

    /// The same features elsewhere: keypoints where `point` puts them, ends of lines where `end` does, which
    /// is told where the calibration alone has them as well. Where keypoints were detected stays.
    #[must_use]
    pub(crate) fn moved(
        &self,
        point: impl Fn(usize, &Vector2<f64>) -> Vector2<f64>,
        end: impl Fn(&Vector2<f64>, &Vector2<f64>) -> Vector2<f64>,
    ) -> Self {
        let mut moved = self.clone();
        moved.undistorted = self.undistorted.iter().enumerate().map(|(i, place)| point(i, place)).collect();
        let lines = self.lines.iter().zip(self.nominal_lines());
        moved.lines = lines
            .map(|(line, nominal)| LineFeature {
                start: end(&line.start, &nominal.start),
                end: end(&line.end, &nominal.end),
                ..*line
            })
            .collect();
        moved.grid = index(&moved.keypoints, &moved.undistorted, moved.bounds);
        moved.nominal = self.nominal.as_ref().map(|nominal| Arc::new(nominal.moved(self, &moved)));
        moved
    }

    /// The same features as if keypoints had been detected where they are now, as they are once they were
    /// stored. `None` if the lens shows one of them nowhere.
    pub(crate) fn settled(&self, working_camera: &Camera) -> Option<Self> {
        let nominal_camera = working_camera.with_correction(CameraCorrection::default());
        let settle = |(feature_idx, keypoint): (usize, &Keypoint)| {
            let pixel = nominal_camera.distort(&self.nominal_px(feature_idx))?;
            Some(Keypoint { x: pixel.x as f32, y: pixel.y as f32, ..*keypoint })
        };
        let keypoints = self.keypoints.iter().enumerate().map(settle).collect::<Option<Vec<_>>>()?;
        let settled = Self::from_parts(keypoints, self.descriptors.clone(), &nominal_camera, self.pyramid)?;
        let settled = Self { unrolled: self.unrolled, ..settled };
        Some(settled.with_lines(self.nominal_lines().to_vec()).with_correction(&self.correction))
    }

    /// The plane through the camera in which the line of a segment lies.
    pub(crate) fn segment_plane(&self, line_idx: usize) -> Option<SegmentPlane> {
        let segment = self.lines.get(line_idx)?;
        let [start, end] = [segment.start, segment.end].map(|pixel| self.pinhole.normalized(&pixel));
        SegmentPlane::from_normalized(&start, &end, segment.sigma_px / self.pinhole.mean_focal_px())
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

fn index(keypoints: &[Keypoint], undistorted: &[Vector2<f64>], bounds: GridBounds) -> KeypointGrid {
    let entries =
        keypoints.iter().zip(undistorted).map(|(keypoint, p)| (p.x as f32, p.y as f32, keypoint.octave));
    KeypointGrid::from_entries(entries, bounds)
}

fn unbend(line: &LineFeature, pixels: &CorrectedPixels, correction: &CameraCorrection) -> LineFeature {
    if !correction.bends() {
        return *line;
    }
    match straighten(&line.start, &line.end, |place| Some(pixels.ideal(place))) {
        Some((start, end, bow_px)) => {
            LineFeature { start, end, sigma_px: line.sigma_px.hypot(bow_px), ..*line }
        }
        None => *line,
    }
}

/// The box about where the border of one goes.
fn unbend_bounds(bounds: &GridBounds, pixels: &CorrectedPixels) -> GridBounds {
    const STEPS: u32 = 16;
    let GridBounds { min_x, min_y, max_x, max_y } = *bounds;
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for step in 0..=STEPS {
        let share = step as f32 / STEPS as f32;
        let (x, y) = (min_x + share * (max_x - min_x), min_y + share * (max_y - min_y));
        for (x, y) in [(x, min_y), (x, max_y), (min_x, y), (max_x, y)] {
            let place = pixels.ideal(&Vector2::new(f64::from(x), f64::from(y)));
            (low, high) = (low.inf(&place), high.sup(&place));
        }
    }
    GridBounds { min_x: low.x as f32, min_y: low.y as f32, max_x: high.x as f32, max_y: high.y as f32 }
}

/// The straight line through the undistorted places along a segment, cut where its ends are, and the root
/// mean square distance of those places from it, pixels. `None` where the lens model has no inverse.
pub(crate) fn straighten(
    start: &Vector2<f64>,
    end: &Vector2<f64>,
    undistort: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
) -> Option<(Vector2<f64>, Vector2<f64>, f64)> {
    let n_steps =
        (((end - start).norm() / UNDISTORTION_STEP_PX).ceil() as usize).clamp(2, MAX_UNDISTORTION_STEPS);
    let places = (0..=n_steps)
        .map(|step| undistort(&(start + (end - start) * (step as f64 / n_steps as f64))))
        .collect::<Option<Vec<Vector2<f64>>>>()?;
    let n = places.len() as f64;
    let center = places.iter().sum::<Vector2<f64>>() / n;
    let scatter: Matrix2<f64> =
        places.iter().map(|place| (place - center) * (place - center).transpose()).sum::<Matrix2<f64>>() / n;
    let eigen = SymmetricEigen::new(scatter);
    let along = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let on_line = |end: Vector2<f64>| center + along * along.dot(&(end - center));
    let (first, last) = (places[0], places[n_steps]);
    Some((on_line(first), on_line(last), eigen.eigenvalues.min().max(0.0).sqrt()))
}
