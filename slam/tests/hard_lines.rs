//! Images that are hard on lines, through the whole engine: bounded time, no panic, nothing non-finite in the
//! map.

use geometry::nalgebra::Vector2;
use slam::features::LineFeature;
use slam::map::FrameState;
use slam::{Keyframe, Map};
use std::time::{Duration, Instant};
use synthetic::{PathKind, Preset, Sequence, SequenceConfig};
use testkit::{FRAME_INTERVAL_NS, Session, gray_image, inline, line_error};
use vision::GrayImage;

/// Bound on one frame, mapping included, in an unoptimized build on a busy machine; the usual is a tenth of
/// it.
const MAX_FRAME_TIME: Duration = Duration::from_secs(5);

fn assert_finite(map: &Map) {
    map.check().unwrap();
    assert!(map.keyframes().all(|keyframe| keyframe.camera_from_world.is_finite()));
    assert!(map.points().all(|point| point.position.iter().all(|value| value.is_finite())));
    for line in map.lines() {
        assert!(line.line.is_finite(), "line {}", line.id);
        assert!(line.endpoints.iter().flatten().all(|value| value.is_finite()), "line {}", line.id);
    }
    assert!(map.primitives().all(|primitive| primitive.direction.as_vector().norm().is_finite()));
}

/// Feeds images from number `first` on and returns the state of the last; every map on the way is looked at.
fn feed(session: &mut Session, first: u64, images: impl Iterator<Item = GrayImage>) -> Option<FrameState> {
    let mut state = None;
    for (sequence, image) in (first..).zip(images) {
        let begun = Instant::now();
        let report = session.show(sequence, sequence as i64 * FRAME_INTERVAL_NS, image);
        assert!(begun.elapsed() < MAX_FRAME_TIME, "frame {sequence} took {:?}", begun.elapsed());
        assert!(report.world_from_camera.is_none_or(|pose| pose.is_finite()), "frame {sequence}");
        assert_finite(&session.pipeline.map());
        state = Some(report.outcome.state());
    }
    state
}

fn rendered(sequence: &Sequence, index: usize) -> GrayImage {
    gray_image(sequence.frame(index).image)
}

/// The gray level of a pixel of an image moved by `shift` pixels.
type Pattern = fn(x: u32, y: u32, shift: u32) -> u8;

const PATTERNS: [(&str, Pattern); 5] = [
    ("plain", |_, _, _| 128),
    // Some ten thousand edges.
    ("fine grid", |x, y, shift| if (x + shift) % 6 < 3 || y % 6 < 3 { 220 } else { 30 }),
    ("halftone", |x, y, shift| if ((x + shift) % 4) + (y % 4) < 2 { 0 } else { 255 }),
    ("coarse grid", |x, y, shift| if (x + shift) % 40 < 20 || y % 40 < 20 { 220 } else { 30 }),
    // Spokes through the principal point: the planes of all of them hold the optical axis.
    ("spokes", |x, y, shift| {
        let (dx, dy) = (f64::from(x) - 319.5, f64::from(y) - 239.5);
        let turn = dy.atan2(dx) / std::f64::consts::TAU + f64::from(shift) * 1e-3;
        if (turn * 16.0).rem_euclid(1.0) < 0.5 { 60 } else { 180 }
    }),
];

fn pattern(pixel: Pattern, shift: u32) -> GrayImage {
    GrayImage::from_fn(640, 480, |x, y| pixel(x, y, shift))
}

#[test]
fn patterns_alone_leave_nothing_unsound() {
    let sequence = Sequence::preset(Preset::RoomPoor, 1);
    for (name, pixel) in PATTERNS {
        println!("{name}");
        let mut session = Session::new(inline(3), sequence.camera());
        feed(&mut session, 0, (0..12).map(|index| pattern(pixel, 3 * index)));
        assert_finite(&session.finish());
    }
}

#[test]
fn a_session_finds_its_lines_again_after_every_pattern() {
    const N_BEFORE: usize = 50;
    let sequence = Sequence::preset(Preset::RoomPoor, 1);
    let mut session = Session::new(inline(3), sequence.camera());
    feed(&mut session, 0, (0..N_BEFORE).map(|index| rendered(&sequence, 2 * index)));
    assert!(session.pipeline.map().n_lines() > 10, "only {} lines", session.pipeline.map().n_lines());
    let mut next = N_BEFORE as u64;
    for (name, pixel) in PATTERNS {
        feed(&mut session, next, (0..3).map(|index| pattern(pixel, 5 * index)));
        let seen_before = (0..4).map(|index| rendered(&sequence, 2 * (N_BEFORE - 10) + index));
        let state = feed(&mut session, next + 3, seen_before);
        assert!(matches!(state, Some(FrameState::Tracked | FrameState::Weak)), "after {name}: {state:?}");
        next += 7;
    }
    assert_finite(&session.finish());
}

#[test]
fn edges_along_the_motion_are_not_given_depths_they_do_not_have() {
    // Sideways without shaking, past a wall whose horizontal edges are epipolar lines of every pair of views.
    let mut config = SequenceConfig::preset(Preset::RoomRich, 4);
    config.path.jitter = None;
    config.path.kind = PathKind::Lawnmower {
        low: Vector2::new(-1.5, -0.6),
        high: Vector2::new(1.5, -0.6),
        spacing: 1.0,
        height: 1.4,
        yaw_deg: 90.0,
    };
    let sequence = Sequence::new(config).unwrap();
    let mut session = Session::new(inline(3), sequence.camera());
    session.show_frames(&sequence, (0..40).map(|index| 2 * index));
    let map = session.finish();
    assert_finite(&map);
    // Positions on a straight line leave a similarity open: the first keyframe's attitude fixes it.
    let keyframes: Vec<_> = map.keyframes().collect();
    let [first, .., last] = keyframes.as_slice() else { panic!("no map") };
    let truly = |keyframe: &Keyframe| sequence.camera_from_world(keyframe.sequence as usize);
    let scale = (truly(last).center() - truly(first).center()).norm()
        / (last.camera_from_world.center() - first.camera_from_world.center()).norm();
    let world_from_first = truly(first).inverse();
    let to_truth = |point| world_from_first.transform(&(first.camera_from_world.transform(&point) * scale));
    let (mut n_along, mut n_wrong) = (0, 0);
    for line in map.lines() {
        let ends = line.endpoints.map(to_truth);
        let direction = (ends[1] - ends[0]).normalize();
        if direction.x.abs() < 0.995 {
            continue;
        }
        n_along += 1;
        let right = line_error(&ends, sequence.world())
            .is_some_and(|error| error.angle_deg < 5.0 && error.distance < 0.1);
        n_wrong += usize::from(!right);
    }
    let is_level = |segment: &&LineFeature| {
        let vector = segment.end - segment.start;
        vector.y.abs() < 0.01 * vector.x.abs()
    };
    let n_level = last.features.lines.iter().filter(is_level).count();
    println!(
        "{n_level} level segments; {} lines, {n_along} along the motion, {n_wrong} wrong",
        map.n_lines()
    );
    assert!(n_level >= 3, "only {n_level} segments along the motion to be fooled by");
    assert!(map.n_lines() >= 5 && n_wrong <= 1, "{n_wrong} of {} lines are wrong", map.n_lines());
}
