//! Recordings as people bring them: lists of other programs and systems, pictures without a list,
//! calibrations of other programs.

use std::fs;
use std::path::Path;

use geometry::CameraModel;

use super::tests::Folder;
use super::*;
use crate::units::TimeUnit;

const CALIBRATION: &str = r#"{"width": 8, "height": 6, "fx": 8, "fy": 8, "cx": 4, "cy": 3}"#;

/// A recording of three pictures, `images/1.png` to `3.png`, with this list.
fn listed(list: impl AsRef<[u8]>) -> Folder {
    let folder = Folder::new();
    for i in 1..=3 {
        folder.image(&format!("images/{i}.png"), 8, 6);
    }
    folder.file("calib.json", CALIBRATION);
    fs::write(folder.root().join("rgb.txt"), list).unwrap();
    folder
}

fn open(root: &Path, options: OpenOptions<'_>) -> Result<Recording, String> {
    Recording::open_with(root, &options).map_err(|error| error.to_string())
}

fn times_ms(recording: &Recording) -> Vec<i64> {
    recording.frames.iter().map(|frame| frame.timestamp_ns / 1_000_000).collect()
}

#[test]
fn lists_are_read_however_they_are_written() {
    let utf16 = |text: &str| {
        [&[0xFF, 0xFE][..], &text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<_>>()].concat()
    };
    for list in [
        b"0.0 images/1.png\n0.1 images/2.png\n0.2 images/3.png\n".to_vec(),
        b"\xEF\xBB\xBF0.0 images/1.png\r\n0.1 images/2.png\r\n\r\n0.2 images/3.png".to_vec(),
        utf16("0.0 images/1.png\r\n0.1 images/2.png\r\n0.2 images/3.png\r\n"),
        b"timestamp,filename\n0.0,images/1.png\n0.1, images/2.png\n0.2,images/3.png,extra\n".to_vec(),
        b"time;file\n0.0;images/1.png\n0.1;images/2.png;\n0.2;images/3.png\n".to_vec(),
        b"timestamp [s]\tfile name\n0.0\timages/1.png\n0.1\timages/2.png\tdepth/2.png\n0.2\timages/3.png\n"
            .to_vec(),
        b"0.0 \"images/1.png\"\n0.1 images\\2.png\n0.2   images/3.png   0.2 depth/3.png\n".to_vec(),
        b"\"time\",\"file\"\n\"0.0\",\"images/1.png\"\n\"0.1\",\"images/2.png\"\n\"0.2\",\"images/3.png\"\n"
            .to_vec(),
    ] {
        let folder = listed(&list);
        let recording =
            open(folder.root(), OpenOptions::default()).unwrap_or_else(|refused| panic!("{refused}"));
        assert_eq!(times_ms(&recording), [0, 100, 200], "{}", String::from_utf8_lossy(&list));
        assert!(recording.frames[1].path.ends_with("images/2.png"));
    }
}

#[test]
fn names_may_have_blanks() {
    let folder = Folder::new();
    folder.image("my images/frame 001.png", 8, 6).image("my images/frame 002.png", 8, 6);
    folder.file("calib.json", CALIBRATION);
    folder.file("rgb.txt", "0.0 my images/frame 001.png\n0.1 my images/frame 002.png\n");
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert!(recording.frames[1].path.ends_with("my images/frame 002.png"));
    folder.file("rgb.txt", "0.0 my images/frame 001.png\n0.1 my images/frame 003.png\n");
    let refused = open(folder.root(), OpenOptions::default()).unwrap_err();
    assert!(refused.contains("rgb.txt:2") && refused.contains("my images/frame 003.png"), "{refused}");
}

