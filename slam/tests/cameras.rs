//! Two cameras that extend one map at the same time.

use geometry::{Camera, CameraModel, CameraParameters};
use slam::map::{CameraId, FrameRecord, MapCamera, MapUpdate};
use slam::{Frame, FrameReport, JoinState, Map, MapEvent, NoClock, Pipeline, SharedMap, SlamConfig};
use std::collections::BTreeMap;
use std::sync::Arc;
use synthetic::{Preset, Sequence, SequenceConfig};
use testkit::{evaluate, gray_image, inline};

const INTERVAL_NS: i64 = 100_000_000;
const OWN: MapCamera = MapCamera { id: CameraId(0), is_refined: true };
const ANOTHER_LENS: MapCamera = MapCamera { id: CameraId(1), is_refined: false };
/// Numbers of the second camera's frames stand so far behind those of the first where both are compared with
/// the truth at once.
const OFFSET: u64 = 100_000;

/// One camera on its way through the room.
struct Walker {
    sequence: Sequence,
    pipeline: Pipeline,
    next: u64,
    views: Vec<usize>,
    /// Its clock's first time: clocks have nothing to do with each other.
    start_ns: i64,
}

impl Walker {
    fn new(map: &SharedMap, camera: MapCamera, config: &SlamConfig, sequence: Sequence) -> Self {
        let own = (config.clone(), sequence.camera().clone());
        let pipeline = Pipeline::join(map, camera, own, Arc::new(NoClock), JoinState::default()).unwrap();
        let start_ns = 1_000_000_000_000 * i64::from(camera.id.0);
        Self { sequence, pipeline, next: 0, views: Vec::new(), start_ns }
    }

    fn show(&mut self, view: usize) -> FrameReport {
        let image = gray_image(self.sequence.frame(view).image);
        let (sequence, timestamp_ns) = (self.next, self.start_ns + self.next as i64 * INTERVAL_NS);
        self.next += 1;
        self.views.push(view);
        self.pipeline.process_frame(Frame { sequence, timestamp_ns, image }).unwrap()
    }
}

/// What a store would keep: the trajectories of all cameras of a map.
#[derive(Default)]
struct Stored(BTreeMap<(CameraId, u64), FrameRecord>);

impl Stored {
    fn take(&mut self, updates: Vec<MapUpdate>) {
        for update in updates {
            update.map.check().unwrap_or_else(|wrong| panic!("{wrong}"));
            let frames = update.frames.into_iter();
            self.0.extend(frames.map(|frame| ((frame.camera, frame.sequence), frame)));
        }
    }

    fn n_placed(&self, camera: MapCamera, map: &Map) -> usize {
        let of_camera = self.0.iter().filter(|((id, _), _)| *id == camera.id);
        of_camera.filter(|(_, record)| record.pose.and_then(|pose| map.locate(&pose)).is_some()).count()
    }

    /// Root mean square error of both trajectories, aligned to the truth by one similarity, as a share of the
    /// path.
    fn error(&self, map: &Map, walkers: [&Walker; 2]) -> f64 {
        let placed = self.0.iter().filter_map(|((camera, number), record)| {
            let (_, camera_from_world) = map.locate(&record.pose?)?;
            Some((u64::from(camera.0) * OFFSET + number, camera_from_world.inverse()))
        });
        let truth = |key: u64| {
            let walker = walkers[(key / OFFSET) as usize];
            walker.sequence.camera_from_world(walker.views[(key % OFFSET) as usize]).inverse()
        };
        let evaluation = evaluate(&placed.collect(), truth).unwrap();
        evaluation.ate_rmse / evaluation.path
    }
}

fn room(seed: u64) -> Sequence {
    Sequence::preset(Preset::RoomRich, seed)
}

