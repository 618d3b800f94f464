//! Maps made by hand: whatever is done to them, both sides of every observation agree.

use super::*;
use crate::features::FrameFeatures;
use crate::test_fixtures::{camera, pyramid};
use geometry::nalgebra::{Matrix3, Vector3, Vector6};
use geometry::{Direction, Pose};
use vision::{Descriptor, Keypoint};

const N_KEYPOINTS: usize = 8;

fn features() -> Arc<FrameFeatures> {
    let keypoint =
        |idx: usize| Keypoint { x: 50.0 * idx as f32, y: 100.0, octave: 1, angle: 0.0, response: 30.0 };
    let descriptor = |idx: usize| Descriptor([idx as u64, !(idx as u64), 7, 0]);
    let keypoints = (0..N_KEYPOINTS).map(keypoint).collect();
    let descriptors = (0..N_KEYPOINTS).map(descriptor).collect();
    Arc::new(FrameFeatures::from_parts(keypoints, descriptors, &camera(), pyramid()).unwrap())
}

fn keyframe_id(number: u64) -> KeyframeId {
    KeyframeId::new(number).unwrap()
}

fn keyframe(number: u64, parent: Option<u64>) -> Keyframe {
    let pose = Pose::exp(&Vector6::new(0.0, 0.0, 0.0, -0.1 * number as f64, 0.0, 0.0));
    let timestamp_ns = number as i64 * 1000;
    let parent = parent.map(keyframe_id);
    Keyframe::from_parts(keyframe_id(number), SubmapId(0), number, timestamp_ns, pose, features(), parent)
}

fn seen(keyframe: u64, feature_idx: u32) -> Observation {
    Observation { keyframe: keyframe_id(keyframe), feature_idx }
}

/// Three keyframes in a row; four points seen by all, one by the first two only.
fn small_map() -> (Map, Vec<PointId>) {
    let mut map = Map::default();
    map.add_keyframe(keyframe(1, None));
    map.add_keyframe(keyframe(2, Some(1)));
    map.add_keyframe(keyframe(3, Some(2)));
    let mut points: Vec<PointId> = (0..4)
        .map(|idx| {
            let position = Vector3::new(0.2 * f64::from(idx), 0.0, 3.0);
            map.add_point(position, keyframe_id(2), &[seen(1, idx), seen(2, idx), seen(3, idx)]).unwrap()
        })
        .collect();
    points
        .push(map.add_point(Vector3::new(0.0, 0.5, 2.0), keyframe_id(2), &[seen(1, 5), seen(2, 6)]).unwrap());
    (1..=3).for_each(|number| map.refresh_covisibility(keyframe_id(number), 2));
    map.check().unwrap();
    (map, points)
}

#[test]
fn observations_are_entered_on_both_sides() {
    let (map, points) = small_map();
    assert_eq!((map.n_keyframes(), map.n_points()), (3, 5));
    assert_eq!(map.keyframe(keyframe_id(2)).unwrap().points[6], Some(points[4]));
    assert_eq!(map.point(points[4]).unwrap().observation_in(keyframe_id(2)), Some(6));
    assert_eq!(map.keyframe(keyframe_id(1)).unwrap().covisible()[0], (keyframe_id(2), 5));
}

#[test]
fn a_removed_key_frame_leaves_its_place_and_takes_points_nobody_else_sees() {
    let (mut map, points) = small_map();
    let pose_before = map.camera_from_world(keyframe_id(2)).unwrap();
    map.take_changes();
    map.remove_keyframe(keyframe_id(2), keyframe_id(1));
    map.check().unwrap();
    assert!(map.point(points[4]).is_none(), "one view does not hold a point");
    assert_eq!(map.point(points[0]).unwrap().observations.len(), 2);
    assert_eq!(map.keyframe(keyframe_id(3)).unwrap().parent, Some(keyframe_id(1)));
    assert!(map.camera_from_world(keyframe_id(2)).unwrap().local(&pose_before).norm() < 1e-12);
    let changes = map.take_changes();
    assert!(
        changes.removed_keyframes.contains(&keyframe_id(2)) && changes.removed_points.contains(&points[4])
    );
}

#[test]
fn what_hangs_on_a_removed_key_frame_moves_with_the_anchor() {
    let (mut map, _) = small_map();
    map.remove_keyframe(keyframe_id(3), keyframe_id(2));
    map.remove_keyframe(keyframe_id(2), keyframe_id(1));
    let before = map.camera_from_world(keyframe_id(3)).unwrap();
    let shift = Pose::exp(&Vector6::new(0.0, 0.0, 0.3, 1.0, 2.0, 3.0));
    let anchor = map.camera_from_world(keyframe_id(1)).unwrap();
    map.set_pose(keyframe_id(1), anchor * shift);
    let after = map.camera_from_world(keyframe_id(3)).unwrap();
    assert!(after.local(&(before * shift)).norm() < 1e-12);
}

#[test]
fn fused_points_keep_every_view_once() {
    let (mut map, points) = small_map();
    let other =
        map.add_point(Vector3::new(0.0, 0.5, 2.1), keyframe_id(3), &[seen(2, 7), seen(3, 7)]).unwrap();
    map.fuse_points(points[4], other);
    map.check().unwrap();
    assert!(map.point(other).is_none());
    let kept = &map.point(points[4]).unwrap().observations;
    assert_eq!(
        kept,
        &[seen(1, 5), seen(2, 6), seen(3, 7)],
        "keyframe 2 sees the point with one keypoint only"
    );
    assert_eq!(map.keyframe(keyframe_id(2)).unwrap().points[7], None);
}

