//! Lines and global primitives of rendered rooms against the true segments and directions.

use geometry::Direction;
use slam::{FeatureSwitches, FrameReport, ResumeState, SlamConfig};
use std::collections::BTreeMap;
use std::ops::Range;
use synthetic::{Preset, Sequence};
use testkit::{FRAME_INTERVAL_NS, LineError, Session, inline, line_error, truth_from_map};

const N_FRAMES: usize = 150;

fn session(sequence: &Sequence, features: FeatureSwitches, state: ResumeState) -> Session {
    Session::resume(SlamConfig { features, ..inline(3) }, sequence.camera(), state)
}

/// Shows frames and ends the recording.
fn run(session: &mut Session, sequence: &Sequence, frames: Range<usize>) -> Vec<FrameReport> {
    let reports = session.show_frames(sequence, frames);
    session.finish();
    reports
}

#[test]
fn lines_of_a_poor_room_lie_on_its_edges() {
    let sequence = Sequence::preset(Preset::RoomPoor, 1);
    let mut session = session(&sequence, FeatureSwitches::default(), ResumeState::default());
    let reports = run(&mut session, &sequence, 0..N_FRAMES);
    let map = session.pipeline.map();
    assert!(map.n_lines() >= 20, "only {} lines", map.n_lines());
    assert!(reports.iter().filter(|report| report.n_inlier_lines >= 5).count() > N_FRAMES / 2);

    let truth_from_map = truth_from_map(&map, &sequence).unwrap();
    let errors: Vec<LineError> = map
        .lines()
        .filter_map(|line| {
            line_error(&line.endpoints.map(|end| truth_from_map.transform(&end)), sequence.world())
        })
        .collect();
    let n_right = errors.iter().filter(|error| error.angle_deg < 1.0 && error.distance < 0.02).count();
    let share = n_right as f64 / map.n_lines() as f64;
    let mut distances: Vec<f64> = errors.iter().map(|error| error.distance).collect();
    distances.sort_by(f64::total_cmp);
    let median = distances[distances.len() / 2];
    println!(
        "{} lines, {:.0} % within 1 degree and 2 cm, median distance {median:.4} m",
        map.n_lines(),
        100.0 * share
    );
    assert!(
        share >= 0.5 && median < 0.02,
        "{share:.2} within 1 degree and 2 cm, median distance {median:.4} m"
    );
}

#[test]
fn the_directions_of_a_room_become_one_primitive_each() {
    let sequence = Sequence::preset(Preset::RoomPoor, 2);
    let mut session = session(&sequence, FeatureSwitches::default(), ResumeState::default());
    run(&mut session, &sequence, 0..N_FRAMES);
    let map = session.pipeline.map();
    let truth_from_map = truth_from_map(&map, &sequence).unwrap();
    let truths = sequence.world().vanishing_directions();
    let mut n_spurious = 0;
    let mut found: BTreeMap<usize, usize> = BTreeMap::new();
    for primitive in map.primitives() {
        let direction = Direction::new(truth_from_map.rotation * primitive.direction.as_vector()).unwrap();
        let nearest =
            truths.iter().enumerate().map(|(idx, truth)| (truth.angle(&direction).to_degrees(), idx));
        let (angle, idx) = nearest.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        println!(
            "primitive {} of {} keyframes: {angle:.2} degrees off",
            primitive.id,
            primitive.observations.len()
        );
        if angle < 1.5 {
            *found.entry(idx).or_default() += 1;
        } else {
            n_spurious += 1;
        }
    }
    assert!(found.len() >= 2, "only {} of {} directions found", found.len(), truths.len());
    assert!(found.values().all(|n| *n == 1), "a direction became several primitives: {found:?}");
    assert!(n_spurious <= 1, "{n_spurious} spurious primitives");
    assert!(map.lines().filter(|line| line.primitive.is_some()).count() >= 5);
}

#[test]
fn a_restored_session_goes_on_with_its_lines_and_primitives() {
    let sequence = Sequence::preset(Preset::RoomPoor, 1);
    let mut first = session(&sequence, FeatureSwitches::default(), ResumeState::default());
    run(&mut first, &sequence, 0..100);
    let map = first.pipeline.map();
    assert!(map.n_lines() > 0);
    let state =
        ResumeState { map: map.to_parts(), last_frame: Some((99, 99 * FRAME_INTERVAL_NS)), mask: None };
    let mut second = session(&sequence, FeatureSwitches::default(), state);
    assert_eq!(
        (second.pipeline.map().n_lines(), second.pipeline.map().n_primitives()),
        (map.n_lines(), map.n_primitives())
    );
    let reports = run(&mut second, &sequence, 100..120);
    assert!(reports.iter().any(|report| report.n_inlier_lines >= 5), "no frame sees the stored lines");
}

#[test]
fn switched_off_features_leave_no_trace() {
    let sequence = Sequence::preset(Preset::RoomPoor, 1);
    let switches = FeatureSwitches { lines: false, global_primitives: false, ..FeatureSwitches::default() };
    let mut points_only = session(&sequence, switches, ResumeState::default());
    let reports = run(&mut points_only, &sequence, 0..60);
    assert_eq!((points_only.pipeline.map().n_lines(), points_only.pipeline.map().n_primitives()), (0, 0));
    assert!(reports.iter().all(|report| report.n_segments == 0));
    let switches = FeatureSwitches { lines: true, global_primitives: false, ..FeatureSwitches::default() };
    let mut with_lines = session(&sequence, switches, ResumeState::default());
    run(&mut with_lines, &sequence, 0..60);
    assert!(with_lines.pipeline.map().n_lines() > 0);
    assert_eq!(with_lines.pipeline.map().n_primitives(), 0);
    let vanishing =
        with_lines.pipeline.map().keyframes().map(|keyframe| keyframe.vanishing.len()).sum::<usize>();
    assert_eq!(vanishing, 0, "without primitives nobody looks for vanishing points");
}
