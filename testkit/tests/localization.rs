//! Single images of other cameras in the map of a recording (docs/limits.md): the map
//! is made of the first 600 frames of 7-Scenes RedKitchen, and later ones are looked for in it whole, halved,
//! cropped, and with the focal length withheld; images of other places must not be found.

use geometry::{Camera, CameraParameters, Pose, Similarity};
use nalgebra::{UnitQuaternion, Vector3};
use recordings::{Recording, Trajectory, find_folder};
use slam::map::FrameState;
use slam::{Found, LocalizeCamera, Localizer, NoClock};
use std::sync::Arc;
use std::time::Instant;
use testkit::{Session, inline};
use vision::GrayImage;
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};

const N_MAPPED: usize = 600;
/// Of the later images, and of other recordings', every so many are looked for.
const STEP: usize = 8;
const OTHERS_STEP: usize = 50;
/// An image is within view of the map if a mapped frame was taken from as near, metres, and in as similar a
/// direction, degrees: most of what is one or two metres away is on both then.
const WITHIN_VIEW: (f64, f64) = (0.3, 25.0);
/// How far off a located image may be, metres and degrees.
const MAX_ERROR: (f64, f64) = (0.05, 2.0);
/// Mapped frames beside which an image is placed, and how many degrees count as a metre.
const N_BESIDE: usize = 5;
const DEGREES_PER_METRE: f64 = 60.0;
const OTHERS: [&str; 8] = [
    "phone_desk_first100",
    "phone_hallway",
    "phone_staircase",
    "pov_office",
    "icl_of_kt0_first101",
    "kitti_00_low_first400",
    "euroc_v1_01_part_b",
    "tum_fr3_structure_notexture_far_first150",
];

fn read(path: &std::path::Path) -> GrayImage {
    let bytes = std::fs::read(path).expect("an image of the recording");
    decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default()).expect("an image")
}

/// A part of an image, from its left upper corner.
fn part(image: &GrayImage, x: u32, y: u32, width: u32, height: u32) -> GrayImage {
    let pixels = (y..y + height).flat_map(|row| (x..x + width).map(move |column| (column, row)));
    let pixels = pixels.map(|(x, y)| image.get(x, y).expect("inside of the image")).collect();
    GrayImage::from_raw(width, height, pixels).expect("the part has its size")
}

fn half(image: &GrayImage) -> GrayImage {
    vision::scale::resize_area(image, image.width() / 2, image.height() / 2)
}

/// The map's camera, as it was found, with its images scaled after a shift to the left and upwards.
fn given(own: &CameraParameters, size: (u32, u32), shift: (f64, f64), factor: f64) -> LocalizeCamera {
    let ((width, height), (x, y)) = (size, shift);
    let center = |own: f64, shift: f64| (own - shift + 0.5) * factor - 0.5;
    let (cx, cy) = (center(own.cx, x), center(own.cy, y));
    let (fx, fy) = (own.fx * factor, own.fy * factor);
    let parameters = CameraParameters { width, height, fx, fy, cx, cy, ..own.clone() };
    LocalizeCamera::Given(Box::new(Camera::new(parameters).expect("a camera")))
}

/// Shows an image otherwise than the map's camera does.
type Shown = fn(&GrayImage, &CameraParameters) -> (GrayImage, LocalizeCamera);

