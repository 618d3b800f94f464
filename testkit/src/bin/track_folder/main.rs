//! Runs the engine alone over a recording and writes the trajectory, for work on the engine itself.
//!
//! `cargo run --release -p testkit --bin track_folder -- DATASET OUT.txt [--inline] [--start N] [--end N]
//! [--seed N] [--no-lines] [--no-primitives] [--no-loops] [--no-calibration] [--unknown-camera]
//! [--readout MS]
//! [--approximate-camera] [--wide-calibration] [--mask FILE] [--no-mask] [--verbose] [--states] [--log]`
//!
//! The dataset is a folder of a layout that `monoslam` reads, also looked for in the folder that
//! `MONOSLAM_DATA` names. `--states` prints how many frames of each state are wrong, where the recording has
//! a truth. `--unknown-camera` tells the engine the size of the image alone, `--approximate-camera` that the
//! calibration is rough, `--wide-calibration` to give it up where the images contradict it; `--log` prints
//! what it logs. Through the service, and measured against the truth, is the business of `monoslam`.

mod states;

use geometry::{Camera, CameraParameters};
use recordings::{Recording, Trajectory, find_folder};
use slam::map::{FrameRecord, FrameState};
use slam::{
    CalibrationTrust, FeatureSwitches, Frame, Pipeline, ResumeState, RollingShutterConfig, SceneMask,
    SlamConfig, Threading,
};
use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Arc;
use std::time::Instant;
use testkit::laboratory::{Arguments, WallClock, summary, write_pose};
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};
use vision::mask::Mask;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::read();
    let flag = |name: &str| arguments.flag(name);
    let value = |name: &str| arguments.value(name);
    let [dataset, out, ..] = arguments.words() else {
        return Err("usage: track_folder DATASET OUT.txt".into());
    };
    let folder = find_folder(dataset)?;
    let recording = Recording::open(&folder, None)?;
    let mut config = SlamConfig {
        threading: if flag("--inline") { Threading::Inline } else { Threading::Background },
        seed: value("--seed").map_or(Ok(0), |seed| seed.parse())?,
        features: FeatureSwitches {
            lines: !flag("--no-lines"),
            global_primitives: !flag("--no-lines") && !flag("--no-primitives"),
            loop_closing: !flag("--no-loops"),
            refine_calibration: !flag("--no-calibration"),
            find_mask: !flag("--no-mask"),
        },
        ..SlamConfig::default()
    };
    let mut camera = recording.camera;
    if flag("--unknown-camera") {
        config.calibration.trust = CalibrationTrust::Unknown;
        camera = Camera::new(config.calibration.camera_of_size(camera.width(), camera.height()))?;
    }
    config.calibration.wide = flag("--wide-calibration");
    let (parameters, calibration) = config.calibration.begin_with(camera.parameters().clone());
    (camera, config.calibration) = (Camera::new(parameters)?, calibration);
    if flag("--approximate-camera") {
        config.calibration.trust = CalibrationTrust::Approximate;
    }
    if let Some(ms) = arguments.value("--readout") {
        config.rolling_shutter = RollingShutterConfig::of_ms(ms.parse()?);
    }
    if flag("--log") {
        tracing_subscriber::fmt().with_max_level(tracing::Level::DEBUG).with_ansi(false).init();
    }
    let clock = Arc::new(WallClock::start());
    let given = value("--mask").map(|path| read_mask(path)).transpose()?;
    let state = ResumeState { mask: given, ..ResumeState::default() };
    let mut pipeline = Pipeline::resume(config, camera.clone(), clock, state)?;

    let mut records: BTreeMap<u64, FrameRecord> = BTreeMap::new();
    let (mut cpu_ms, mut wall_ms) = (Vec::new(), Vec::new());
    let mut stage_ms: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut frames = recording.frames;
    frames.truncate(value("--end").map_or(Ok(usize::MAX), |end| end.parse())?);
    frames.drain(..value("--start").map_or(Ok(0), |start| start.parse())?.min(frames.len()));
    let start = Instant::now();
    for (sequence, frame) in frames.iter().enumerate() {
        let bytes = std::fs::read(&frame.path)?;
        let image = decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default())?;
        let report = pipeline.process_frame(Frame {
            sequence: sequence as u64,
            timestamp_ns: frame.timestamp_ns,
            image,
        })?;
        if flag("--verbose") {
            println!(
                "{sequence} {:?} keypoints {} inliers {} segments {} lines {} keyframe {} relocalised {} {:.1} ms {}",
                report.outcome.state(),
                report.n_keypoints,
                report.n_inlier_points,
                report.n_segments,
                report.n_inlier_lines,
                report.is_keyframe,
                report.relocalized,
                report.wall_ns as f64 * 1e-6,
                report.outcome.reason(),
            );
        }
        for event in &report.map_events {
            println!("frame {sequence}: {event:?}");
        }
        *counts.entry(format!("{:?}", report.outcome.state())).or_default() += 1;
        cpu_ms.push(report.cpu_ns as f64 * 1e-6);
        wall_ms.push(report.wall_ns as f64 * 1e-6);
        for stage in &report.stages {
            stage_ms.entry(stage.name).or_default().push(stage.wall_ns as f64 * 1e-6);
        }
        for update in pipeline.take_updates() {
            records.extend(update.frames.iter().map(|record| (record.sequence, record.clone())));
        }
    }
    for update in pipeline.finish() {
        records.extend(update.frames.iter().map(|record| (record.sequence, record.clone())));
    }
    let elapsed = start.elapsed().as_secs_f64();

    let map = pipeline.map();
    let mut text = String::new();
    for keyframe in map.keyframes() {
        write_pose(&mut text, keyframe.timestamp_ns, &keyframe.camera_from_world.inverse());
    }
    std::fs::write(format!("{out}.keyframes"), text)?;
    let mut text = String::new();
    let (mut n_posed, mut n_backfilled) = (0, 0);
    for record in records.values() {
        let Some(pose) = record.pose else { continue };
        let Some((_, camera_from_world)) = map.locate(&pose) else { continue };
        write_pose(&mut text, record.timestamp_ns, &camera_from_world.inverse());
        n_posed += 1;
        n_backfilled += usize::from(record.backfilled);
        debug_assert!(record.state != FrameState::Lost);
    }
    std::fs::write(out, text)?;

    println!("frames {} posed {n_posed} backfilled {n_backfilled} {counts:?}", frames.len());
    let made = map.last_ids();
    println!(
        "keyframes {} (made {}) points {} lines {} (made {}) primitives {} (made {})",
        map.n_keyframes(),
        made.keyframe,
        map.n_points(),
        map.n_lines(),
        made.line,
        map.n_primitives(),
        made.primitive,
    );
    let CameraParameters { fx, fy, cx, cy, distortion, .. } =
        camera.with_correction(map.correction()).corrected_parameters();
    if let Some(known) = pipeline.mask() {
        println!("mask: {:.4} of the image is left out", known.mask.share());
    }
    if let Some(readout) = map.readout() {
        println!("readout {:.2} ms, standard deviation {:.2}", readout.ms(), readout.sigma_ms());
    }
    println!("camera fx {fx:.2} fy {fy:.2} cx {cx:.2} cy {cy:.2} distortion {distortion:.4?}");
    println!("cpu ms: {} wall ms: {} total {elapsed:.1} s", summary(&mut cpu_ms), summary(&mut wall_ms));
    for (name, times) in &mut stage_ms {
        println!("  {name}: {}", summary(times));
    }
    if flag("--states") {
        print!("{}", states::table(&records, &map, &Trajectory::read(&folder.join("groundtruth.txt"))?));
    }
    map.check()?;
    Ok(())
}

fn read_mask(path: &str) -> Result<SceneMask, Box<dyn Error>> {
    let picture = decode_gray(&EncodedImage::Auto(&std::fs::read(path)?), &DecodeLimits::default())?;
    Ok(SceneMask { mask: Arc::new(Mask::from_picture(&picture)), is_given: true })
}
