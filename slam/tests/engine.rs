//! The whole engine on rendered sequences with exact truth.

use geometry::Pose;
use slam::map::FrameState;
use slam::{Cores, Frame, FrameError, FrameReport, InitializationWait, Map, ResumeState};
use slam::{SlamConfig, Threading, TrackingOutcome};
use std::collections::BTreeMap;
use synthetic::{Preset, Sequence};
use testkit::{FRAME_INTERVAL_NS, Session, evaluate, gray_image};
use vision::GrayImage;

fn new_session(sequence: &Sequence, threading: Threading) -> Session {
    resume_session(sequence, threading, ResumeState::default())
}

fn resume_session(sequence: &Sequence, threading: Threading, state: ResumeState) -> Session {
    let config = SlamConfig { threading, seed: 7, ..SlamConfig::default() };
    Session::resume(config, sequence.camera(), state)
}

/// Shows an image at the time of its number.
fn show(session: &mut Session, number: u64, image: GrayImage) -> FrameReport {
    session.show(number, number as i64 * FRAME_INTERVAL_NS, image)
}

fn image(sequence: &Sequence, index: usize) -> GrayImage {
    gray_image(sequence.frame(index).image)
}

/// Root mean square distance to the truth after similarity alignment, as a share of the truth's path; a
/// frame's number is its index.
fn relative_error(sequence: &Sequence, trajectory: &BTreeMap<u64, Pose>) -> f64 {
    let truth = |number: u64| sequence.camera_from_world(number as usize).inverse();
    let evaluation = evaluate(trajectory, truth).unwrap();
    evaluation.ate_rmse / evaluation.path
}

#[test]
fn a_rich_room_is_tracked_within_one_per_cent_of_the_path() {
    let sequence = Sequence::preset(Preset::RoomRich, 1);
    let n = sequence.len().min(150);
    let mut session = new_session(&sequence, Threading::Background);
    for index in 0..n {
        show(&mut session, index as u64, image(&sequence, index));
    }
    let map = session.finish();
    let trajectory = session.trajectory();
    assert!(trajectory.len() >= n * 97 / 100, "only {} of {n} frames have a pose", trajectory.len());
    let error = relative_error(&sequence, &trajectory);
    assert!(error < 0.01, "error of {:.3} % of the path", 100.0 * error);
    assert!(
        map.n_keyframes() >= 5 && map.n_points() >= 300,
        "{} keyframes, {} points",
        map.n_keyframes(),
        map.n_points()
    );
    assert_eq!(session.records.len(), n, "every frame is in the trajectory, with or without a pose");
}

#[test]
fn the_same_frames_and_seed_give_the_same_trajectory() {
    let sequence = Sequence::preset(Preset::RoomRich, 2);
    let run = || {
        let mut session = new_session(&sequence, Threading::Inline);
        let reports: Vec<FrameReport> =
            (0..60).map(|index| show(&mut session, index as u64, image(&sequence, index))).collect();
        let map = session.finish();
        let points: Vec<[u64; 3]> =
            map.points().map(|point| [0, 1, 2].map(|axis| point.position[axis].to_bits())).collect();
        (reports, session.records, points)
    };
    let (first, second) = (run(), run());
    assert_eq!(first.0, second.0);
    assert_eq!(first.1, second.1);
    assert!(!first.2.is_empty() && first.2 == second.2);
}

#[test]
fn sessions_that_share_a_core_compute_what_one_alone_does() {
    let sequence = Sequence::preset(Preset::RoomRich, 2);
    let run = || {
        let mut session = new_session(&sequence, Threading::Background);
        (0..40).for_each(|index| _ = show(&mut session, index as u64, image(&sequence, index)));
        let map = session.finish();
        let positions = map.points().map(|point| [0, 1, 2].map(|axis| point.position[axis].to_bits()));
        (session.records, positions.collect::<Vec<[u64; 3]>>())
    };
    let alone = run();
    let start = std::time::Instant::now();
    let cores = Cores::new(1, move || start.elapsed());
    let shared = std::thread::scope(|scope| {
        let in_turns = || {
            let _joined = cores.join();
            run()
        };
        [0, 1].map(|_| scope.spawn(in_turns)).map(|thread| thread.join().unwrap())
    });
    assert!(!alone.1.is_empty() && shared.iter().all(|shared| *shared == alone));
    assert_eq!(cores.n_waiting(), 0);
}

#[test]
fn frames_that_are_keyframes_have_the_poses_of_their_keyframes() {
    let sequence = Sequence::preset(Preset::RoomRich, 2);
    let mut session = new_session(&sequence, Threading::Inline);
    (0..100).for_each(|index| _ = show(&mut session, index as u64, image(&sequence, index)));
    let map = session.finish();
    assert!(map.n_keyframes() >= 5, "{} keyframes are too few to tell", map.n_keyframes());
    for keyframe in map.keyframes() {
        let record = &session.records[&keyframe.sequence];
        let (_, camera_from_world) = record.pose.and_then(|pose| map.locate(&pose)).expect("it has a pose");
        let off = (camera_from_world * keyframe.camera_from_world.inverse()).log().norm();
        assert!(off < 1e-12, "frame {} is off its keyframe by {off}", keyframe.sequence);
    }
}