/// A way, and the share of the images within view that must be located. What is cropped shows less of what
/// was mapped, and may show nothing of it.
type Variant = (&'static str, f64, Shown);

const VARIANTS: [Variant; 6] = [
    ("as it is", 0.95, |image, _| (image.clone(), LocalizeCamera::Session)),
    ("halved", 0.95, |image, own| (half(image), given(own, (320, 240), (0.0, 0.0), 0.5))),
    ("cropped to the right", 0.85, |image, own| {
        (part(image, 160, 0, 480, 480), given(own, (480, 480), (160.0, 0.0), 1.0))
    }),
    ("focal length withheld", 0.95, |image, _| (image.clone(), LocalizeCamera::Unknown)),
    ("halved, withheld", 0.95, |image, _| (half(image), LocalizeCamera::Unknown)),
    ("halved, cropped about the middle, withheld", 0.4, |image, _| {
        (half(&part(image, 80, 60, 480, 360)), LocalizeCamera::Unknown)
    }),
];

/// What takes a map to the truth. The true poses are those of the depth camera, which is fixed beside the
/// color camera.
struct Alignment {
    truth_from_map: Similarity,
    /// The color camera's attitude and place as the depth camera sees them.
    depth_from_color: Pose,
    /// Poses of mapped frames, in the map and in truth.
    pairs: Vec<(Pose, Pose)>,
}

impl Alignment {
    /// By poses in the map and the true ones. The rotation between the cameras, their distance and the
    /// similarity depend on each other, and are found in turn.
    fn of(pairs: &[(Pose, Pose)]) -> Self {
        let mut depth_from_color = Pose::identity();
        let mut truth_from_map = Similarity::identity();
        for _ in 0..10 {
            let estimated: Vec<_> = pairs.iter().map(|(pose, _)| pose.translation).collect();
            let expected: Vec<_> =
                pairs.iter().map(|(_, pose)| (*pose * depth_from_color).translation).collect();
            let fitted = Similarity::from_correspondences(&estimated, &expected, true);
            truth_from_map = fitted.expect("a trajectory");
            let offsets = pairs.iter().map(|(pose, truth)| truth.inverse() * moved(pose, &truth_from_map));
            let offsets: Vec<Pose> = offsets.collect();
            let n = offsets.len() as f64;
            let turn = offsets.iter().map(|offset| offset.rotation.scaled_axis()).sum::<Vector3<f64>>() / n;
            let shift = offsets.iter().map(|offset| offset.translation).sum::<Vector3<f64>>() / n;
            depth_from_color = Pose::new(UnitQuaternion::from_scaled_axis(turn), shift);
        }
        Self { truth_from_map, depth_from_color, pairs: pairs.to_vec() }
    }

    /// As [`Self::error`], against where the nearest mapped frames are in the map: without the map's own
    /// drift.
    fn error_beside(&self, pose: &Pose, truth: &Pose) -> (f64, f64) {
        let mut near: Vec<&(Pose, Pose)> = self.pairs.iter().collect();
        let distance = |other: &Pose| {
            let (shift, turn) = between(truth, other);
            shift + turn / DEGREES_PER_METRE
        };
        near.sort_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1)));
        let scale = self.truth_from_map.scale;
        let there = *truth * self.depth_from_color;
        let errors = near.iter().take(N_BESIDE).map(|(mapped, mapped_truth)| {
            let way = (*mapped_truth * self.depth_from_color).inverse() * there;
            let expected = *mapped * Pose::new(way.rotation, way.translation / scale);
            let (shift, turn) = between(pose, &expected);
            (shift * scale, turn)
        });
        let (mut shifts, mut turns): (Vec<f64>, Vec<f64>) = errors.unzip();
        shifts.sort_by(f64::total_cmp);
        turns.sort_by(f64::total_cmp);
        (shifts[shifts.len() / 2], turns[turns.len() / 2])
    }

    /// Whether something near was mapped.
    fn is_within_view(&self, truth: &Pose) -> bool {
        self.pairs.iter().any(|(_, mapped)| {
            let (shift, turn) = between(truth, mapped);
            shift <= WITHIN_VIEW.0 && turn <= WITHIN_VIEW.1
        })
    }

    /// Metres and degrees by which a pose in the map is off.
    fn error(&self, pose: &Pose, truth: &Pose) -> (f64, f64) {
        between(&moved(pose, &self.truth_from_map), &(*truth * self.depth_from_color))
    }
}

fn moved(pose: &Pose, by: &Similarity) -> Pose {
    Pose::new(by.rotation * pose.rotation, by.transform(&pose.translation))
}

/// Map, and what takes it to the truth.
fn map_of(recording: &Recording, truth: &Trajectory) -> (Localizer, Alignment) {
    // The calibration that comes with the recording is the depth camera's.
    let mut config = inline(0);
    config.calibration.trust = slam::CalibrationTrust::Approximate;
    let mut session = Session::new(config.clone(), &recording.camera);
    for (number, frame) in recording.frames.iter().take(N_MAPPED).enumerate() {
        session.show(number as u64, frame.timestamp_ns, read(&frame.path));
    }
    session.finish();
    let map = session.pipeline.map();
    let largest = testkit::largest_submap(&map);
    let mut pairs = Vec::new();
    for record in session.records.values() {
        let Some((submap, camera_from_world)) = record.pose.and_then(|pose| map.locate(&pose)) else {
            continue;
        };
        if Some(submap) == largest {
            pairs.push((camera_from_world.inverse(), true_pose(truth, record.timestamp_ns)));
        }
    }
    let aligned = Alignment::of(&pairs);
    let mut own: Vec<(f64, f64)> = pairs.iter().map(|(pose, truth)| aligned.error(pose, truth)).collect();
    let mut turns: Vec<f64> = own.iter().map(|error| error.1).collect();
    turns.sort_by(f64::total_cmp);
    own.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Pose { rotation, translation } = aligned.depth_from_color;
    println!(
        "{} submaps, {} keyframes, {} points; cameras {:.1} deg and {:.3} m apart; mapped frames are {:.3} m off in the \
         median, 95 % within {:.3} m; {:.2} deg, 95 % within {:.2}; focal length {:.1} px",
        map.submaps().len(),
        map.n_keyframes(),
        map.n_points(),
        rotation.angle().to_degrees(),
        translation.norm(),
        own[own.len() / 2].0,
        own[own.len() * 19 / 20].0,
        turns[turns.len() / 2],
        turns[turns.len() * 19 / 20],
        recording.camera.with_correction(map.correction()).pinhole().mean_focal_px()
    );
    let localizer = Localizer::new(config, recording.camera.clone(), None, map.to_parts(), Arc::new(NoClock))
        .expect("a map");
    (localizer, aligned)
}