#[test]
fn units_of_times_are_recognized_told_and_overruled() {
    for (times, unit) in [
        (["1403715285262142976", "1403715285312143104", "1403715285362143232"], "nanoseconds"),
        (["0", "50000", "100000"], "microseconds"),
        (["0", "50", "100"], "milliseconds"),
    ] {
        let lines = times.iter().zip(1..).map(|(time, i)| format!("{time} images/{i}.png\n"));
        let folder = listed(lines.collect::<String>());
        let recording = open(folder.root(), OpenOptions::default()).unwrap();
        let step_ms = (recording.frames[1].timestamp_ns - recording.frames[0].timestamp_ns) / 1_000_000;
        assert_eq!(step_ms, 50, "{unit}");
        assert!(recording.remarks[0].contains(unit), "{:?}", recording.remarks);
    }
    let folder = listed("0 images/1.png\n1 images/2.png\n2 images/3.png\n");
    let counted = open(folder.root(), OpenOptions::default()).unwrap();
    assert!(counted.remarks[0].contains("one frame a second"), "{:?}", counted.remarks);
    assert_eq!(times_ms(&counted), [0, 1000, 2000]);
    let frames = OpenOptions { times: Some(TimeUnit::Frames), ..OpenOptions::default() };
    let refused = open(folder.root(), frames).unwrap_err();
    assert!(refused.contains("--fps"), "{refused}");
    let recording = open(folder.root(), OpenOptions { fps: Some(10.0), ..frames }).unwrap();
    assert_eq!((times_ms(&recording), recording.remarks.len()), (vec![0, 100, 200], 0));
}

#[test]
fn lists_out_of_order_are_sorted_or_thinned_when_asked() {
    let folder = listed("0.1 images/2.png\n0.0 images/1.png\n0.1 images/2.png\n0.2 images/3.png\n");
    let refused = open(folder.root(), OpenOptions::default()).unwrap_err();
    assert!(refused.contains("rgb.txt:2") && refused.contains("--sort"), "{refused}");
    let sorted = open(folder.root(), OpenOptions { sort: true, ..OpenOptions::default() }).unwrap();
    assert_eq!(times_ms(&sorted), [0, 100, 200]);
    let thinned = open(folder.root(), OpenOptions { skip_bad: true, ..OpenOptions::default() }).unwrap();
    assert_eq!(times_ms(&thinned), [100, 200]);
    assert!(thinned.remarks[0].contains("2 lines are left out: "), "{:?}", thinned.remarks);
    // Two pictures of one time are not the same twice.
    let folder = listed("0.0 images/1.png\n0.0 images/2.png\nx\n0.1 images/9.png\n0.2 images/3.png\n");
    let refused = open(folder.root(), OpenOptions { sort: true, ..OpenOptions::default() }).unwrap_err();
    assert!(refused.contains("rgb.txt:3"), "{refused}");
    let both = OpenOptions { sort: true, skip_bad: true, ..OpenOptions::default() };
    let recording = open(folder.root(), both).unwrap();
    assert_eq!(times_ms(&recording), [0, 200]);
    assert!(recording.remarks[0].contains("3 lines"), "{:?}", recording.remarks);
    let turned = listed("images/1.png 0.0\nimages/2.png 0.1\n");
    let refused = open(turned.root(), OpenOptions::default()).unwrap_err();
    assert!(refused.contains("the time comes first"), "{refused}");
}

