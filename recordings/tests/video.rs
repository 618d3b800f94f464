//! Videos made and read by the installed `ffmpeg`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use recordings::{Ffmpeg, FileError, FrameImage, FrameReader, FrameTimes, TimedFrame, VideoInput, read_pipe};
use tempfile::TempDir;

/// Makes a file by `ffmpeg` from these arguments.
fn made(folder: &TempDir, name: &str, arguments: &[&str]) -> PathBuf {
    let path = folder.path().join(name);
    let status = Command::new("ffmpeg").args(["-v", "error", "-y"]).args(arguments).arg(&path).status();
    assert!(status.expect("ffmpeg runs").success(), "{arguments:?}");
    path
}

/// A second of a test picture of 64x48 pixels at ten frames a second, without loss.
fn steady(folder: &TempDir, name: &str) -> PathBuf {
    made(folder, name, &["-f", "lavfi", "-i", "testsrc=size=64x48:rate=10:duration=1", "-qp", "0"])
}

/// All frames, and how reading ended.
fn read(mut reader: impl FrameReader) -> (Vec<TimedFrame>, Option<FileError>, Option<String>) {
    let mut frames = Vec::new();
    let error = loop {
        match reader.next_frame() {
            Ok(Some(frame)) => frames.push(frame),
            Ok(None) => break None,
            Err(error) => break Some(error),
        }
    };
    (frames, error, reader.remark())
}

fn read_file(path: &Path) -> (Vec<TimedFrame>, Option<FileError>, Option<String>) {
    read(Ffmpeg::find().unwrap().open(VideoInput::File(path.to_owned())).unwrap())
}

fn times_ms(frames: &[TimedFrame]) -> Vec<i64> {
    frames.iter().map(|frame| frame.timestamp_ns / 1_000_000).collect()
}

