//! Each layout written to a temporary folder and read back, and real recordings.

use std::fs;
use std::path::Path;

use geometry::CameraModel;
use geometry::nalgebra::Vector3;

use super::*;

/// A temporary folder that is filled file by file.
pub(super) struct Folder(tempfile::TempDir);

impl Folder {
    pub(super) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(super) fn root(&self) -> &Path {
        self.0.path()
    }

    pub(super) fn file(&self, name: &str, content: &str) -> &Self {
        let path = self.root().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
        self
    }

    pub(super) fn image(&self, name: &str, width: u32, height: u32) -> &Self {
        let path = self.root().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::GrayImage::new(width, height).save(path).unwrap();
        self
    }
}

fn message(root: &Path, layout: Option<Layout>) -> String {
    Recording::open(root, layout).unwrap_err().to_string()
}

fn timestamps(recording: &Recording) -> Vec<i64> {
    recording.frames.iter().map(|frame| frame.timestamp_ns).collect()
}

const CALIBRATION: &str = r#"{"model": "radtan", "width": 8, "height": 6, "fx": 8, "fy": 8, "cx": 4, "cy": 3, "dist": [0.01, 0, 0, 0]}"#;

fn folder() -> Folder {
    let folder = Folder::new();
    folder
        .file(
            "rgb.txt",
            "# timestamp filename\n1.000000001 images/a.png\n1.1 images/b.png\n1.2 images/c.png\n",
        )
        .file("calib.json", CALIBRATION)
        .file("groundtruth.txt", "1.0 1 2 3 0 0 0 1\n");
    for name in ["a", "b", "c"] {
        folder.image(&format!("images/{name}.png"), 8, 6);
    }
    folder
}

#[test]
fn a_recording_is_played_otherwise() {
    let folder = folder();
    let played = |playback: Playback| Recording::open(folder.root(), None).unwrap().played(&playback);
    let names = |recording: &Recording| -> Vec<String> {
        let paths = recording.frames.iter().map(|frame| frame.path.file_stem().unwrap());
        paths.map(|name| name.to_string_lossy().into_owned()).collect()
    };
    let every = |n: usize| n.try_into().unwrap();

    let all = played(Playback::default()).unwrap();
    assert_eq!(names(&all), ["a", "b", "c"]);
    assert!(!all.name.contains('('), "{}", all.name);
    let thinned = played(Playback { every: every(2), ..Playback::default() }).unwrap();
    assert_eq!(names(&thinned), ["a", "c"]);
    assert!(thinned.name.ends_with(" (1 in 2)"), "{}", thinned.name);
    let cut = played(Playback { start: 1, end: Some(2), ..Playback::default() }).unwrap();
    assert_eq!(names(&cut), ["b"]);

    // The first image is seen at 1.000000001, its truth is for a nanosecond before: both move to the other
    // end.
    let back = played(Playback { backwards: true, ..Playback::default() }).unwrap();
    assert_eq!(names(&back), ["c", "b", "a"]);
    assert_eq!(timestamps(&back), [1_000_000_001, 1_100_000_001, 1_200_000_000]);
    assert_eq!(back.ground_truth.unwrap().poses()[0].timestamp_ns, 1_200_000_001);

    let error = played(Playback { start: 3, ..Playback::default() }).unwrap_err().to_string();
    assert!(error.contains("no frame is left of 3 (from frame 3)"), "{error}");
}

#[test]
fn a_folder_with_calib_json_is_read() {
    let folder = folder();
    let recording = Recording::open(folder.root(), None).unwrap();
    assert_eq!(recording.layout, Layout::Folder);
    assert_eq!(timestamps(&recording), [1_000_000_001, 1_100_000_000, 1_200_000_000]);
    assert_eq!(recording.camera.parameters().model, CameraModel::Radtan);
    assert_eq!(recording.ground_truth.as_ref().unwrap().len(), 1);
}

