//! Loops on maps made by hand: a ring of cameras that look outwards at a wall, walked a little more than
//! once, in a map that drifted on the way.

use super::*;
use crate::bundle::global;
use crate::config::MappingConfig;
use crate::features::FrameFeatures;
use crate::landmarks::{Anchoring, apply_corrections};
use crate::map::{FramePose, Keyframe, Observation};
use crate::test_fixtures::{camera, pyramid};
use geometry::Pose;
use geometry::nalgebra::{SVector, UnitQuaternion, Vector2, Vector3};
use rand::Rng;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use vision::{Descriptor, Keypoint};

/// Cameras on a full turn.
const N_RING: usize = 40;
/// Where the second lap of the ring begins, as the map sees it.
const FIRST_OF_SECOND_LAP: usize = 36;
/// Keypoints are found at this level, so that their points can be seen from a little nearer and farther.
const OCTAVE: u8 = 2;

/// What is true, and how the map knows it.
struct Walk {
    cameras: Vec<Pose>,
    points: Vec<(Vector3<f64>, Descriptor)>,
    /// `mapped_from_true` around each camera.
    drift: Vec<Similarity>,
    /// Which submap each camera is in.
    submaps: Vec<SubmapId>,
    /// From this camera on what is seen is in the map a second time.
    second_lap: usize,
}

fn keyframe_id(index: usize) -> KeyframeId {
    KeyframeId::from_index(index)
}

/// A camera that looks along `forward`, upright.
fn looking(position: Vector3<f64>, forward: Vector3<f64>) -> Pose {
    let down = -Vector3::z();
    let right = down.cross(&forward);
    let axes = geometry::nalgebra::Matrix3::from_columns(&[right, down, forward]);
    Pose::new(UnitQuaternion::from_matrix(&axes), position).inverse()
}

impl Walk {
    /// Once round and a quarter, with a drift per camera of the given tangent.
    fn ring(drift_per_camera: SVector<f64, 7>) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let around = |angle: f64| Vector3::new(angle.cos(), angle.sin(), 0.0);
        let points = (0..1600)
            .map(|_| {
                let wall = around(rng.random_range(0.0..TAU)) * rng.random_range(6.0..7.0);
                (wall + Vector3::z() * rng.random_range(-1.5..1.5), Descriptor(rng.random()))
            })
            .collect();
        let n = N_RING * 5 / 4;
        let cameras = (0..n)
            .map(|k| around(TAU * k as f64 / N_RING as f64))
            .map(|outward| looking(outward * 2.0, outward))
            .collect();
        let drift = (0..n).map(|k| Similarity::exp(&(drift_per_camera * k as f64))).collect();
        Self { cameras, points, drift, submaps: vec![SubmapId(0); n], second_lap: FIRST_OF_SECOND_LAP }
    }

    /// Along a wall on which every stretch looks like the one before, without drift.
    fn look_alike(n: usize, cameras_per_stretch: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let length = 0.4 * cameras_per_stretch as f64;
        let stretch: Vec<(Vector3<f64>, Descriptor)> = (0..600)
            .map(|_| {
                let place = Vector3::new(
                    rng.random_range(0.0..length),
                    rng.random_range(4.0..5.0),
                    rng.random_range(-1.5..1.5),
                );
                (place, Descriptor(rng.random()))
            })
            .collect();
        let n_stretches = n / cameras_per_stretch + 3;
        let points = (0..n_stretches)
            .flat_map(|k| {
                let shift = Vector3::x() * length * (k as f64 - 1.0);
                stretch.iter().map(move |(place, descriptor)| (place + shift, *descriptor))
            })
            .collect();
        let cameras = (0..n).map(|k| looking(Vector3::new(0.4 * k as f64, 0.0, 0.0), Vector3::y())).collect();
        Self {
            cameras,
            points,
            drift: vec![Similarity::identity(); n],
            submaps: vec![SubmapId(0); n],
            second_lap: n,
        }
    }

    /// The map as it is after the walk, with a landmark per point and lap.
    fn map(&self) -> Map {
        let camera = camera();
        let mut map = Map::default();
        let mut observations: BTreeMap<(usize, bool), Vec<Observation>> = BTreeMap::new();
        for (index, camera_from_true) in self.cameras.iter().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(index as u64);
            let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
            for (point_idx, (position, descriptor)) in self.points.iter().enumerate() {
                let in_camera = camera_from_true.transform(position);
                let Some(pixel) = camera
                    .project(&in_camera)
                    .filter(|pixel| camera.contains(pixel) && in_camera.norm() < 6.0)
                else {
                    continue;
                };
                let mut seen = *descriptor;
                (0..8).for_each(|_| seen.0[rng.random_range(0..4)] ^= 1 << rng.random_range(0..64));
                let noise = Vector2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
                let (x, y) = ((pixel.x + noise.x) as f32, (pixel.y + noise.y) as f32);
                let sighting =
                    Observation { keyframe: keyframe_id(index), feature_idx: keypoints.len() as u32 };
                observations.entry((point_idx, index >= self.second_lap)).or_default().push(sighting);
                keypoints.push(Keypoint { x, y, octave: OCTAVE, angle: 0.0, response: 1.0 });
                descriptors.push(seen);
            }
            let features = FrameFeatures::from_parts(keypoints, descriptors, &camera, pyramid()).unwrap();
            let mapped = Similarity::from_pose(camera_from_true) * self.drift[index].inverse();
            let is_first = index == 0 || self.submaps[index] != self.submaps[index - 1];
            map.add_keyframe(Keyframe::from_parts(
                keyframe_id(index),
                self.submaps[index],
                index as u64,
                index as i64,
                mapped.pose_part(),
                Arc::new(features),
                (!is_first).then(|| keyframe_id(index - 1)),
            ));
        }
        for ((point_idx, _), seen) in observations {
            let made_by = seen[seen.len() / 2].keyframe;
            let position = self.drift[made_by.index()].transform(&self.points[point_idx].0);
            map.add_point(position, made_by, &seen);
        }
        for index in 0..self.cameras.len() {
            map.refresh_covisibility(keyframe_id(index), MappingConfig::default().min_covisible_points);
        }
        map.check().unwrap();
        map
    }

    /// Root mean square distance of the cameras from where they are, after the best alignment.
    fn error(&self, map: &Map) -> f64 {
        let truth: Vec<Vector3<f64>> = self.cameras.iter().map(Pose::center).collect();
        let mapped: Vec<Vector3<f64>> = (0..self.cameras.len())
            .map(|index| map.camera_from_world(keyframe_id(index)).unwrap().center())
            .collect();
        let aligned = Similarity::from_correspondences(&mapped, &truth, true).unwrap();
        let squared = mapped.iter().zip(&truth).map(|(m, t)| (aligned.transform(m) - t).norm_squared());
        (squared.sum::<f64>() / truth.len() as f64).sqrt()
    }
}