#[test]
#[ignore = "needs ffmpeg"]
fn frames_come_gray_and_at_the_times_of_the_container() {
    let folder = tempfile::tempdir().unwrap();
    // Every third of five frames is missing, as in the dark of a phone.
    let arguments = ["-f", "lavfi", "-i", "testsrc=size=64x48:rate=10:duration=1.5", "-vf"];
    let select = ["select='not(eq(mod(n,5),3))'", "-fps_mode", "vfr", "-qp", "0"];
    for name in ["variable.mp4", "variable.mkv", "-odd: name.mp4"] {
        let video = made(&folder, name, &[&arguments[..], &select].concat());
        let (frames, error, remark) = read_file(&video);
        assert!(error.is_none() && remark.is_none(), "{error:?} {remark:?}");
        assert_eq!(
            times_ms(&frames),
            [0, 100, 200, 400, 500, 600, 700, 900, 1000, 1100, 1200, 1400],
            "{name}"
        );
        let FrameImage::Raw(image) = &frames[0].image else { panic!("pixels") };
        assert_eq!((image.width, image.height, image.data.len()), (64, 48, 64 * 48));
        // The test picture has all gray values.
        assert!(image.data.iter().any(|p| *p < 20) && image.data.iter().any(|p| *p > 230));
        assert_ne!(frames[0], frames[11]);
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn times_are_exact_where_they_are_no_milliseconds() {
    let folder = tempfile::tempdir().unwrap();
    let source = "testsrc=size=64x48:rate=30000/1001:duration=2";
    let video = made(&folder, "ntsc.mp4", &["-f", "lavfi", "-i", source]);
    let (frames, ..) = read_file(&video);
    let expected = (0..frames.len()).map(|i| (1e9 * i as f64 * 1001.0 / 30000.0).round() as i64);
    assert_eq!(
        frames.iter().map(|frame| frame.timestamp_ns).collect::<Vec<_>>(),
        expected.collect::<Vec<_>>()
    );
    assert_eq!(frames.len(), 60);
}

#[test]
#[ignore = "needs ffmpeg"]
fn images_are_turned_as_the_rotation_tag_says() {
    let folder = tempfile::tempdir().unwrap();
    let upright = steady(&folder, "upright.mp4");
    let upright_name = upright.to_str().unwrap();
    let turned =
        made(&folder, "turned.mp4", &["-i", upright_name, "-c", "copy", "-metadata:s:v:0", "rotate=90"]);
    let (upright, ..) = read_file(&upright);
    let (turned, ..) = read_file(&turned);
    let (FrameImage::Raw(upright), FrameImage::Raw(turned)) = (&upright[0].image, &turned[0].image) else {
        panic!("pixels")
    };
    assert_eq!((turned.width, turned.height), (48, 64));
    let at = |x: usize, y: usize| upright.data[y * 64 + x];
    let turned_at = |x: usize, y: usize| turned.data[y * 48 + x];
    // A quarter turn either way: the corners wander.
    let corners = [at(0, 0), at(63, 0), at(63, 47), at(0, 47)];
    let wandered = [turned_at(47, 0), turned_at(47, 63), turned_at(0, 63), turned_at(0, 0)];
    let back = [turned_at(0, 63), turned_at(0, 0), turned_at(47, 0), turned_at(47, 63)];
    assert!(corners == wandered || corners == back, "{corners:?} {wandered:?} {back:?}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_truncated_video_gives_what_is_there_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let whole = steady(&folder, "whole.mkv");
    let bytes = fs::read(&whole).unwrap();
    let cut = folder.path().join("cut.mkv");
    fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let (frames, error, remark) = read_file(&cut);
    assert!(!frames.is_empty() && frames.len() < 10, "{}", frames.len());
    let said = error.map(|error| error.to_string()).or(remark).expect("it is told");
    assert!(said.contains("cut.mkv") && said.contains("ffmpeg"), "{said}");

    // An MP4 file has its index at the end.
    let whole = steady(&folder, "whole.mp4");
    let bytes = fs::read(&whole).unwrap();
    let cut = folder.path().join("cut.mp4");
    fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let (frames, error, _) = read_file(&cut);
    let said = error.expect("it cannot be read").to_string();
    assert!(frames.is_empty() && said.contains("cut.mp4: ffmpeg cannot read it: moov atom"), "{said}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn what_is_no_video_is_refused_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let sound = made(&folder, "sound.wav", &["-f", "lavfi", "-i", "sine=duration=0.1"]);
    let (_, error, _) = read_file(&sound);
    assert_eq!(error.unwrap().to_string(), format!("{}: there is no video in it", sound.display()));
    let text = folder.path().join("text.mp4");
    fs::write(&text, "this is no video").unwrap();
    let said = read_file(&text).1.unwrap().to_string();
    assert!(said.contains("text.mp4: ffmpeg cannot read it: ") && !said.contains('\n'), "{said}");
    let absent = folder.path().join("absent.mp4");
    let said = read_file(&absent).1.unwrap().to_string();
    assert!(said.contains("No such file"), "{said}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_video_whose_images_change_their_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let small = made(
        &folder,
        "small.ts",
        &["-f", "lavfi", "-i", "testsrc=size=64x48:rate=10:duration=1", "-c:v", "mpeg2video"],
    );
    let large = made(
        &folder,
        "large.ts",
        &["-f", "lavfi", "-i", "testsrc=size=96x64:rate=10:duration=1", "-c:v", "mpeg2video"],
    );
    let joined = folder.path().join("joined.ts");
    fs::write(&joined, [fs::read(small).unwrap(), fs::read(large).unwrap()].concat()).unwrap();
    let (frames, error, _) = read_file(&joined);
    assert!(!frames.is_empty());
    let said = error.expect("it is refused").to_string();
    assert!(said.contains("change from 64x48 to 96x64"), "{said}");
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_video_comes_through_a_pipe_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let video = steady(&folder, "piped.mkv");
    let (from_file, ..) = read_file(&video);
    let pipe = Box::new(fs::File::open(&video).unwrap());
    let mut reader = read_pipe(pipe, FrameTimes::Arrival).unwrap();
    let mut from_pipe = Vec::new();
    while let Some(frame) = reader.next_frame().unwrap() {
        from_pipe.push(frame);
    }
    assert_eq!(from_pipe.len(), 10);
    assert_eq!(from_pipe, from_file);
}

/// Processes that have a word among their arguments.
#[cfg(target_os = "linux")]
fn processes_with(word: &str) -> usize {
    let of = |entry: std::io::Result<fs::DirEntry>| fs::read(entry.ok()?.path().join("cmdline")).ok();
    let command_lines = fs::read_dir("/proc").unwrap().filter_map(of);
    command_lines.filter(|line| String::from_utf8_lossy(line).contains(word)).count()
}

#[test]
#[ignore = "needs ffmpeg"]
#[cfg(target_os = "linux")]
fn the_child_ends_with_its_reader() {
    let folder = tempfile::tempdir().unwrap();
    let source = "testsrc=size=320x240:rate=30:duration=60";
    let video = made(&folder, "long-enough-to-be-left.mp4", &["-f", "lavfi", "-i", source]);
    let mut reader = Ffmpeg::find().unwrap().open(VideoInput::File(video)).unwrap();
    assert!(reader.next_frame().unwrap().is_some());
    assert_eq!(processes_with("long-enough-to-be-left.mp4"), 1);
    let started = Instant::now();
    drop(reader);
    assert_eq!(processes_with("long-enough-to-be-left.mp4"), 0);
    assert!(started.elapsed() < Duration::from_secs(5));
}
