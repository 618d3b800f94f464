//! MCAP and bag files written by the Python packages `mcap` and `rosbags` (fixtures/bags/make.py).

use std::path::{Path, PathBuf};

use geometry::CameraModel;
use recordings::{Bag, FrameImage, FrameReader, PixelFormat, RawImage, TimedFrame};
use tempfile::TempDir;

const WIDTH: usize = 32;
const HEIGHT: usize = 24;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/bags").join(name)
}

/// The ramp that the script draws.
fn gray(i: usize) -> Vec<u8> {
    let pixel = |x: usize, y: usize| (5 * (x + i) + 3 * y) as u8;
    (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| pixel(x, y))).collect()
}

fn time_ns(i: i64) -> i64 {
    1_700_000_000_000_000_000 + 100_000_000 * i + 7_000_001 * (i % 2)
}

fn read(bag: &Bag) -> (Vec<TimedFrame>, Result<(), String>, Option<String>) {
    let mut reader = bag.frames().unwrap();
    let mut frames = Vec::new();
    loop {
        match reader.next_frame() {
            Ok(Some(frame)) => frames.push(frame),
            Ok(None) => return (frames, Ok(()), reader.remark()),
            Err(error) => return (frames, Err(error.to_string()), reader.remark()),
        }
    }
}

fn refusal(path: &Path, topic: Option<&str>) -> String {
    Bag::open(path, topic).expect_err("it is refused").to_string()
}

#[test]
fn a_camera_is_read_with_its_calibration_and_times() {
    for (name, topic, n_frames) in [
        ("camera.mcap", "/cam/image_raw", 5),
        ("camera.bag", "/left/image_raw", 5),
        ("rectified.mcap", "/cam/image_rect", 2),
    ] {
        let path = fixture(name);
        assert!(Bag::is_bag(&path));
        let bag = Bag::open(&path, None).unwrap();
        assert_eq!((bag.topic(), bag.n_images()), (topic, n_frames), "{name}");
        let (frames, outcome, remark) = read(&bag);
        assert_eq!((outcome, remark, frames.len()), (Ok(()), None, n_frames), "{name}");
        for (i, frame) in frames.iter().enumerate() {
            assert_eq!(frame.timestamp_ns, time_ns(i as i64), "{name}");
            let (width, height) = (WIDTH as u32, HEIGHT as u32);
            let image =
                RawImage { format: PixelFormat::Gray8, width, height, row_stride: width, data: gray(i) };
            assert_eq!(frame.image, FrameImage::Raw(image), "{name}");
        }
        let camera = bag.camera().unwrap().expect("it is calibrated").parameters().clone();
        let expected = match name {
            "camera.mcap" => (CameraModel::Radtan, 30.0, 31.0, 15.5, 5),
            "camera.bag" => (CameraModel::KannalaBrandt, 31.0, 32.0, 15.5, 4),
            // Of the projection, since the images are rectified.
            _ => (CameraModel::Pinhole, 28.0, 28.0, 15.0, 0),
        };
        assert_eq!(
            (camera.model, camera.fx, camera.fy, camera.cx, camera.distortion.len()),
            expected,
            "{name}"
        );
        assert_eq!((camera.width, camera.height), (32, 24));
    }
}

#[test]
fn several_topics_are_listed_and_one_is_chosen() {
    let path = fixture("two_cameras.bag");
    let refused = refusal(&path, None);
    assert!(
        refused.contains("choose one by --topic: /left/image_raw (3), /right/image_raw (3)"),
        "{refused}"
    );
    let refused = refusal(&path, Some("/middle"));
    assert!(
        refused.contains("no images of the topic /middle; there are some of /left/image_raw"),
        "{refused}"
    );
    let bag = Bag::open(&path, Some("/right/image_raw")).unwrap();
    assert_eq!(read(&bag).0.len(), 3);
    // Coefficients that are all zero are no distortion.
    let camera = bag.camera().unwrap().unwrap().parameters();
    assert_eq!((camera.model, camera.fx), (CameraModel::Pinhole, 32.0));
    let left = Bag::open(&path, Some("/left/image_raw")).unwrap();
    assert_eq!(read(&left).0.len(), 3);
    let refused = left.camera().unwrap_err().to_string();
    assert!(refused.contains("calibration of /left/camera_info: it is not calibrated"), "{refused}");
}