/// Scale, attitude and place drift by 12 %, 4 degrees and some tenths on the way.
fn drift() -> SVector<f64, 7> {
    SVector::from([0.0005, -0.0005, 0.0012, 0.002, -0.004, 0.002, 0.0025])
}

fn last_keyframe(walk: &Walk) -> KeyframeId {
    keyframe_id(walk.cameras.len() - 1)
}

/// A configuration with so many iterations of global bundle adjustment.
fn iterating(global_iterations: usize) -> SlamConfig {
    let mut config = SlamConfig::default();
    config.loops.global_iterations = global_iterations;
    config
}

#[test]
fn a_closed_loop_takes_the_drift_out_of_the_whole_map() {
    let walk = Walk::ring(drift());
    let mut map = walk.map();
    let (error_before, n_points_before) = (walk.error(&map), map.n_points());
    let closed =
        LoopCloser::new(&SlamConfig::default()).close(&mut map, last_keyframe(&walk)).expect("a loop");
    map.check().unwrap();
    assert!(closed.moved && matches!(closed.event, MapEvent::LoopClosed { .. }));
    let error_after = walk.error(&map);
    assert!(error_after < 0.5 * error_before, "{error_before} before, {error_after} after");
    assert!(
        map.n_points() < n_points_before - 100,
        "{n_points_before} points before, {} after",
        map.n_points()
    );
    let joined = map.keyframe(last_keyframe(&walk)).unwrap().covisible();
    assert!(
        joined.iter().any(|(id, n)| id.index() < 15 && *n > 50),
        "the ends are neighbours now: {joined:?}"
    );

    let result =
        global::adjust(&map, SubmapId(0), &iterating(20), &AtomicBool::new(false)).expect("there is a map");
    result.merge_into(&mut map);
    map.check().unwrap();
    let error_adjusted = walk.error(&map);
    assert!(error_adjusted < 0.1 * error_before, "{error_before} before, {error_adjusted} adjusted");
}