#[test]
fn pictures_without_a_list_come_at_a_rate() {
    let folder = Folder::new();
    for i in [1, 2, 10, 9] {
        folder.image(&format!("{i}.png"), 8, 6);
    }
    folder.file("notes.md", "no picture");
    let refused = open(folder.root(), OpenOptions::default()).unwrap_err();
    assert!(refused.contains("--fps") && refused.contains("rgb.txt"), "{refused}");
    let rate = OpenOptions { fps: Some(20.0), ..OpenOptions::default() };
    let refused = open(folder.root(), rate).unwrap_err();
    assert!(refused.contains("calib.json") && refused.contains("--fov"), "{refused}");
    folder.file("calib.json", CALIBRATION);
    let recording = open(folder.root(), rate).unwrap();
    assert_eq!((recording.layout, times_ms(&recording)), (Layout::Pictures, vec![0, 50, 100, 150]));
    assert!(recording.frames[3].path.ends_with("10.png"));

    // In a folder of their own, with names that are times, of a camera that is given.
    let folder = Folder::new();
    folder.image("data/1403715285262142976.png", 8, 6).image("data/1403715285312143104.png", 8, 6);
    let of_size = |(width, height): (u32, u32)| {
        let text = format!(r#"{{"width": {width}, "height": {height}, "fx": 9, "fy": 9, "cx": 4, "cy": 3}}"#);
        let path = folder.root().join("given.json");
        fs::write(&path, text).unwrap();
        crate::read_calibration(&path)
    };
    let recording =
        open(folder.root(), OpenOptions { camera: Some(&of_size), ..OpenOptions::default() }).unwrap();
    assert_eq!(recording.frames[1].timestamp_ns, 1_403_715_285_312_143_104);
    assert_eq!(recording.camera.parameters().fx, 9.0);
}

const BLOCK: &str = "rate_hz: 20\nresolution:\n- 8\n- 6\ncamera_model: pinhole\nintrinsics:\n- 8.0\n- 8.0\n- 4.0\n- 3.0\n\
    distortion_model: radial-tangential\ndistortion_coefficients:\n- -0.01\n- 0.001\n- 0.0\n- 1.7e-05\n";
const KALIBR: &str = "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.01, 0.001, 0.0, 1.7e-05]\n  \
    distortion_model: radtan\n  intrinsics: [8.0, 8.0, 4.0, 3.0]\n  resolution: [8, 6]\n  T_cam_imu:\n  - [1, 0, 0, -0.5]\n  \
    - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\ncam1:\n  camera_model: omni\n";

fn vehicle(calibration: &str, text: &str) -> Folder {
    let folder = Folder::new();
    folder.image("mav0/cam0/data/1403636579763555584.png", 8, 6);
    folder.file(
        "mav0/cam0/data.csv",
        "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n",
    );
    folder.file(calibration, text);
    folder
}

#[test]
fn vehicles_have_their_calibration_in_many_forms() {
    for (place, text) in [
        ("mav0/cam0/sensor.yaml", BLOCK),
        ("mav0/cam0/sensor.yaml", KALIBR),
        ("mav0/cam0/camchain.yaml", KALIBR),
        ("camchain.yaml", KALIBR),
        ("dso/camchain.yaml", KALIBR),
    ] {
        let folder = vehicle(place, text);
        let recording = open(folder.root(), OpenOptions::default())
            .unwrap_or_else(|refused| panic!("{place}: {refused}"));
        assert_eq!(recording.camera.parameters().distortion, [-0.01, 0.001, 0.0, 1.7e-05], "{place}");
        assert_eq!(recording.frames[0].timestamp_ns, 1_403_636_579_763_555_584);
        assert!(recording.ground_truth.is_none());
    }
    // TUM-VI: the truth is that of the body, Kalibr has the camera's place on it.
    let folder = vehicle("dso/camchain.yaml", KALIBR);
    let truth = "#timestamp [ns], p_RS_R_x [m], q_RS_w [], q_RS_x []\n1403636579763555584,1,2,3,1,0,0,0\n";
    folder.file("mav0/mocap0/data.csv", truth);
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert_eq!(recording.ground_truth.unwrap().poses()[0].world_from_camera.translation.x, 1.5);
    // Without the camera's place there is no truth of it, and that is said.
    let folder = vehicle("mav0/cam0/sensor.yaml", BLOCK);
    folder.file("mav0/mocap0/data.csv", truth);
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert!(
        recording.ground_truth.is_none() && recording.remarks[0].contains("T_BS"),
        "{:?}",
        recording.remarks
    );

    let refused =
        |text: &str| open(vehicle("mav0/cam0/sensor.yaml", text).root(), OpenOptions::default()).unwrap_err();
    assert!(
        refused("camera_model: spline\nresolution: [8, 6]\nintrinsics: [8, 8, 4, 3]\n")
            .contains("sensor.yaml:1: camera_model `spline`")
    );
    let short = refused("camera_model: ds\nresolution: [8, 6]\nintrinsics: [8, 8, 4, 3]\n");
    assert!(short.contains("sensor.yaml:") && short.contains("ds cannot have 4 numbers"), "{short}");
    assert!(refused("resolution: [8, 6]\n").contains("there is no `intrinsics:`"));
    assert!(refused("resolution: [8, 6\n").contains("sensor.yaml:"));
    let folder = vehicle("unused", "");
    let refused = open(folder.root(), OpenOptions::default()).unwrap_err();
    assert!(refused.contains("sensor.yaml") && refused.contains("camchain"), "{refused}");
}

#[test]
fn kitti_is_read_in_color_and_as_jpeg() {
    let folder = Folder::new();
    for i in 0..2 {
        folder.image(&format!("image_2/{i:06}.jpg"), 8, 6);
    }
    let calibration =
        "P0: 7 0 4 0 0 7 3 0 0 0 1 0\nP1: 7 0 4 0 0 7 3 0 0 0 1 0\nP2: 7.5 0 4 0.75 0 7.5 3 0 0 0 1 0\n";
    folder.file("times.txt", "0.000000e+00\n1.036224e-01\n").file("calib.txt", calibration);
    folder.file("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2.5\n");
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert_eq!((recording.layout, recording.camera.parameters().fx), (Layout::Kitti, 7.5));
    // P2 = K [I | t] with t = 0.1 in x: the color camera is a tenth to the left of the gray one.
    let position = recording.ground_truth.unwrap().poses()[1].world_from_camera.translation;
    assert!((position.x + 0.1).abs() < 1e-12 && (position.z - 2.5).abs() < 1e-12, "{position}");
    folder.file("calib.txt", "P0: 7 0 4 0 0 7 3 0 0 0 1 0\n");
    assert!(open(folder.root(), OpenOptions::default()).unwrap_err().contains("there is no line `P2:`"));
}

#[test]
fn seven_scenes_and_scannet_are_read_with_their_poses() {
    let pose = "1 0 0 0.5\n0 1 0 0\n0 0 1 2\n0 0 0 1\n";
    let folder = Folder::new();
    for i in 0..2 {
        folder.image(&format!("frame-{i:06}.color.png"), 640, 480).image(
            &format!("frame-{i:06}.depth.png"),
            640,
            480,
        );
        folder.file(&format!("frame-{i:06}.pose.txt"), pose);
    }
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert_eq!((recording.layout, times_ms(&recording)), (Layout::SevenScenes, vec![0, 33]));
    assert_eq!((recording.camera.parameters().fx, recording.ground_truth.unwrap().len()), (585.0, 2));

    let folder = Folder::new();
    for i in [0, 1, 10] {
        folder.image(&format!("color/{i}.jpg"), 8, 6).file(&format!("pose/{i}.txt"), pose);
    }
    folder.file(
        "pose/1.txt",
        "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n",
    );
    folder.file("intrinsic/intrinsic_color.txt", "8 0 4 0\n0 8 3 0\n0 0 1 0\n0 0 0 1\n");
    let recording = open(folder.root(), OpenOptions::default()).unwrap();
    assert_eq!((recording.layout, recording.frames.len()), (Layout::ScanNet, 3));
    assert!(recording.frames[2].path.ends_with("10.jpg"));
    let truth = recording.ground_truth.unwrap();
    assert_eq!((truth.len(), truth.poses()[1].timestamp_ns), (2, recording.frames[2].timestamp_ns));
    folder.file("pose/0.txt", "1 0 0\n");
    assert!(open(folder.root(), OpenOptions::default()).unwrap_err().contains("0.txt: four rows"));
}

#[test]
fn calibrations_of_other_programs_are_read() {
    let folder = Folder::new();
    let read = |name: &str, text: &str| {
        folder.file(name, text);
        let camera = crate::read_calibration(&folder.root().join(name)).map_err(|error| error.to_string())?;
        let p = camera.parameters().clone();
        Ok::<_, String>((p.model, p.fx, p.cx, p.distortion))
    };
    let opencv = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   \
        dt: d\n   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   \
        cols: 5\n   dt: d\n   data: [ 0.1, -0.2, 0., 0., 0.05 ]\n";
    let expected = (CameraModel::Radtan, 500.0, 320.0, vec![0.1, -0.2, 0.0, 0.0, 0.05]);
    assert_eq!(read("opencv.yml", opencv), Ok(expected.clone()));
    let ros = "image_width: 640\nimage_height: 480\ncamera_name: usb\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [500, 0, 320, 0, 501, 240, 0, 0, 1]\n\
        distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0.1, -0.2, 0, 0, 0.05]\n";
    assert_eq!(read("ros.yaml", ros), Ok(expected));
    let colmap = "# Camera list\n1 SIMPLE_RADIAL 640 480 500 320.5 240.5 0.1\n";
    assert_eq!(
        read("cameras.txt", colmap),
        Ok((CameraModel::Radtan, 500.0, 320.0, vec![0.1, 0.0, 0.0, 0.0]))
    );
    let json = |dist: &str, model: &str| {
        format!(
            r#"{{{model} "width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240, "dist": {dist}}}"#
        )
    };
    let fourteen = json("[0.1, -0.2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]", r#""model": "radtan","#);
    assert_eq!(read("calib.json", &fourteen).unwrap().3, [0.1, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(
        read("calib.json", &json("[0, 0, 0, 0, 0]", r#""model": "radtan","#)).unwrap().0,
        CameraModel::Pinhole
    );
    let refused = read("calib.json", &json("[0.1, 0, 0, 0]", "")).unwrap_err();
    assert!(refused.contains("`model`") && refused.contains("radtan"), "{refused}");
    let prism = json("[0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0.01, 0, 0]", r#""model": "radtan","#);
    assert!(read("calib.json", &prism).unwrap_err().contains("thin prism"));
    let tilt = json("[0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.01, 0]", r#""model": "radtan","#);
    assert!(read("calib.json", &tilt).unwrap_err().contains("tilted"));
}

#[test]
fn kalibrs_spheres_are_read_as_ours() {
    use geometry::CameraModel;
    let read = |model: &str, intrinsics: &str, distortion: &str| {
        let text = format!(
            "cam0:\n  camera_model: {model}\n  distortion_coeffs: {distortion}\n  distortion_model: none\n  intrinsics: \
             {intrinsics}\n  resolution: [8, 6]\n"
        );
        let folder = vehicle("mav0/cam0/sensor.yaml", &text);
        open(folder.root(), OpenOptions::default()).map(|recording| recording.camera.parameters().clone())
    };
    let ds = read("ds", "[-0.2, 0.6, 4.0, 4.1, 3.9, 3.0]", "[]").unwrap();
    assert_eq!(
        (ds.model, ds.distortion, ds.fx, ds.cy),
        (CameraModel::DoubleSphere, vec![-0.2, 0.6], 4.0, 3.0)
    );
    let eucm = read("eucm", "[0.6, 1.1, 4.0, 4.1, 3.9, 3.0]", "[]").unwrap();
    assert_eq!((eucm.model, eucm.distortion), (CameraModel::ExtendedUnified, vec![0.6, 1.1]));
    // Mei's ξ of 1: f (1 + ξ) / (ξ d + z) is (f / 2) / (d / 2 + z / 2).
    let omni = read("omni", "[1.0, 8.0, 8.0, 4.0, 3.0]", "[0.0, 0.0]").unwrap();
    assert_eq!((omni.model, omni.distortion, omni.fx), (CameraModel::ExtendedUnified, vec![0.5, 1.0], 4.0));
    let refused = read("omni", "[1.0, 8.0, 8.0, 4.0, 3.0]", "[0.1, 0.0]").unwrap_err().to_string();
    assert!(refused.contains("`omni` with a distortion"), "{refused}");
    let refused = read("ds", "[4.0, 4.1, 3.9, 3.0]", "[]").unwrap_err().to_string();
    assert!(refused.contains("cannot have 4 numbers"), "{refused}");
}