/// The same room through a wider lens that bends straight lines.
fn room_of_another_lens(seed: u64) -> Sequence {
    let config = SequenceConfig::preset(Preset::RoomRich, seed);
    let camera = CameraParameters {
        model: CameraModel::Radtan,
        fx: 400.0,
        fy: 402.0,
        cx: 311.0,
        cy: 244.0,
        distortion: vec![-0.12, 0.02, 0.0004, -0.0003],
        ..config.camera.clone()
    };
    Sequence::new(SequenceConfig { camera, seed: seed + 100, ..config }).unwrap()
}

fn shared_map(config: &SlamConfig, camera: &Camera) -> SharedMap {
    SharedMap::resume(config.clone(), camera, slam::map::MapParts::default()).unwrap()
}

struct Walk {
    first: Walker,
    second: Walker,
    stored: Stored,
    map: Arc<Map>,
    events: [Vec<MapEvent>; 2],
}

/// One goes around the room, the other comes the opposite way, a view of each in turn.
fn walk_towards_each_other(camera: MapCamera, second: Sequence, n: usize) -> Walk {
    let config = inline(5);
    let shared = shared_map(&config, room(3).camera());
    let mut first = Walker::new(&shared, OWN, &config, room(3));
    let mut second = Walker::new(&shared, camera, &config, second);
    let (mut stored, mut events) = (Stored::default(), [Vec::new(), Vec::new()]);
    for i in 0..n {
        events[0].extend(first.show(2 * i).map_events);
        stored.take(first.pipeline.take_updates());
        events[1].extend(second.show(2 * (n - 1 - i)).map_events);
        // Whoever takes updates takes those of both.
        stored.take(first.pipeline.take_updates());
        assert!(second.pipeline.take_updates().is_empty());
    }
    stored.take(second.pipeline.finish());
    stored.take(first.pipeline.finish());
    let map = shared.map();
    map.check().unwrap();
    Walk { first, second, stored, map, events }
}

fn assert_is_one_good_map(walk: &Walk, camera: MapCamera, n: usize) {
    let Walk { first, second, stored, map, events } = walk;
    assert_eq!(map.submaps().len(), 1, "one frame of reference");
    for camera in [OWN, camera] {
        let n_placed = stored.n_placed(camera, map);
        assert!(n_placed * 100 >= n * 95, "camera {}: {n_placed} of {n} frames have a pose", camera.id);
        let keyframes = map.keyframes().filter(|keyframe| keyframe.camera == camera);
        assert!(keyframes.count() >= 4, "camera {} extends the map", camera.id);
    }
    let is_shared = |point: &&slam::map::PointLandmark| {
        let of = |id| map.keyframe(id).unwrap().camera.id;
        let mut cameras = point.observations.iter().map(|seen| of(seen.keyframe));
        let one = cameras.next();
        cameras.any(|other| Some(other) != one)
    };
    let n_shared = map.points().filter(is_shared).count();
    assert!(n_shared >= 100, "{n_shared} of {} points are seen by both", map.n_points());
    let is_merger = |event: &MapEvent| matches!(event, MapEvent::SubmapsMerged { .. });
    let n_mergers = events.each_ref().map(|events| events.iter().filter(|event| is_merger(event)).count());
    assert_eq!(n_mergers[0], n_mergers[1], "both are told what happens to the map");
    let error = stored.error(map, [first, second]);
    println!("error {:.3} % of the path, {n_shared} points of both, mergers {n_mergers:?}", 100.0 * error);
    assert!(error < 0.01, "error {:.2} % of the path", 100.0 * error);
}

#[test]
fn two_cameras_that_meet_make_one_map() {
    let second = MapCamera { id: CameraId(1), is_refined: true };
    let walk = walk_towards_each_other(second, room(3), 50);
    assert_is_one_good_map(&walk, second, 50);
}

