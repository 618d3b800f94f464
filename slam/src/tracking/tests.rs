//! What the tracker takes with it from one frame to the next.

use super::*;
use crate::features::FrameFeatures;
use crate::map::{Keyframe, KeyframeId};
use crate::test_fixtures::{camera, pyramid};
use geometry::nalgebra::Vector3;

/// A frame without features beside the only keyframe of a map.
fn frame(number: u64, z: f64) -> TrackedFrame {
    let features = FrameFeatures::from_parts(Vec::new(), Vec::new(), &camera(), pyramid()).unwrap();
    let timestamp_ns = number as i64 * 100;
    let view = View { sequence: number, timestamp_ns, features: Arc::new(features) };
    let pose = Pose::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, -z));
    TrackedFrame::blank(&view, pose, KeyframeId::from_index(0), SubmapId::default())
}

fn map() -> Map {
    let TrackedFrame { features, camera_from_world, reference, submap, .. } = frame(0, 0.0);
    let mut map = Map::default();
    map.add_keyframe(Keyframe::from_parts(reference, submap, 0, 0, camera_from_world, features, None));
    map
}

/// How far the fourth frame is expected to go where the third was found in this way, so far from the
/// second, which was one unit from the first.
fn expected_step(start: PoseStart, step: f64) -> f64 {
    let map = map();
    let mut tracker = Tracker::follower(SlamConfig::default(), None);
    let mut conclude = |frame, start| {
        tracker.conclude(frame, Inliers::default(), TrackingOutcome::Tracked, start, &map);
    };
    conclude(frame(0, 0.0), PoseStart::Relocalized);
    conclude(frame(1, 1.0), PoseStart::Followed);
    conclude(frame(2, 1.0 + step), start);
    let last = tracker.last.expect("a frame that was placed");
    (last.predict(300).center() - last.frame.camera_from_world.center()).norm()
}

#[test]
fn the_way_across_a_cut_is_no_motion_that_goes_on() {
    assert!((expected_step(PoseStart::Followed, 30.0) - 30.0).abs() < 1e-9);
    assert!((expected_step(PoseStart::Recognized, 2.0) - 2.0).abs() < 1e-9);
    assert_eq!(expected_step(PoseStart::Recognized, 30.0), 0.0);
    assert_eq!(expected_step(PoseStart::Relocalized, 2.0), 0.0);
}

#[test]
fn a_frame_that_is_a_keyframe_is_passed_where_the_map_has_it() {
    let map = map();
    let mut tracker = Tracker::follower(SlamConfig::default(), None);
    tracker.start(frame(2, 1.0), &map);
    let keyframe = map.keyframes().next().expect("a keyframe");
    tracker.pass(TrackedFrame::of_keyframe(keyframe), &map);
    assert_eq!(tracker.last_frame().map(|last| last.camera_from_world), Some(Pose::identity()));
}
