//! Global primitives against the true directions of rendered worlds: rooms of three directions, a hall of
//! more that are not at right angles, and a cave of none.

use geometry::Direction;
use geometry::nalgebra::Vector3;
use slam::Map;
use slam::map::{Keyframe, VanishingObservation};
use std::collections::BTreeSet;
use std::sync::Arc;
use synthetic::{Preset, Sequence, VisibleSegment};
use testkit::{Session, gray_image, inline, truth_from_map};

/// Frames that are rendered of each sequence: rendering takes most of the time.
const N_FRAMES: usize = 80;
/// Farther from every true direction than this, a primitive is spurious.
const MAX_PRIMITIVE_ERROR_DEG: f64 = 1.5;
/// True segments of a direction that keyframes must show for it to be expected.
const MIN_SEGMENTS: usize = 8;
/// How many keyframes must.
const MIN_KEYFRAMES: usize = 5;
/// Shorter than this, pixels, or fainter, gray levels, a segment does not count.
const MIN_LENGTH_PX: f64 = 40.0;
const MIN_CONTRAST: f64 = 12.0;

/// Tracks every `step`th frame.
fn track(preset: Preset, seed: u64, step: usize, n_frames: usize) -> (Sequence, Arc<Map>) {
    let sequence = Sequence::preset(preset, seed);
    let mut session = Session::new(inline(seed), sequence.camera());
    for index in (0..sequence.len()).step_by(step).take(n_frames) {
        session.show(index as u64, sequence.timestamp_ns(index), gray_image(sequence.frame(index).image));
    }
    let map = session.finish();
    assert!(map.n_keyframes() >= 5, "{} {seed}: only {} keyframes", preset.name(), map.n_keyframes());
    (sequence, map)
}

/// Angle to the nearest true direction, degrees, and which it is.
fn nearest(truths: &[Direction], direction: &Vector3<f64>) -> (f64, usize) {
    let angle = |truth: &Direction| truth.angle(&Direction::new(*direction).unwrap_or(*truth)).to_degrees();
    let angles = truths.iter().enumerate().map(|(idx, truth)| (angle(truth), idx));
    angles.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

fn in_true_world(sequence: &Sequence, keyframe: &Keyframe, vanishing: &VanishingObservation) -> Vector3<f64> {
    let camera_from_world = sequence.camera_from_world(keyframe.sequence as usize);
    camera_from_world.rotation.inverse() * vanishing.direction
}

/// What a map says of the directions of its world.
#[derive(Debug, Default)]
struct Comparison {
    /// Of each keyframe's vanishing points that belong to a primitive, degrees.
    vanishing_errors_deg: Vec<f64>,
    /// Primitives of each true direction.
    n_primitives: Vec<usize>,
    /// In how many keyframes a true direction could be seen well.
    n_showing: Vec<usize>,
    n_spurious: usize,
}

fn compare(sequence: &Sequence, map: &Map) -> Comparison {
    let truths = sequence.world().vanishing_directions();
    let mut comparison = Comparison { n_primitives: vec![0; truths.len()], ..Comparison::default() };
    comparison.n_showing = vec![0; truths.len()];
    for keyframe in map.keyframes() {
        for vanishing in keyframe.vanishing.iter().filter(|vanishing| vanishing.primitive.is_some()) {
            let direction = in_true_world(sequence, keyframe, vanishing);
            comparison.vanishing_errors_deg.push(nearest(truths, &direction).0);
        }
        let visible = sequence.visible_segments(keyframe.sequence as usize);
        for (idx, n_showing) in comparison.n_showing.iter_mut().enumerate() {
            let is_seen = |segment: &&VisibleSegment| {
                segment.family == Some(idx)
                    && (segment.ends_px[1] - segment.ends_px[0]).norm() >= MIN_LENGTH_PX
                    && segment.contrast >= MIN_CONTRAST
            };
            let segments: BTreeSet<usize> = visible.iter().filter(is_seen).map(|part| part.segment).collect();
            *n_showing += usize::from(segments.len() >= MIN_SEGMENTS);
        }
    }

    let truth_from_map = truth_from_map(map, sequence).unwrap();
    for primitive in map.primitives() {
        match nearest(truths, &(truth_from_map.rotation * primitive.direction.as_vector())) {
            (error_deg, idx) if error_deg < MAX_PRIMITIVE_ERROR_DEG => comparison.n_primitives[idx] += 1,
            _ => comparison.n_spurious += 1,
        }
    }
    comparison
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Returns the true directions of which there is a primitive.
fn assert_directions_are_found(
    preset: Preset,
    seeds: &[u64],
    step: usize,
    n_frames: usize,
) -> Vec<Direction> {
    let mut directions = Vec::new();
    let (mut errors_deg, mut n_expected, mut n_single, mut n_spurious) = (Vec::new(), 0, 0, 0);
    for seed in seeds {
        let (sequence, map) = track(preset, *seed, step, n_frames);
        let found = compare(&sequence, &map);
        println!("{} {seed}: {:?} {:?}", preset.name(), found.n_primitives, found.n_showing);
        for (n, n_showing) in found.n_primitives.iter().zip(&found.n_showing) {
            n_expected += usize::from(*n_showing >= MIN_KEYFRAMES);
            n_single += usize::from(*n_showing >= MIN_KEYFRAMES && *n == 1);
            assert!(*n <= 1, "seed {seed}: a direction became {n} primitives");
        }
        n_spurious += found.n_spurious;
        let truths = sequence.world().vanishing_directions().iter().zip(&found.n_primitives);
        directions.extend(truths.filter(|(_, n)| **n > 0).map(|(truth, _)| *truth));
        errors_deg.extend(found.vanishing_errors_deg);
    }
    let error_deg = median(&mut errors_deg);
    println!(
        "{n_single} of {n_expected} directions, {n_spurious} spurious, median error {error_deg:.3} degrees"
    );
    assert!(n_expected >= 2 * seeds.len(), "only {n_expected} directions can be seen well");
    assert!(n_single as f64 >= 0.95 * n_expected as f64, "{n_single} of {n_expected} directions found");
    assert!(n_spurious < seeds.len(), "{n_spurious} spurious primitives in {} sequences", seeds.len());
    assert!(error_deg < 0.3, "vanishing points are off by {error_deg:.3} degrees in the median");
    directions
}

#[test]
fn each_direction_of_a_room_becomes_one_primitive() {
    assert_directions_are_found(Preset::RoomPoor, &[3, 4], 2, N_FRAMES);
}

#[test]
fn directions_need_not_be_at_right_angles() {
    // It takes a walk around the hall to see the slabs of all directions from where they show enough edges.
    let found = assert_directions_are_found(Preset::Atlanta, &[1], 3, 2 * N_FRAMES);
    let angles_deg = || found.iter().flat_map(|a| found.iter().map(move |b| a.angle(b).to_degrees()));
    let n_oblique = angles_deg().filter(|angle_deg| (20.0..70.0).contains(angle_deg)).count();
    assert!(found.len() >= 4 && n_oblique > 0, "only directions at right angles: {found:?}");
}

#[test]
fn without_parallel_lines_no_primitive_lives() {
    let (_, map) = track(Preset::Unstructured, 1, 2, N_FRAMES);
    assert_eq!(map.n_primitives(), 0);
}