fn true_pose(truth: &Trajectory, timestamp_ns: i64) -> Pose {
    let poses = truth.poses();
    let nearest = poses.iter().min_by_key(|pose| (pose.timestamp_ns - timestamp_ns).abs());
    nearest.expect("a true trajectory").world_from_camera
}

/// Metres and degrees between two poses.
fn between(a: &Pose, b: &Pose) -> (f64, f64) {
    ((a.translation - b.translation).norm(), a.rotation.angle_to(&b.rotation).to_degrees())
}

fn is_sure(found: &Found) -> bool {
    found.report.outcome.state() == FrameState::Tracked
}

#[test]
#[ignore = "takes minutes: set MONOSLAM_DATA"]
fn other_cameras_images_are_located_and_other_places_are_not() {
    let folder = find_folder("7scenes_redkitchen").unwrap_or_else(|missing| panic!("{missing}"));
    let recording = Recording::open(&folder, None).unwrap_or_else(|refused| panic!("{refused}"));
    let truth = Trajectory::read(&folder.join("groundtruth.txt")).expect("a true trajectory");
    let (mut localizer, aligned) = map_of(&recording, &truth);
    let own = recording.camera.with_correction(localizer.map().correction()).corrected_parameters();
    let mut failures = Vec::new();
    for (name, min_located, variant) in VARIANTS {
        let (mut n_within, mut n_right, mut n_beside, mut n_located, mut n_far) = (0, 0, 0, 0, 0);
        let mut errors = Vec::new();
        let begin = Instant::now();
        let mut n = 0;
        for frame in recording.frames[N_MAPPED..].iter().step_by(STEP) {
            let expected = true_pose(&truth, frame.timestamp_ns);
            let (image, camera) = variant(&read(&frame.path), &own);
            let found = localizer.locate(&image, &camera, None).expect("a camera");
            n += 1;
            let within = aligned.is_within_view(&expected);
            n_within += usize::from(within);
            let Some(pose) = &found.report.world_from_camera else { continue };
            let (shift, turn) = aligned.error(pose, &expected);
            n_located += usize::from(within);
            n_far += usize::from(shift > 0.5 || turn > 20.0);
            n_right += usize::from(within && shift <= MAX_ERROR.0 && turn <= MAX_ERROR.1);
            let beside = aligned.error_beside(pose, &expected);
            n_beside += usize::from(within && beside.0 <= MAX_ERROR.0 && beside.1 <= MAX_ERROR.1);
            errors.push(beside);
        }
        let median = |of: fn(&(f64, f64)) -> f64| {
            let mut values: Vec<f64> = errors.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
        };
        println!(
            "{name}: of {n_within} within view {n_located} located, {n_beside} right beside mapped frames, {n_right} \
             in the whole; {n_far} far off; median {:.3} m, {:.2} deg; {:.0} ms each",
            median(|error| error.0),
            median(|error| error.1),
            begin.elapsed().as_secs_f64() * 1e3 / n as f64
        );
        if (n_located as f64) < min_located * n_within as f64 || n_far > 0 {
            failures.push(name);
        }
    }
    let n_false = falsely_located(&mut localizer);
    assert!(failures.is_empty() && n_false == 0, "{failures:?}, {n_false} false");
}

/// Images of other recordings that were located nevertheless.
fn falsely_located(localizer: &mut Localizer) -> usize {
    let (mut n_false, mut n_asked) = (0, 0);
    let begin = Instant::now();
    for name in OTHERS {
        let folder = find_folder(name).unwrap_or_else(|missing| panic!("{missing}"));
        let recording = Recording::open(&folder, None).unwrap_or_else(|refused| panic!("{refused}"));
        let own = LocalizeCamera::Given(Box::new(recording.camera.clone()));
        for frame in recording.frames.iter().step_by(OTHERS_STEP) {
            let image = read(&frame.path);
            for camera in [&own, &LocalizeCamera::Unknown] {
                let found = localizer.locate(&image, camera, None).expect("a camera");
                n_asked += 1;
                if found.report.world_from_camera.is_some() {
                    n_false += 1;
                    let (n, sure) = (found.report.n_inlier_points, is_sure(&found));
                    println!("{name}: located by {n} points, sure: {sure}, {:?}", frame.path.file_name());
                }
            }
        }
    }
    println!(
        "{n_false} of {n_asked} false; {:.0} ms each",
        begin.elapsed().as_secs_f64() * 1e3 / n_asked as f64
    );
    n_false
}
