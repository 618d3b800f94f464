//! Recordings as people make them, by phone, drone and car, of weak texture, and those of the laboratory:
//! from which frame on the engine has a pose, how many frames get one, and how wrong they are. Folders of
//! docs/datasets.md.

use recordings::{EvaluationOptions, Recording, StampedPose, Trajectory, evaluate, find_folder};
use slam::report::TrackingOutcome;
use testkit::{Session, inline};
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};

/// What came of the first frames of a recording.
struct Outcome {
    n_frames: usize,
    /// Frame from which on tracking has a pose, as they come.
    first_live: usize,
    /// Frames of the largest submap in the end, those placed afterwards among them.
    n_posed: usize,
    /// Root mean square error of the positions as a share of the true path; where there is a truth.
    ate_share: Option<f64>,
}

fn run(name: &str, n_frames: usize) -> Outcome {
    let folder = find_folder(name).unwrap_or_else(|missing| panic!("{missing}"));
    let recording = Recording::open(&folder, None).unwrap_or_else(|refused| panic!("{refused}"));
    let mut session = Session::new(inline(0), &recording.camera);
    let frames = &recording.frames[..n_frames.min(recording.frames.len())];
    let mut first_live = None;
    for (number, frame) in frames.iter().enumerate() {
        let bytes = std::fs::read(&frame.path).expect("an image of the recording");
        let image = decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default()).expect("an image");
        let report = session.show(number as u64, frame.timestamp_ns, image);
        if matches!(report.outcome, TrackingOutcome::Tracked | TrackingOutcome::Weak { .. }) {
            first_live.get_or_insert(number);
        }
    }
    session.finish();
    let poses = poses(&session);
    let ate_share = folder.join("groundtruth.txt").exists().then(|| {
        let truth = Trajectory::read(&folder.join("groundtruth.txt")).expect("a true trajectory");
        let last_ns = frames.last().map_or(0, |frame| frame.timestamp_ns);
        let shown = truth.poses().iter().filter(|pose| pose.timestamp_ns <= last_ns).copied().collect();
        let evaluation = evaluate(&Trajectory::new(shown), &poses, &EvaluationOptions::default());
        let evaluation = evaluation.unwrap_or_else(|failed| panic!("{name}: {failed}"));
        evaluation.ate_rmse / evaluation.path
    });
    let first_live = first_live.unwrap_or(usize::MAX);
    Outcome { n_frames: frames.len(), first_live, n_posed: poses.len(), ate_share }
}

/// The trajectory in the largest submap.
fn poses(session: &Session) -> Trajectory {
    let map = session.pipeline.map();
    let largest = testkit::largest_submap(&map);
    let stamped = session.records.values().filter_map(|record| {
        let (submap, camera_from_world) = map.locate(&record.pose?)?;
        let world_from_camera = camera_from_world.inverse();
        (Some(submap) == largest)
            .then_some(StampedPose { timestamp_ns: record.timestamp_ns, world_from_camera })
    });
    Trajectory::new(stamped.collect())
}

/// Bounds leave room for another compiler's rounding: about twice what was measured.
fn assert_good(name: &str, n_frames: usize, max_first_live: usize, max_ate_share: f64) {
    let Outcome { n_frames, first_live, n_posed, ate_share } = run(name, n_frames);
    println!("{name}: live from frame {first_live}, {n_posed} of {n_frames} posed, ATE {ate_share:?}");
    assert!(first_live <= max_first_live, "{name}: live from frame {first_live}");
    assert!(n_posed as f64 >= 0.95 * n_frames as f64, "{name}: {n_posed} of {n_frames} frames have a pose");
    if let Some(share) = ate_share {
        assert!(share <= max_ate_share, "{name}: off by {:.2} % of the path", 100.0 * share);
    }
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn a_far_scene_has_a_map_within_a_second() {
    assert_good("drone_coast_first120", 120, 30, f64::INFINITY);
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn walking_straight_ahead_has_a_map_at_once() {
    assert_good("phone_hallway", 193, 15, 0.015);
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn a_wrong_pose_in_blur_does_not_begin_a_wrong_map() {
    assert_good("phone_desk_first100", 100, 10, 0.013);
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn white_cloth_has_features() {
    assert_good("tum_fr3_structure_notexture_far_first150", 150, 40, 0.03);
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn small_images_keep_their_scale() {
    assert_good("kitti_00_low_first400", 200, 10, 0.03);
}

/// Of a camera with a rolling shutter that nobody told, which repeats every eleventh image.
#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn repeated_images_do_not_lose_the_camera() {
    assert_good("7scenes_redkitchen", 1000, 60, 0.007);
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn what_the_laboratory_recorded_stays_as_good_as_it_was() {
    assert_good("euroc_v1_01_part_b", 90, 20, 0.003);
    assert_good("icl_of_kt0_first101", 101, 60, 0.0045);
    assert_good("kitti_snippet_2", 51, 10, 0.004);
}

#[test]
#[ignore = "takes minutes: set MONOSLAM_DATA"]
fn a_long_way_and_stairs_are_one_map() {
    assert_good("pov_office", 720, 40, 0.0012);
    assert_good("phone_staircase", 340, 60, 0.02);
}