#[test]
fn mistakes_are_reported_with_file_and_line() {
    let folder = folder();
    folder.file("rgb.txt", "1.0 images/a.png\n1.0 images/b.png\n");
    let refused = message(folder.root(), None);
    assert!(
        refused.contains("rgb.txt:2: the time is not after that of the line before (--skip-bad"),
        "{refused}"
    );
    folder.file("rgb.txt", "1.0 images/a.png\n\n# c\n1.1 images/z.png\n");
    assert!(message(folder.root(), None).contains("rgb.txt:4: there is no image"));
    folder.file("rgb.txt", "one images/a.png\n");
    assert!(message(folder.root(), None).ends_with("rgb.txt:1: `one` is not a time"));
    folder.file("rgb.txt", "# nothing\n");
    assert!(message(folder.root(), None).contains("no images"));
    folder.file("rgb.txt", "1.0 images/a.png\n");
    folder.file("calib.json", "{\n\"width\": 8,\n\"hight\": 6}");
    assert!(message(folder.root(), None).contains("calib.json:3: unknown field `hight`"));
    folder.file("calib.json", &CALIBRATION.replace("\"fx\": 8", "\"fx\": -8"));
    assert!(message(folder.root(), None).contains("calib.json: fx must be a positive focal length"));
    folder.file("calib.json", &CALIBRATION.replace("\"width\": 8", "\"width\": 9"));
    assert!(message(folder.root(), None).contains("a.png: 8x6 pixels, but the camera is calibrated for 9x6"));
}

#[test]
fn tum_cameras_are_told_by_name_or_comment() {
    let folder = Folder::new();
    folder
        .image("rgb/1.png", 640, 480)
        .file("rgb.txt", "# file: 'rgbd_dataset_freiburg2_desk.bag'\n1.5 rgb/1.png\n");
    let recording = Recording::open(folder.root(), None).unwrap();
    assert_eq!((recording.layout, recording.camera.parameters().fx), (Layout::Tum, 520.9));
    assert!(recording.ground_truth.is_none());

    let named = folder.root().join("rgbd_dataset_freiburg3_office");
    fs::create_dir_all(named.join("rgb")).unwrap();
    fs::copy(folder.root().join("rgb/1.png"), named.join("rgb/1.png")).unwrap();
    fs::write(named.join("rgb.txt"), "1.5 rgb/1.png\n").unwrap();
    let recording = Recording::open(&named, None).unwrap();
    assert_eq!(recording.camera.parameters().model, CameraModel::Pinhole);
    assert_eq!(recording.name, "rgbd_dataset_freiburg3_office");

    folder.file("rgb.txt", "# file: 'rgbd_dataset_freiburg1_xyz.bag'\n1.5 rgb/1.png\n");
    assert_eq!(Recording::open(folder.root(), None).unwrap().camera.parameters().distortion.len(), 5);
    folder.file("rgb.txt", "1.5 rgb/1.png\n");
    assert!(message(folder.root(), None).contains("the camera is not known"));
}

const SENSOR: &str = "sensor_type: camera\n\
    # Sensor extrinsics wrt. the body-frame.\n\
    T_BS:\n  cols: 4\n  rows: 4\n  data: [0.0, -1.0, 0.0, 0.5,\n         1.0, 0.0, 0.0, 0.25,\n         \
    0.0, 0.0, 1.0, 0.0,\n         0.0, 0.0, 0.0, 1.0]\n\
    rate_hz: 20\nresolution: [8, 6]\ncamera_model: pinhole\nintrinsics: [8.0, 8.0, 4.0, 3.0] #fu, fv, cu, cv\n\
    distortion_model: radial-tangential\ndistortion_coefficients: [-0.01, 0.001, 0.0, 1.7e-05]\n";

#[test]
fn euroc_ground_truth_is_that_of_the_camera() {
    let folder = Folder::new();
    folder
        .image("mav0/cam0/data/1403636579763555584.png", 8, 6)
        .file(
            "mav0/cam0/data.csv",
            "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n",
        )
        .file("mav0/cam0/sensor.yaml", SENSOR)
        .file(
            "mav0/state_groundtruth_estimate0/data.csv",
            "#timestamp, p_RS_R_x [m], ...\n1403636579763555584,1,2,3,1,0,0,0,0,0,0\n",
        );
    let recording = Recording::open(folder.root(), None).unwrap();
    assert_eq!(recording.layout, Layout::Euroc);
    assert_eq!(timestamps(&recording), [1_403_636_579_763_555_584]);
    assert_eq!(recording.camera.parameters().distortion, [-0.01, 0.001, 0.0, 1.7e-05]);
    let world_from_camera = recording.ground_truth.unwrap().poses()[0].world_from_camera;
    assert!((world_from_camera.translation - Vector3::new(1.5, 2.25, 3.0)).norm() < 1e-12);
    assert!((world_from_camera.rotation * Vector3::x() - Vector3::y()).norm() < 1e-12);

    assert_eq!(Recording::open(&folder.root().join("mav0"), None).unwrap().layout, Layout::Euroc);
    folder.file("mav0/cam0/sensor.yaml", &SENSOR.replace("intrinsics: [8.0,", "intrinsics: [x,"));
    assert!(
        message(folder.root(), None).contains("sensor.yaml:13: `x` in `intrinsics` is not a finite number")
    );
    folder.file("mav0/cam0/sensor.yaml", &SENSOR.replace("radial-tangential", "division"));
    assert!(message(folder.root(), None).contains("`division` is not supported"));
}

