//! Segments of an image, followed from the image before, without lens distortion.

use crate::config::{ConfigError, LineConfig, SlamConfig};
use crate::features::{LineFeature, straighten};
use geometry::nalgebra::{UnitQuaternion, Vector2};
use geometry::{Camera, CameraCorrection};
use std::sync::Arc;
use vision::GrayImage;
use vision::lines::{
    LineOrigin, LineTracker, LineTrackerConfig, LineTrackingStatistics, Segment, SegmentDetector,
    TrackedLine, detector,
};
use vision::mask::Clearance;

/// Flow moves a segment less precisely than a detector finds it. [method: Line tracking by optical flow]
const FLOW_SIGMA_FACTOR: f64 = 1.5;

/// Detects segments, follows them and takes the lens distortion of the calibration out.
pub(super) struct LineFrontEnd {
    /// As it was given.
    nominal: Camera,
    /// As it is known now: how what is seen moves when the camera turns.
    camera: Camera,
    config: LineConfig,
    detector: Box<dyn SegmentDetector>,
    tracker: LineTracker,
    first_track: u64,
    /// How far pixels are from what is not the scene, if anything is not.
    clearance: Option<Arc<Clearance>>,
}

impl LineFrontEnd {
    pub fn new(config: &SlamConfig, camera: &Camera, first_track: u64) -> Result<Self, ConfigError> {
        let refuse = |reason: String| ConfigError { field: "lines", reason };
        let detector = detector(config.lines.detector).map_err(|error| refuse(error.to_string()))?;
        let tracker =
            LineTracker::new(LineTrackerConfig::default()).map_err(|error| refuse(error.to_string()))?;
        let nominal = camera.with_correction(CameraCorrection::default());
        Ok(Self {
            nominal,
            camera: camera.clone(),
            config: config.lines.clone(),
            detector,
            tracker,
            first_track,
            clearance: None,
        })
    }

    pub fn set_camera(&mut self, camera: &Camera) {
        self.camera = camera.clone();
    }

    /// Leaves out segments along or inside of what is not the scene, and the parts of others that are.
    pub fn set_clearance(&mut self, clearance: Option<Arc<Clearance>>) {
        self.clearance = clearance;
    }

    pub fn extract(
        &mut self,
        image: &GrayImage,
        now_from_last: Option<UnitQuaternion<f64>>,
    ) -> (Vec<LineFeature>, LineTrackingStatistics) {
        let mut detected = self.detector.detect(image);
        let size = (image.width(), image.height());
        let clearance = self.clearance.as_deref().filter(|clearance| clearance.size() == size);
        if let Some(clearance) = clearance {
            detected = detected.iter().filter_map(|segment| clearance.visible_part(segment)).collect();
        }
        let camera = &self.camera;
        let turned = now_from_last.map(|rotation| move |pixel| turn(camera, &rotation, &pixel));
        let prior = turned.as_ref().map(|turned| turned as &dyn Fn(Vector2<f32>) -> Vector2<f32>);
        let tracked = self.tracker.track(image, detected, prior);
        let lines = tracked.lines.iter().filter_map(|line| self.feature(line, clearance)).collect();
        (lines, tracked.statistics)
    }

    fn feature(&self, line: &TrackedLine, clearance: Option<&Clearance>) -> Option<LineFeature> {
        // Flow may lead a segment on to what is left out.
        let visible = match clearance {
            Some(clearance) => clearance.visible_part(&line.segment)?,
            None => line.segment,
        };
        let (start, end, bow_px) = undistort(&visible, &self.nominal)?;
        let factor = if line.origin == LineOrigin::Flowed { FLOW_SIGMA_FACTOR } else { 1.0 };
        let sigma_px = f64::from(line.segment.sigma_px).hypot(bow_px).max(self.config.min_sigma_px) * factor;
        let track = self.first_track + line.track;
        Some(LineFeature { start, end, sigma_px, descriptor: line.descriptor, track })
    }
}

/// Where a pixel of the last image appears after a rotation, if it lies far away; itself where that is
/// outside what the lens can show.
fn turn(camera: &Camera, now_from_last: &UnitQuaternion<f64>, pixel: &Vector2<f32>) -> Vector2<f32> {
    let bearing = camera.unproject(&pixel.cast());
    let moved = bearing.and_then(|bearing| camera.project(&(now_from_last * bearing)));
    moved.map_or(*pixel, |moved| moved.cast())
}

/// A segment without lens distortion, and how far it is from straight, pixels. `None` where the lens model
/// has no inverse.
fn undistort(segment: &Segment, camera: &Camera) -> Option<(Vector2<f64>, Vector2<f64>, f64)> {
    if !camera.is_distorted() {
        return Some((camera.undistort(&segment.start.cast())?, camera.undistort(&segment.end.cast())?, 0.0));
    }
    straighten(&segment.start.cast(), &segment.end.cast(), |place| camera.undistort(place))
}