#[test]
fn cameras_of_different_lenses_make_one_map() {
    let walk = walk_towards_each_other(ANOTHER_LENS, room_of_another_lens(3), 50);
    assert_is_one_good_map(&walk, ANOTHER_LENS, 50);
    let [own, other] = [OWN, ANOTHER_LENS].map(|camera| {
        let mut keyframes = walk.map.keyframes().filter(|keyframe| keyframe.camera == camera);
        keyframes.next().unwrap().features.pinhole
    });
    assert!(own.fx > 450.0 && (other.fx - 400.0).abs() < 1e-9, "each has its own rays");
}

#[test]
fn the_same_frames_in_the_same_order_give_the_same_map() {
    let run = || {
        let Walk { stored, map, .. } = walk_towards_each_other(ANOTHER_LENS, room_of_another_lens(3), 30);
        let points: Vec<[u64; 3]> =
            map.points().map(|point| [0, 1, 2].map(|axis| point.position[axis].to_bits())).collect();
        (stored.0, points)
    };
    let (one, other) = (run(), run());
    assert!(!one.1.is_empty());
    assert_eq!(one, other);
}

#[test]
fn a_camera_is_located_in_a_map_that_another_grows_and_leaves_its_submaps_alone() {
    let config = inline(5);
    let shared = shared_map(&config, room(3).camera());
    let mut first = Walker::new(&shared, OWN, &config, room(3));
    let mut stored = Stored::default();
    for i in 0..40 {
        first.show(2 * i);
        stored.take(first.pipeline.take_updates());
    }
    let n_keyframes = shared.map().n_keyframes();
    let mut second = Walker::new(&shared, ANOTHER_LENS, &config, room_of_another_lens(3));
    let placed = (0..10).filter(|i| second.show(20 + 2 * i).world_from_camera.is_some()).count();
    assert!(placed >= 9, "{placed} of 10 frames are located at once");
    // It is lost for long, and what it begins and gives up is its own.
    let dark = vision::GrayImage::from_fn(640, 480, |_, _| 9);
    for i in 0..40 {
        let (sequence, timestamp_ns) =
            (second.next + i, second.start_ns + (second.next + i) as i64 * INTERVAL_NS);
        let report =
            second.pipeline.process_frame(Frame { sequence, timestamp_ns, image: dark.clone() }).unwrap();
        assert!(report.world_from_camera.is_none());
        let report = first.show(80 + 2 * (i as usize % 20));
        assert!(report.world_from_camera.is_some(), "the other goes on");
    }
    drop(second);
    stored.take(first.pipeline.finish());
    let map = shared.map();
    assert_eq!(map.submaps().len(), 1);
    assert!(map.n_keyframes() > n_keyframes);
    assert_eq!(stored.0.iter().filter(|((camera, _), _)| camera.0 == 0).count(), 80);
}

#[test]
fn both_cameras_go_on_in_a_map_that_was_stored() {
    let config = inline(5);
    let Walk { first, second, map, .. } = walk_towards_each_other(ANOTHER_LENS, room_of_another_lens(3), 40);
    let again = SharedMap::resume(config.clone(), first.sequence.camera(), map.to_parts()).unwrap();
    assert_eq!(again.map().keyframes().filter(|keyframe| keyframe.camera == ANOTHER_LENS).count(), {
        map.keyframes().filter(|keyframe| keyframe.camera == ANOTHER_LENS).count()
    });
    for (camera, walker) in [(ANOTHER_LENS, second), (OWN, first)] {
        let mut goes_on = Walker::new(&again, camera, &config, walker.sequence);
        (goes_on.next, goes_on.start_ns) = (walker.next, walker.start_ns);
        let last = *walker.views.last().unwrap();
        let reports: Vec<FrameReport> =
            (0..8).map(|i| goes_on.show(last.saturating_sub(2) + i / 4)).collect();
        let n_placed = reports.iter().filter(|report| report.world_from_camera.is_some()).count();
        assert!(n_placed >= 7, "camera {}: {n_placed} of 8", camera.id);
        assert!(goes_on.pipeline.map().submaps().len() == 1);
    }
}
