//! A camera that is not quite as it was given.

use geometry::{Camera, CameraParameters, PinholeCorrection, Pose};
use slam::map::{FrameRecord, MapUpdate};
use slam::{Frame, MapEvent, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::sync::Arc;
use synthetic::{Preset, Sequence};
use vision::GrayImage;

/// Every third frame around the room.
const STEP: usize = 3;

struct Walk {
    sequence: Sequence,
    pipeline: Pipeline,
    events: Vec<MapEvent>,
    frames: BTreeMap<u64, FrameRecord>,
    is_told_by_update: bool,
}

/// Walks around a room with a camera whose focal length is given too long by this share of it.
fn walk(focal_error: f64, refine_calibration: bool) -> Walk {
    let sequence = Sequence::preset(Preset::RoomRich, 2);
    let true_to = sequence.camera().parameters().clone();
    let (fx, fy) = (true_to.fx * (1.0 + focal_error), true_to.fy * (1.0 + focal_error));
    let given = Camera::new(CameraParameters { fx, fy, ..true_to }).unwrap();
    let mut config = SlamConfig { threading: Threading::Inline, seed: 2, ..SlamConfig::default() };
    config.features.refine_calibration = refine_calibration;
    // What is looked for is the calibration's doing: the other way to get a bent map straight is left out.
    config.features.loop_closing = false;
    let pipeline = Pipeline::resume(config, given, Arc::new(NoClock), ResumeState::default()).unwrap();
    let (events, frames) = (Vec::new(), BTreeMap::new());
    let mut walk = Walk { sequence, pipeline, events, frames, is_told_by_update: false };
    for index in (0..walk.sequence.len()).step_by(STEP) {
        walk.show(index);
    }
    let updates = walk.pipeline.finish();
    walk.store(updates);
    walk
}

impl Walk {
    fn show(&mut self, index: usize) {
        let rendered = self.sequence.frame(index).image;
        let (width, height) = (rendered.width(), rendered.height());
        let image = GrayImage::from_raw(width, height, rendered.into_pixels()).unwrap();
        let (sequence, timestamp_ns) = (index as u64, index as i64 * 33_333_333);
        let report = self.pipeline.process_frame(Frame { sequence, timestamp_ns, image }).unwrap();
        self.events.extend(report.map_events);
        let updates = self.pipeline.take_updates();
        self.store(updates);
    }

    fn store(&mut self, updates: Vec<MapUpdate>) {
        for update in updates {
            update.map.check().unwrap();
            self.is_told_by_update |= update.changes.correction;
            self.frames.extend(update.frames.iter().map(|frame| (frame.sequence, *frame)));
        }
    }

    /// Root mean square error after alignment as a share of the path.
    fn error(&self) -> f64 {
        let map = self.pipeline.map();
        let poses: Vec<(u64, Pose)> = self
            .frames
            .values()
            .filter_map(|frame| Some((frame.sequence, map.locate(&frame.pose?)?.1)))
            .collect();
        let estimate: Vec<_> = poses.iter().map(|(_, pose)| pose.centre()).collect();
        let truth: Vec<_> = poses
            .iter()
            .map(|(index, _)| self.sequence.camera_from_world(*index as usize).centre())
            .collect();
        let aligned = geometry::Similarity::from_correspondences(&estimate, &truth, true).unwrap();
        let squared: f64 =
            estimate.iter().zip(&truth).map(|(e, t)| (aligned.transform(e) - t).norm_squared()).sum();
        let path: f64 = truth.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        (squared / poses.len() as f64).sqrt() / path
    }
}

#[test]
fn a_focal_length_that_is_a_little_wrong_is_put_right() {
    let (as_given, refined) = (walk(0.02, false), walk(0.02, true));
    assert_eq!(as_given.pipeline.map().correction(), PinholeCorrection::default());
    assert!(refined.events.iter().any(|event| matches!(event, MapEvent::CalibrationRefined { .. })));
    assert!(refined.is_told_by_update, "what is to be stored says so");
    let correction = refined.pipeline.map().correction();
    println!("{correction:?}, error {:.5} as given, {:.5} refined", as_given.error(), refined.error());
    assert!((correction.focal + 0.0196).abs() < 0.005, "{correction:?}");
    assert!(refined.error() < 0.75 * as_given.error());
    assert!(refined.error() < 0.0013);
    let map = refined.pipeline.map();
    assert!(map.keyframes().all(|keyframe| {
        keyframe.features.pinhole == correction.apply(&keyframe.features.nominal_pinhole)
    }));

    // Taken up again, the session has the camera it had.
    let config = SlamConfig { threading: Threading::Inline, ..SlamConfig::default() };
    let given = Camera::new(CameraParameters {
        fx: map.keyframes().next().unwrap().features.nominal_pinhole.fx,
        fy: map.keyframes().next().unwrap().features.nominal_pinhole.fy,
        ..refined.sequence.camera().parameters().clone()
    });
    let state = ResumeState { map: map.to_parts(), last_frame: None };
    let again = Pipeline::resume(config, given.unwrap(), Arc::new(NoClock), state).unwrap();
    assert_eq!(again.map().correction(), correction);
}

#[test]
fn a_camera_that_is_as_given_stays_so() {
    let walk = walk(0.0, true);
    assert_eq!(walk.pipeline.map().correction(), PinholeCorrection::default());
    assert!(walk.events.is_empty(), "{:?}", walk.events);
}

#[test]
fn a_calibration_that_cannot_be_true_is_told_and_left_alone() {
    let walk = walk(0.12, true);
    assert_eq!(walk.pipeline.map().correction(), PinholeCorrection::default());
    let told = |event: &MapEvent| matches!(event, MapEvent::CalibrationContradicted { correction } if correction.focal < -0.05);
    assert_eq!(walk.events.iter().filter(|event| told(event)).count(), 1, "{:?}", walk.events);
}
