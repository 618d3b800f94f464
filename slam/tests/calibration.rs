//! A camera that is not quite as it was given.

use geometry::{Camera, CameraParameters, CameraCorrection};
use slam::{MapEvent, ResumeState};
use synthetic::{Preset, Sequence};
use testkit::{Session, evaluate, inline};

/// Every third frame around the room.
const STEP: usize = 3;

struct Walk {
    sequence: Sequence,
    session: Session,
}

/// Walks around a room with a camera whose focal length is given too long by this share of it.
fn walk(focal_error: f64, refine_calibration: bool) -> Walk {
    let sequence = Sequence::preset(Preset::RoomRich, 2);
    let true_to = sequence.camera().parameters().clone();
    let (fx, fy) = (true_to.fx * (1.0 + focal_error), true_to.fy * (1.0 + focal_error));
    let given = Camera::new(CameraParameters { fx, fy, ..true_to }).unwrap();
    let mut config = inline(2);
    config.features.refine_calibration = refine_calibration;
    // What is looked for is the calibration's doing: the other way to get a bent map straight is left out.
    config.features.loop_closing = false;
    let mut session = Session::new(config, &given);
    session.show_frames(&sequence, (0..sequence.len()).step_by(STEP));
    session.finish();
    Walk { sequence, session }
}

impl Walk {
    /// Root mean square error after alignment as a share of the path.
    fn error(&self) -> f64 {
        let truth = |number: u64| self.sequence.camera_from_world(number as usize).inverse();
        let evaluation = evaluate(&self.session.trajectory(), truth).unwrap();
        evaluation.ate_rmse / evaluation.path
    }
}

#[test]
fn a_focal_length_that_is_a_little_wrong_is_put_right() {
    let (as_given, refined) = (walk(0.02, false), walk(0.02, true));
    assert_eq!(as_given.session.pipeline.map().correction(), CameraCorrection::default());
    assert!(refined.session.events.iter().any(|event| matches!(event, MapEvent::CalibrationRefined { .. })));
    assert!(refined.session.is_correction_stored, "what is to be stored says so");
    let correction = refined.session.pipeline.map().correction();
    println!("{correction:?}, error {:.5} as given, {:.5} refined", as_given.error(), refined.error());
    assert!((correction.focal + 0.0196).abs() < 0.005, "{correction:?}");
    assert!(refined.error() < 0.75 * as_given.error());
    assert!(refined.error() < 0.0013);
    let map = refined.session.pipeline.map();
    assert!(map.keyframes().all(|keyframe| {
        keyframe.features.pinhole == correction.apply(&keyframe.features.nominal_pinhole)
    }));

    // Taken up again, the session has the camera it had.
    let given = Camera::new(CameraParameters {
        fx: map.keyframes().next().unwrap().features.nominal_pinhole.fx,
        fy: map.keyframes().next().unwrap().features.nominal_pinhole.fy,
        ..refined.sequence.camera().parameters().clone()
    });
    let state = ResumeState { map: map.to_parts(), last_frame: None };
    let again = Session::resume(inline(0), &given.unwrap(), state);
    assert_eq!(again.pipeline.map().correction(), correction);
}

#[test]
fn a_camera_that_is_as_given_stays_so() {
    let walk = walk(0.0, true);
    assert_eq!(walk.session.pipeline.map().correction(), CameraCorrection::default());
    assert!(walk.session.events.is_empty(), "{:?}", walk.session.events);
}

#[test]
fn a_calibration_that_cannot_be_true_is_told_and_left_alone() {
    let walk = walk(0.12, true);
    assert_eq!(walk.session.pipeline.map().correction(), CameraCorrection::default());
    let told = |event: &MapEvent| matches!(event, MapEvent::CalibrationContradicted { correction } if correction.focal < -0.05);
    assert_eq!(
        walk.session.events.iter().filter(|event| told(event)).count(),
        1,
        "{:?}",
        walk.session.events
    );
}