#[test]
fn kitti_is_read_with_its_poses() {
    let folder = Folder::new();
    let sequence = folder.root().join("sequences/07");
    for i in 0..2 {
        folder.image(&format!("sequences/07/image_0/{i:06}.png"), 8, 6);
    }
    folder
        .file("sequences/07/times.txt", "0.000000e+00\n1.036224e-01\n")
        .file("sequences/07/calib.txt", "P0: 7.5 0 4 0 0 7.5 3 0 0 0 1 0\nP1: 7.5 0 4 -3 0 7.5 3 0 0 0 1 0\n")
        .file("poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2.5\n");
    let recording = Recording::open(&sequence, None).unwrap();
    assert_eq!((recording.layout, timestamps(&recording)), (Layout::Kitti, vec![0, 103_622_400]));
    assert_eq!(recording.camera.parameters().fx, 7.5);
    assert_eq!(recording.ground_truth.unwrap().poses()[1].world_from_camera.translation.z, 2.5);
    folder.file("sequences/07/times.txt", "0\n0.1\n0.2\n");
    assert!(message(&sequence, None).contains("times.txt:3: there is no image"));
    folder.file("sequences/07/times.txt", "0\n");
    assert!(message(&sequence, None).contains("07.txt: 2 poses for 1 images"));
}

#[test]
fn icl_numbers_become_times_and_its_poses_are_mirrored() {
    let folder = Folder::new();
    for i in 1..4 {
        folder.image(&format!("rgb/{i}.png"), 640, 480);
    }
    folder
        .file(
            "associations.txt",
            "1 depth/1.png 1 rgb/1.png\n2 depth/2.png 2 rgb/2.png\n3 depth/3.png 3 rgb/3.png\n",
        )
        .file("livingRoom0.gt.freiburg", "1 0 0 -2.25 0 0 0 1\n2 0.5 0.25 -2.5 0 0 0.6 0.8\n");
    let recording = Recording::open(folder.root(), None).unwrap();
    assert_eq!(recording.layout, Layout::Icl);
    assert_eq!(timestamps(&recording), [33_333_333, 66_666_666, 100_000_000]);
    let truth = recording.ground_truth.unwrap();
    assert_eq!(truth.poses()[1].timestamp_ns, 66_666_666);
    assert_eq!(truth.poses()[1].world_from_camera.translation, Vector3::new(0.5, -0.25, -2.5));
    assert!((truth.poses()[1].world_from_camera.rotation.k + 0.6).abs() < 1e-12);

    // Without a list the images are taken in the order of their numbers: 10 comes after 2.
    fs::remove_file(folder.root().join("associations.txt")).unwrap();
    fs::rename(folder.root().join("rgb/1.png"), folder.root().join("rgb/10.png")).unwrap();
    let recording = Recording::open(folder.root(), None).unwrap();
    assert_eq!(timestamps(&recording), [66_666_666, 100_000_000, 333_333_333]);
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = Folder::new();
    assert!(message(folder.root(), None).contains("no recording of a known layout"));
    assert!(message(&folder.root().join("absent"), None).contains("absent"));
    assert!(message(folder.root(), Some(Layout::Kitti)).contains("times.txt"));
    assert!("tartan".parse::<Layout>().unwrap_err().contains("folder, euroc, kitti, tum, icl"));
    for layout in Layout::ALL {
        assert_eq!(layout.name().parse(), Ok(layout));
    }
}

#[test]
#[ignore = "needs recordings: set MONOSLAM_DATA"]
fn real_recordings_are_read() {
    for (name, n_frames, model) in [
        ("7scenes_redkitchen", 1000, CameraModel::Pinhole),
        ("euroc_v1_01_part_b", 90, CameraModel::Radtan),
        ("icl_of_kt0_first101", 101, CameraModel::Pinhole),
        ("kitti_snippet_2", 51, CameraModel::Pinhole),
        ("pov_office", 720, CameraModel::Pinhole),
    ] {
        let root = crate::find_folder(name).unwrap_or_else(|missing| panic!("{missing}"));
        let recording = Recording::open(&root, None).unwrap();
        assert_eq!((recording.layout, recording.frames.len()), (Layout::Folder, n_frames), "{name}");
        assert_eq!((recording.name.as_str(), recording.camera.parameters().model), (name, model));
        assert!(recording.ground_truth.is_some_and(|truth| !truth.is_empty()), "{name}");
    }
}