#[test]
fn key_frames_made_during_the_adjustment_are_carried_along() {
    let walk = Walk::ring(drift());
    let mut map = walk.map();
    let snapshot = {
        let mut snapshot = map.clone();
        snapshot.remove_keyframe(last_keyframe(&walk), keyframe_id(walk.cameras.len() - 2));
        snapshot
    };
    LoopCloser::new(&SlamConfig::default()).close(&mut map, last_keyframe(&walk)).expect("a loop");
    let result = global::adjust(&snapshot, SubmapId(0), &iterating(3), &AtomicBool::new(false)).unwrap();
    let relative = |map: &Map| {
        let pose = |back: usize| map.camera_from_world(keyframe_id(walk.cameras.len() - back)).unwrap();
        pose(1) * pose(2).inverse()
    };
    let before = relative(&map);
    result.merge_into(&mut map);
    map.check().unwrap();
    assert!(relative(&map).local(&before).norm() < 1e-9, "it follows the keyframe it hangs on");
    let aborted = global::adjust(&map, SubmapId(0), &iterating(3), &AtomicBool::new(true));
    assert!(aborted.is_none(), "an aborted adjustment gives nothing");
}

#[test]
fn a_place_seen_again_without_drift_only_joins_landmarks() {
    let walk = Walk::ring(SVector::zeros());
    let mut map = walk.map();
    let n_points_before = map.n_points();
    let closed =
        LoopCloser::new(&SlamConfig::default()).close(&mut map, last_keyframe(&walk)).expect("a loop");
    map.check().unwrap();
    assert!(!closed.moved && map.n_points() < n_points_before - 100);
    assert!(walk.error(&map) < 1e-6, "nothing moved");
}

#[test]
fn places_that_look_alike_are_not_the_same_place() {
    let walk = Walk::look_alike(48, 16);
    let mut map = walk.map();
    let mut closer = LoopCloser::new(&SlamConfig::default());
    for index in 0..walk.cameras.len() {
        assert!(closer.close(&mut map, keyframe_id(index)).is_none(), "a false loop at keyframe {index}");
    }
    let unmoved = |keyframe: &Keyframe| {
        keyframe.camera_from_world.local(&walk.cameras[keyframe.id.index()]).norm() < 1e-9
    };
    assert!(map.keyframes().all(unmoved));
    // Looks and geometry alone would have it otherwise.
    let mut credulous = SlamConfig::default();
    credulous.loops.max_drift_share = 2.0;
    assert!(LoopCloser::new(&credulous).close(&mut map, last_keyframe(&walk)).is_some());
}

#[test]
fn submaps_that_meet_become_one_and_what_hangs_on_them_follows() {
    let mut walk = Walk::ring(SVector::zeros());
    let apart = Similarity::exp(&SVector::from([0.4, -0.8, 1.2, 5.0, -3.0, 2.0, 0.9]));
    for index in FIRST_OF_SECOND_LAP..walk.cameras.len() {
        (walk.submaps[index], walk.drift[index]) = (SubmapId(1), apart);
    }
    let mut map = walk.map();
    assert_eq!(map.submaps().len(), 2);
    // A frame half way between two keyframes of the second submap.
    let (reference, next) = (keyframe_id(42), keyframe_id(43));
    let half_way = |map: &Map| {
        let (a, b) = (map.keyframe(reference).unwrap(), map.keyframe(next).unwrap());
        a.camera_from_world.interpolate(&b.camera_from_world, 0.5)
    };
    let place: FramePose = map.place_beside(reference, &half_way(&map)).unwrap();

    let closed =
        LoopCloser::new(&SlamConfig::default()).close(&mut map, last_keyframe(&walk)).expect("a merge");
    map.check().unwrap();
    assert!(matches!(
        closed.event,
        MapEvent::SubmapsMerged { absorbed: SubmapId(1), surviving: SubmapId(0), .. }
    ));
    assert_eq!(map.submaps(), [SubmapId(0)].into());
    assert!(map.points().all(|point| point.submap == SubmapId(0)));
    let error = walk.error(&map);
    assert!(error < 0.02, "{error}");
    let origin = map.camera_from_world(keyframe_id(0)).unwrap();
    assert!(origin.local(&walk.cameras[0]).norm() < 1e-9, "the older frame of reference survives");
    let roots: Vec<KeyframeId> =
        map.keyframes().filter(|keyframe| keyframe.parent.is_none()).map(|keyframe| keyframe.id).collect();
    assert_eq!(roots, [keyframe_id(0)], "one tree");
    let (submap, camera_from_world) = map.locate(&place).unwrap();
    let expected = half_way(&map);
    assert_eq!(submap, SubmapId(0));
    assert!(camera_from_world.local(&expected).norm() < 1e-6, "{camera_from_world:?} {expected:?}");
}