#[test]
fn a_resumed_session_finds_its_place_and_goes_on_in_the_same_frame_of_reference() {
    let sequence = Sequence::preset(Preset::RoomRich, 3);
    let mut session = new_session(&sequence, Threading::Background);
    for index in 0..90 {
        show(&mut session, index as u64, image(&sequence, index));
    }
    let map = session.finish();
    let state =
        ResumeState { map: map.to_parts(), last_frame: Some((89, 89 * FRAME_INTERVAL_NS)), mask: None };
    let mut resumed = resume_session(&sequence, Threading::Background, state);
    resumed.records = std::mem::take(&mut session.records);
    let reports: Vec<FrameReport> =
        (90..130).map(|index| show(&mut resumed, index as u64, image(&sequence, index))).collect();
    let first_found =
        reports.iter().position(|report| report.relocalized).expect("the session finds its place");
    assert!(first_found < 10, "found only after {first_found} frames");
    resumed.finish();
    let trajectory = resumed.trajectory();
    assert!(trajectory.keys().filter(|number| **number >= 90).count() >= 30);
    let error = relative_error(&sequence, &trajectory);
    assert!(error < 0.02, "error of {:.3} % of the path over both parts", 100.0 * error);
}

#[test]
fn a_covered_lens_loses_the_camera_and_a_known_view_finds_it_again() {
    let sequence = Sequence::preset(Preset::RoomRich, 4);
    let mut session = new_session(&sequence, Threading::Background);
    for index in 0..80 {
        show(&mut session, index as u64, image(&sequence, index));
    }
    let camera = sequence.camera();
    for number in 80..90 {
        let report = show(&mut session, number, GrayImage::new(camera.width(), camera.height()));
        assert_eq!(report.outcome.state(), FrameState::Lost);
        assert!(report.world_from_camera.is_none() && !report.outcome.reason().is_empty());
    }
    let found = (90..100)
        .find(|number| show(&mut session, *number, image(&sequence, 60)).world_from_camera.is_some());
    assert!(found.is_some(), "a view of the map is recognised");
}

#[test]
fn images_without_content_never_make_a_map() {
    let sequence = Sequence::preset(Preset::RoomRich, 1);
    let (width, height) = (sequence.camera().width(), sequence.camera().height());
    let noise = |seed: u64| {
        let mut state = seed;
        GrayImage::from_fn(width, height, |_, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        })
    };
    let plain = |value: u8| GrayImage::from_fn(width, height, |_, _| value);
    type Maker<'a> = Box<dyn Fn(u64) -> GrayImage + 'a>;
    let kinds: [(&str, Maker); 4] = [
        ("black", Box::new(|_| plain(0))),
        ("saturated", Box::new(|_| plain(255))),
        ("grey", Box::new(|_| plain(128))),
        ("noise", Box::new(|number| noise(number + 1))),
    ];
    for (kind, make) in kinds {
        let mut session = new_session(&sequence, Threading::Inline);
        for number in 0..8 {
            let report = show(&mut session, number, make(number));
            assert!(
                matches!(report.outcome, TrackingOutcome::Initialising(_)),
                "{kind}: {:?}",
                report.outcome
            );
            assert!(!report.outcome.reason().is_empty());
        }
        assert_eq!(session.finish().n_keyframes(), 0, "{kind}");
    }
}

#[test]
fn a_camera_at_rest_waits_and_says_why() {
    let sequence = Sequence::preset(Preset::RoomRich, 1);
    let mut session = new_session(&sequence, Threading::Inline);
    let outcomes: Vec<TrackingOutcome> =
        (0..5).map(|number| show(&mut session, number, image(&sequence, 0)).outcome).collect();
    let waits = |outcome: &TrackingOutcome| {
        matches!(outcome, TrackingOutcome::Initialising(InitializationWait::TooLittleParallax { .. }))
    };
    // An image that comes again says what it said when it was new, until the camera must be at rest.
    assert!(
        outcomes[..4].iter().all(|outcome| *outcome == outcomes[0]) && waits(&outcomes[4]),
        "{outcomes:?}"
    );
}

#[test]
fn frames_that_cannot_be_used_change_nothing() {
    let sequence = Sequence::preset(Preset::RoomRich, 1);
    let mut session = new_session(&sequence, Threading::Inline);
    show(&mut session, 5, image(&sequence, 0));
    let mut refuse = |sequence_number: u64, timestamp_ns: i64, image: GrayImage| {
        session.pipeline.process_frame(Frame { sequence: sequence_number, timestamp_ns, image }).unwrap_err()
    };
    let good = || image(&sequence, 1);
    assert!(matches!(
        refuse(6, 1_000_000_000, GrayImage::new(320, 240)),
        FrameError::WrongImageSize { width: 320, .. }
    ));
    assert!(matches!(refuse(6, 5 * FRAME_INTERVAL_NS, good()), FrameError::TimestampNotIncreasing { .. }));
    assert!(matches!(
        refuse(5, 1_000_000_000, good()),
        FrameError::SequenceNotIncreasing { last_sequence: 5, .. }
    ));
    show(&mut session, 6, good());
}

#[test]
fn an_inconsistent_stored_map_is_refused() {
    let sequence = Sequence::preset(Preset::RoomRich, 1);
    let mut session = new_session(&sequence, Threading::Inline);
    let mut number = 0;
    while session.pipeline.map().n_keyframes() == 0 && number < 60 {
        show(&mut session, number, image(&sequence, number as usize));
        number += 1;
    }
    let map = session.finish();
    let mut parts = map.to_parts();
    assert!(Map::from_parts(parts.clone()).is_ok());
    parts.points.pop().expect("the map has points");
    let error = Map::from_parts(parts).unwrap_err();
    assert!(error.to_string().contains("claims point"), "{error}");
}