#[test]
fn an_observation_taken_back_frees_the_keypoint() {
    let (mut map, points) = small_map();
    map.remove_observation(points[0], keyframe_id(3));
    map.check().unwrap();
    assert_eq!(map.keyframe(keyframe_id(3)).unwrap().points[0], None);
    map.remove_observation(points[0], keyframe_id(2));
    map.check().unwrap();
    assert!(map.point(points[0]).is_none());
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let (mut map, points) = small_map();
    let (position, pose) =
        (map.point(points[0]).unwrap().position, map.camera_from_world(keyframe_id(1)).unwrap());
    map.set_position(points[0], Vector3::new(f64::NAN, 0.0, 1.0));
    map.set_pose(keyframe_id(1), Pose::new(pose.rotation, Vector3::new(0.0, f64::INFINITY, 0.0)));
    assert!(map.add_point(Vector3::repeat(f64::NAN), keyframe_id(1), &[seen(1, 7), seen(2, 7)]).is_none());
    assert_eq!(map.point(points[0]).unwrap().position, position);
    assert_eq!(map.camera_from_world(keyframe_id(1)), Some(pose));
}

#[test]
fn a_discarded_submap_leaves_nothing() {
    let (mut map, _) = small_map();
    map.remove_keyframe(keyframe_id(3), keyframe_id(2));
    map.take_changes();
    map.remove_submap(SubmapId(0));
    assert_eq!((map.n_keyframes(), map.n_points(), map.removed_keyframes().count()), (0, 0, 0));
    let changes = map.take_changes();
    assert!([1, 2, 3].iter().all(|number| changes.removed_keyframes.contains(&keyframe_id(*number))));
    let last = map.last_ids();
    assert_eq!((last.keyframe, last.point), (3, 5), "ids are never used again");
}

#[test]
fn a_map_survives_being_taken_apart() {
    let (mut map, _) = small_map();
    map.remove_keyframe(keyframe_id(2), keyframe_id(1));
    let again = Map::from_parts(map.to_parts()).unwrap();
    assert!(again.points().eq(map.points()));
    assert_eq!(again.camera_from_world(keyframe_id(2)), map.camera_from_world(keyframe_id(2)));
    assert_eq!(again.last_ids(), map.last_ids());
}

#[test]
fn later_changes_win_when_updates_are_joined() {
    let mut first = MapChanges {
        points: [PointId::new(1).unwrap(), PointId::new(2).unwrap()].into(),
        ..Default::default()
    };
    let later = MapChanges { removed_points: [PointId::new(1).unwrap()].into(), ..Default::default() };
    first.merge(later);
    assert_eq!(first.points, [PointId::new(2).unwrap()].into());
    assert_eq!(first.removed_points, [PointId::new(1).unwrap()].into());
}

#[test]
fn a_primitive_reaches_beyond_sight_once_a_key_frame_that_shares_no_landmark_shows_it() {
    let (mut map, _) = small_map();
    map.add_keyframe(keyframe(4, Some(3)));
    let up = Vector3::y();
    let vanishing = VanishingObservation {
        direction: up,
        covariance: Matrix3::identity(),
        segments: Vec::new(),
        primitive: None,
    };
    (1..=4).for_each(|number| map.set_vanishing(keyframe_id(number), vec![vanishing.clone()]));
    let direction = Direction::new(up).unwrap();
    let primitive = map.add_primitive(SubmapId(0), direction, Matrix3::identity(), keyframe_id(1)).unwrap();
    let mut reaches_with = |number| {
        let seen = PrimitiveObservation { keyframe: keyframe_id(number), vanishing_idx: 0 };
        assert!(map.add_primitive_observation(primitive, seen));
        map.primitives_tie_beyond_sight(SubmapId(0))
    };
    assert_eq!([1, 2, 3, 4].map(&mut reaches_with), [false, false, false, true]);
    assert!(!map.primitives_tie_beyond_sight(SubmapId(1)));
}

#[test]
fn what_one_camera_made_does_not_grow_old_by_the_keyframes_of_another() {
    let of_second = |number: u64, parent: Option<u64>| {
        let camera = MapCamera { id: CameraId(1), ..MapCamera::default() };
        Keyframe { camera, submap: SubmapId(1), ..keyframe(number, parent) }
    };
    let mut map = Map::default();
    map.add_keyframe(keyframe(1, None));
    map.add_keyframe(keyframe(2, Some(1)));
    (3..6).for_each(|number| map.add_keyframe(of_second(number, (number > 3).then(|| number - 1))));
    map.remove_keyframe(keyframe_id(4), keyframe_id(3));
    let age = |map: &Map, id, newest| map.age(keyframe_id(id), keyframe_id(newest), 10);
    // 6 was given out and is not here yet.
    assert_eq!(age(&map, 2, 6), 0, "removed ones of the other camera do not count");
    assert_eq!(age(&map, 3, 5), 2, "a removed one of its own does");
    let mut alone = Map::default();
    (1..4).for_each(|number| alone.add_keyframe(keyframe(number, (number > 1).then(|| number - 1))));
    alone.remove_keyframe(keyframe_id(2), keyframe_id(1));
    assert_eq!((age(&alone, 1, 3), age(&alone, 1, 5)), (2, 4), "a camera alone counts every number");
    assert_eq!(alone.age(keyframe_id(1), keyframe_id(5), 2), 3, "counting ends beyond the limit");
}
