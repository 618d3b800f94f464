//! Runs the engine alone over a recording and writes the trajectory, for work on the engine itself.
//!
//! `cargo run --release -p slam --example track_folder -- DATASET OUT.txt [--inline] [--start N] [--end N] [--seed N] [--no-lines] [--no-primitives] [--no-loops] [--no-calibration] [--verbose]`
//!
//! The dataset is a folder with `rgb.txt` and `calib.json`. Everything else (other layouts, the service, evaluation)
//! is the business of `monoslam`.

mod common;

use common::{Arguments, WallClock, summary, write_pose};
use geometry::{Camera, CameraModel, CameraParameters};
use slam::map::{FrameRecord, FrameState};
use slam::{FeatureSwitches, Frame, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::read();
    let flag = |name: &str| arguments.flag(name);
    let value = |name: &str| arguments.value(name);
    let [dataset, out, ..] = arguments.words() else {
        return Err("usage: track_folder DATASET OUT.txt".into());
    };
    let dataset = Path::new(dataset);
    let config = SlamConfig {
        threading: if flag("--inline") { Threading::Inline } else { Threading::Background },
        seed: value("--seed").map_or(Ok(0), |seed| seed.parse())?,
        features: FeatureSwitches {
            lines: !flag("--no-lines"),
            global_primitives: !flag("--no-lines") && !flag("--no-primitives"),
            loop_closing: !flag("--no-loops"),
            refine_calibration: !flag("--no-calibration"),
        },
        ..SlamConfig::default()
    };
    let camera = read_camera(dataset)?;
    let clock = Arc::new(WallClock::start());
    let mut pipeline = Pipeline::resume(config, camera, clock, ResumeState::default())?;

    let mut records: BTreeMap<u64, FrameRecord> = BTreeMap::new();
    let (mut cpu_ms, mut wall_ms) = (Vec::new(), Vec::new());
    let mut stage_ms: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut frames = read_frame_list(dataset)?;
    frames.truncate(value("--end").map_or(Ok(usize::MAX), |end| end.parse())?);
    frames.drain(..value("--start").map_or(Ok(0), |start| start.parse())?.min(frames.len()));
    let start = Instant::now();
    for (sequence, (timestamp_ns, path)) in frames.iter().enumerate() {
        let bytes = std::fs::read(dataset.join(path))?;
        let image = decode_gray(&EncodedImage::Auto(&bytes), &DecodeLimits::default())?;
        let report = pipeline.process_frame(Frame {
            sequence: sequence as u64,
            timestamp_ns: *timestamp_ns,
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
                report.relocalised,
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
            records.extend(update.frames.iter().map(|record| (record.sequence, *record)));
        }
    }
    for update in pipeline.finish() {
        records.extend(update.frames.iter().map(|record| (record.sequence, *record)));
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
        "key frames {} (made {}) points {} lines {} (made {}) primitives {} (made {})",
        map.n_keyframes(),
        made.keyframe,
        map.n_points(),
        map.n_lines(),
        made.line,
        map.n_primitives(),
        made.primitive,
    );
    println!("cpu ms: {} wall ms: {} total {elapsed:.1} s", summary(&mut cpu_ms), summary(&mut wall_ms));
    for (name, times) in &mut stage_ms {
        println!("  {name}: {}", summary(times));
    }
    map.check()?;
    Ok(())
}

fn read_frame_list(dataset: &Path) -> Result<Vec<(i64, String)>, Box<dyn Error>> {
    let text = std::fs::read_to_string(dataset.join("rgb.txt"))?;
    let lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
    lines
        .map(|line| {
            let (time, path) = line.split_once(' ').ok_or("a line of rgb.txt is not `time path`")?;
            let (seconds, fraction) = time.split_once('.').unwrap_or((time, "0"));
            let nanos: i64 = format!("{fraction:0<9}")[..9].parse()?;
            Ok((seconds.parse::<i64>()? * 1_000_000_000 + nanos, path.trim().to_owned()))
        })
        .collect()
}

fn read_camera(dataset: &Path) -> Result<Camera, Box<dyn Error>> {
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(dataset.join("calib.json"))?)?;
    let number = |name: &str| json[name].as_f64().ok_or(format!("calib.json: {name} is missing"));
    let model = match json["model"].as_str() {
        Some("pinhole") => CameraModel::Pinhole,
        Some("radtan") => CameraModel::Radtan,
        Some("kannala_brandt" | "equidistant") => CameraModel::KannalaBrandt,
        Some("fov") => CameraModel::Fov,
        other => return Err(format!("calib.json: unknown model {other:?}").into()),
    };
    let distortion =
        json["dist"].as_array().into_iter().flatten().filter_map(serde_json::Value::as_f64).collect();
    Ok(Camera::new(CameraParameters {
        model,
        width: number("width")? as u32,
        height: number("height")? as u32,
        fx: number("fx")?,
        fy: number("fy")?,
        cx: number("cx")?,
        cy: number("cy")?,
        distortion,
    })?)
}