#[test]
fn lines_and_primitives_move_with_the_key_frames_that_see_them() {
    let walk = Walk::ring(SVector::zeros());
    let mut map = walk.map();
    let (direction, covariance) =
        (Vector3::new(0.6, 0.0, 0.8), geometry::nalgebra::Matrix3::identity() * 1e-4);
    let seen_by = keyframe_id(5);
    let rotation = map.keyframe(seen_by).unwrap().camera_from_world.rotation;
    let vanishing = crate::map::VanishingObservation {
        direction: rotation * direction,
        covariance,
        segments: Vec::new(),
        primitive: None,
    };
    map.set_vanishing(seen_by, vec![vanishing]);
    let axis = geometry::Direction::new(direction).unwrap();
    let primitive = map.add_primitive(SubmapId(0), axis, covariance, seen_by).unwrap();
    map.add_primitive_observation(
        primitive,
        crate::map::PrimitiveObservation { keyframe: seen_by, vanishing_idx: 0 },
    );

    let moved = Similarity::exp(&SVector::from([0.1, 0.2, -0.3, 1.0, 2.0, 3.0, 0.4]));
    let corrections = map.keyframes().map(|keyframe| (keyframe.id, moved)).collect();
    let point = map.points().next().unwrap().clone();
    apply_corrections(&mut map, &corrections, &Anchoring::default());
    map.check().unwrap();
    let turned = map.primitive(primitive).unwrap();
    assert!(turned.direction.angle(&axis.rotated(&moved.rotation)) < 1e-9);
    assert!((map.point(point.id).unwrap().position - moved.transform(&point.position)).norm() < 1e-12);
    let keyframe = map.keyframe(seen_by).unwrap();
    assert!((keyframe.local_scale - moved.scale).abs() < 1e-12);
    assert!((keyframe.camera_from_world.center() - moved.transform(&walk.cameras[5].center())).norm() < 1e-9);
}

/// Has keyframes show world directions, one primitive each.
fn show_primitive(map: &mut Map, seen_by: &[usize], direction: Vector3<f64>) {
    let covariance = geometry::nalgebra::Matrix3::identity() * 1e-4;
    let axis = geometry::Direction::new(direction).unwrap();
    let mut primitive = None;
    for id in seen_by.iter().map(|index| keyframe_id(*index)) {
        let keyframe = map.keyframe(id).unwrap();
        let direction = keyframe.camera_from_world.rotation * direction;
        let mut vanishing = keyframe.vanishing.to_vec();
        let vanishing_idx = vanishing.len() as u32;
        vanishing.push(crate::map::VanishingObservation {
            direction,
            covariance,
            segments: Vec::new(),
            primitive: None,
        });
        map.set_vanishing(id, vanishing);
        let primitive =
            *primitive.get_or_insert_with(|| map.add_primitive(SubmapId(0), axis, covariance, id).unwrap());
        let seen = crate::map::PrimitiveObservation { keyframe: id, vanishing_idx };
        map.add_primitive_observation(primitive, seen);
    }
}

#[test]
fn a_place_turned_about_its_vertical_is_another_place() {
    let about_vertical = |degrees: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
        Similarity::from_pose(&Pose::new(turn, Vector3::zeros()))
    };
    let agrees = |map: &Map, degrees: f64| {
        let current = map.keyframe(keyframe_id(40)).unwrap();
        let place = Place { keyframes: vec![keyframe_id(0)], points: Vec::new() };
        verification::directions_agree(map, current, &[], &place, &about_vertical(degrees), 3.0)
    };
    let mut map = Walk::ring(SVector::zeros()).map();
    assert!(agrees(&map, 30.0), "there is nothing to compare");
    show_primitive(&mut map, &[0, 40], Vector3::z());
    assert!(agrees(&map, 30.0), "the vertical says nothing of a turn about it");
    show_primitive(&mut map, &[0, 40], Vector3::x());
    assert!(agrees(&map, 2.0) && !agrees(&map, 30.0) && !agrees(&map, -90.0));
    // What each side sees of its own may point anywhere.
    let mut map = Walk::ring(SVector::zeros()).map();
    show_primitive(&mut map, &[0, 40], Vector3::z());
    show_primitive(&mut map, &[0], Vector3::x());
    show_primitive(&mut map, &[40], Vector3::x());
    assert!(agrees(&map, 30.0));
}