#[test]
fn every_encoding_is_read_or_refused_by_its_name() {
    for name in ["encodings.mcap", "packed.bag"] {
        let only = |topic: &str| {
            let bag = Bag::open(&fixture(name), Some(topic)).unwrap();
            assert!(bag.camera().unwrap().is_none());
            let (mut frames, outcome, _) = read(&bag);
            (frames.pop(), outcome)
        };
        let raw = |topic: &str| match only(topic).0.unwrap_or_else(|| panic!("{name} {topic}")).image {
            FrameImage::Raw(image) => image,
            FrameImage::Encoded(_) => panic!("pixels expected"),
        };
        let gray = gray(0);
        let padded = raw("/padded");
        assert_eq!((padded.row_stride, padded.format), (40, PixelFormat::Gray8));
        assert_eq!(padded.data[40..72], gray[32..64]);
        let mono16 = raw("/mono16");
        assert_eq!((mono16.format, mono16.row_stride), (PixelFormat::Gray16, 64));
        assert_eq!(mono16.data, gray.iter().flat_map(|p| [*p, *p]).collect::<Vec<_>>());
        let mono16_big = raw("/mono16_big");
        assert_eq!(mono16_big.data, gray.iter().flat_map(|p| [1, *p]).collect::<Vec<_>>());
        let rgb8 = raw("/rgb8");
        assert_eq!(
            (rgb8.format, rgb8.data),
            (PixelFormat::Rgb8, gray.iter().flat_map(|p| [*p; 3]).collect())
        );
        assert_eq!(raw("/bayer").data, vec![90; WIDTH * HEIGHT]);
        assert_eq!(raw("/yuv422").data, gray);
        for topic in ["/jpeg", "/png"] {
            let frame = only(topic).0.unwrap();
            assert_eq!(frame.image.size(), Some((32, 24)), "{topic}");
        }
        let (none, outcome) = only("/depth");
        let refused = outcome.unwrap_err();
        assert!(none.is_none() && refused.contains("an image of /depth: pixels as `32FC1`"), "{refused}");
        // Without a time in the header that of the log holds: it is the tenth message.
        assert_eq!(only("/no_stamp").0.unwrap().timestamp_ns, time_ns(0) + 9 * 50_000_000);
    }
}

/// A file with these bytes.
fn file(folder: &TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn a_file_that_ends_early_is_read_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["rectified.mcap", "camera.bag"] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        let whole = read(&Bag::open(&fixture(name), None).unwrap()).0;
        let mut n_read = 0;
        for share in 1..20 {
            let path = file(&folder, name, &bytes[..bytes.len() * share / 20]);
            match Bag::open(&path, None) {
                Err(error) => assert!(!error.to_string().is_empty()),
                Ok(bag) => {
                    let (frames, outcome, remark) = read(&bag);
                    assert_eq!((frames.len(), outcome), (bag.n_images(), Ok(())), "{name} {share}");
                    assert_eq!(frames[..], whole[..frames.len()], "{name} {share}");
                    let is_told = remark.is_some_and(|remark| remark.contains("ends early"));
                    assert!(is_told || frames.len() == whole.len(), "{name} {share}");
                    n_read += frames.len();
                }
            }
        }
        assert!(n_read > 0, "{name}");
    }
}

#[test]
fn damage_is_told_in_a_sentence_and_nothing_panics() {
    let folder = tempfile::tempdir().unwrap();
    let mut n_refused = 0;
    for name in ["camera.mcap", "encodings.mcap", "camera.bag", "two_cameras.bag", "packed.bag"] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for place in (0..bytes.len()).step_by(7) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0xff;
            let path = file(&folder, name, &damaged);
            match Bag::open(&path, Some("/jpeg")).or_else(|_| Bag::open(&path, None)) {
                Ok(bag) => drop(read(&bag)),
                Err(error) => {
                    let sentence = error.to_string();
                    assert!(
                        sentence.starts_with(path.to_str().unwrap()) && !sentence.contains('\n'),
                        "{sentence}"
                    );
                    n_refused += usize::from(sentence.contains("it is damaged"));
                }
            }
        }
    }
    assert!(n_refused > 100, "{n_refused}");
}

#[test]
fn what_is_no_such_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = file(&folder, "text.mcap", b"this is a text");
    assert!(Bag::is_bag(&text));
    assert!(
        refusal(&text, None).contains("neither an MCAP file nor a ROS 1 bag"),
        "{}",
        refusal(&text, None)
    );
    assert!(!Bag::is_bag(&file(&folder, "video.mp4", b"this is a video")));
    let renamed = file(&folder, "recording", &std::fs::read(fixture("camera.mcap")).unwrap());
    assert!(Bag::is_bag(&renamed));
    let empty = file(&folder, "empty.bag", b"#ROSBAG V2.0\n");
    assert!(refusal(&empty, None).contains("no images in it"));
}
