//! The command `monoslam stream` on videos, pipes and bags, against a real server, with the installed
//! `ffmpeg`.

mod stage;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use client::HttpClient;
use stage::{Stage, refusal, summary, text};

/// Rendered frames of a room: enough for a map.
const N_FRAMES: usize = 60;

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn a_video_becomes_a_map_at_its_own_times_and_is_gone_on_with() {
    let stage = Stage::set(N_FRAMES).await;
    let select = ["-vf", "select='not(eq(mod(n,5),3))'", "-fps_mode", "vfr", "-qp", "0"];
    let video = stage.make("room.mkv", &select).await;
    let calibration = stage.path("room/calib.json");
    let options = ["--camera", text(&calibration), "--deterministic", "--seed", "1"];

    // The first half, then the whole: the session has the first half already.
    let half = [&options[..], &["--end", "24"]].concat();
    let first = summary(&stage.stream(text(&video), "video", &half).output().await.unwrap());
    assert_eq!(first["frames"], 24);
    let output = stage.stream(text(&video), "video", &options).output().await.unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("has 24 of these frames already"), "{said}");
    let rest = summary(&output);
    assert_eq!((rest["frames"].as_u64(), rest["rejected"].as_u64()), (Some(24), Some(0)));
    assert!(rest["tracked"].as_u64() > Some(20), "{rest}");

    let http = HttpClient::new(format!("http://{}", stage.running.http_addr)).unwrap();
    let trajectory = http.trajectory("video").await.unwrap();
    assert!(trajectory.len() > 40, "{}", trajectory.len());
    for pose in trajectory.poses() {
        // A Matroska file counts in milliseconds.
        let number = (pose.timestamp_ns as f64 * 1e-9 * 30.0).round();
        assert!((pose.timestamp_ns as f64 * 1e-9 - number / 30.0).abs() < 1e-3);
        assert_ne!(number as u64 % 5, 3, "a frame that was left out has a pose");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn images_come_through_standard_input() {
    let stage = Stage::set(20).await;
    let mjpeg = stage.make("room.mjpeg", &["-q:v", "2"]).await;
    let gray = stage.make("room.gray", &["-f", "rawvideo", "-pix_fmt", "gray"]).await;
    let calibration = stage.path("room/calib.json");
    let options = ["--camera", text(&calibration), "--fps", "30"];
    for (file, session, more) in [(mjpeg, "mjpeg", &[][..]), (gray, "gray", &["--raw", "640x480"])] {
        let options = [&options[..], more].concat();
        let mut command = stage.stream("-", session, &options);
        command.arg("--policy").arg("lossless").stdin(fs::File::open(file).unwrap());
        let summary = summary(&command.output().await.unwrap());
        assert_eq!(
            (summary["frames"].as_u64(), summary["dropped"].as_u64()),
            (Some(20), Some(0)),
            "{session}"
        );
        assert!(summary["tracked"].as_u64() > Some(5), "{summary}");
        assert!((summary["recorded_s"].as_f64().unwrap() - 20.0 / 30.0).abs() < 1e-6, "{summary}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bag_is_streamed_with_its_own_calibration() {
    let stage = Stage::set(1).await;
    let bags = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/tests/fixtures/bags");
    let two_cameras = bags.join("two_cameras.bag");
    let said = refusal(&stage.stream(text(&two_cameras), "bag", &[]).output().await.unwrap());
    assert!(said.contains("choose one by --topic: /left/image_raw (3), /right/image_raw (3)"), "{said}");
    // Images of 32x24 pixels are smaller than a server takes, so nothing but the way there is seen.
    let right = ["--topic", "/right/image_raw"];
    let said = refusal(&stage.stream(text(&two_cameras), "bag", &right).output().await.unwrap());
    assert!(said.contains("width"), "{said}");
    let said = refusal(&stage.stream("-", "bag", &right).output().await.unwrap());
    assert!(said.contains("--topic is for MCAP files and bags"), "{said}");
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
async fn what_is_wrong_is_said_in_a_sentence() {
    let stage = Stage::set(4).await;
    let video = stage.make("room.mp4", &["-qp", "0"]).await;
    let calibration = stage.path("room/calib.json");
    let with_camera = ["--camera", text(&calibration)];

    let said = refusal(
        &stage.stream(text(&video), "a", &with_camera).env("PATH", "/nowhere").output().await.unwrap(),
    );
    assert!(said.contains("ffmpeg: is not installed") && said.contains("apt install ffmpeg"), "{said}");
    let output = stage.stream(text(&video), "uncalibrated", &[]).output().await.unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("room.mp4 is not known: it is found as the map grows"), "{said}");
    assert_eq!(summary(&output)["frames"], 4);
    fs::write(stage.path("text.mp4"), "no video").unwrap();
    let broken = stage.path("text.mp4");
    let said = refusal(&stage.stream(text(&broken), "a", &with_camera).output().await.unwrap());
    assert!(said.contains("text.mp4: ffmpeg cannot read it: "), "{said}");
    let turned = stage.make("turned.mp4", &["-vf", "transpose", "-qp", "0"]).await;
    let said = refusal(&stage.stream(text(&turned), "a", &with_camera).output().await.unwrap());
    assert!(said.contains("has images of 480x640 pixels") && said.contains("for 640x480"), "{said}");
    // Nothing of that made a session.
    let http = HttpClient::new(format!("http://{}", stage.running.http_addr)).unwrap();
    assert!(http.trajectory("a").await.is_err());

    let unknown =
        summary(&stage.stream(text(&turned), "a", &["--camera", "unknown"]).output().await.unwrap());
    assert_eq!(unknown["frames"], 4);
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg"]
#[cfg(target_os = "linux")]
async fn a_killed_command_leaves_no_ffmpeg_behind() {
    let stage = Stage::set(2).await;
    let loops = ["-vf", "loop=loop=-1:size=2", "-t", "20", "-preset", "ultrafast"];
    let video = stage.make("twenty-seconds-of-nothing.mp4", &loops).await;
    let calibration = stage.path("room/calib.json");
    let slowly = ["--camera", text(&calibration), "--fps", "2"];
    let mut streaming = stage.stream(text(&video), "killed", &slowly).spawn().unwrap();
    let started = Instant::now();
    let is_reading = || {
        fs::read_dir("/proc").unwrap().flatten().any(|process| {
            let line = fs::read(process.path().join("cmdline")).unwrap_or_default();
            line.starts_with(b"ffmpeg")
                && String::from_utf8_lossy(&line).contains("twenty-seconds-of-nothing")
        })
    };
    while !is_reading() {
        assert!(started.elapsed() < Duration::from_secs(20), "ffmpeg was not started");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    streaming.kill().await.unwrap();
    let killed = Instant::now();
    while is_reading() {
        assert!(killed.elapsed() < Duration::from_secs(20), "ffmpeg goes on");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    stage.end().await;
}
