//! Runs the engine over a rendered sequence whose truth is known and prints how well it did.
//!
//! `cargo run --release -p testkit --bin track_synthetic -- PRESET SEED|FIRST..LAST [OPTION..]`
//!
//! | option | what it does |
//! | --- | --- |
//! | `--inline` | all stages in turn on one thread, the same each time |
//! | `--realtime` | frames come as recorded, and tracking does not wait for mapping |
//! | `--frames N` | only the first N |
//! | `--every N` | shows it every N-th frame only |
//! | `--backwards` | from the last frame to the first: an error that turns round with the walk is the data's |
//! | `--readout MS` | a rolling shutter that reads the image in so many milliseconds |
//! | `--told-readout MS` | the engine is told of another than that, or of none and has to find it: `unknown` |
//! | `--engine-seed N` | the engine's random numbers; otherwise the sequence's seed |
//! | `--no-loops`, `--no-lines`, `--no-primitives` | switches features off |
//! | `--no-calibration` | takes the calibration as it is given |
//! | `--focal-error SHARE`, `--centre-error SHARE` | gives a wrong calibration: the focal length too long, the principal point too far to the right, as shares of the focal length |
//! | `--runs N` | every seed with so many of the engine's; the table shows the medians |
//! | `--compare-primitives` | runs every seed without and with primitives, and prints a table of both |
//! | `--compare-calibration` | runs every seed with the calibration as given and with self-calibration, and prints a table of both |
//! | `--segments` | only prints how far segments lie from the true edges |
//! | `--directions` | prints primitives and their segments against the truth |
//! | `--flow` | prints by how much sightings run ahead of their true motion, or lag behind it |
//! | `--spans` | prints what the stages of local bundle adjustment take |
//! | `--relocalise CONTRAST` | then looks for single frames of that contrast in the map |
//! | `--verbose` | a line a frame |
//! | `--out FILE` | the trajectory as a TUM file |
//! | `--truth FILE` | the true trajectory as a TUM file |
//! | `--images FOLDER` | keeps the images, one folder for each preset and seed, as rendering takes longer than tracking |
//!
//! Several seeds make a table as well.
//!
//! Presets: room-rich, room-poor, corridor-straight, corridor-ring, corridor-corners, four-rooms, atlanta,
//! unstructured, look-alike.

mod directions;
mod flow;
mod places;
mod recording;
mod relocalize;
mod revisit;
mod run;
mod score;
mod segments;
mod spans;
mod table;

use geometry::{Camera, CameraParameters};
use recording::Recording;
use revisit::Revisit;
use run::Run;
use score::{Places, Score};
use slam::{Frame, FrameReport, Pipeline, ResumeState, RollingShutterConfig, SlamConfig, Threading};
use spans::SpanTimes;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use synthetic::Preset;
use table::Row;
use testkit::laboratory::{Arguments, WallClock};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::read();
    let [preset, seeds, ..] = arguments.words() else {
        return Err("usage: track_synthetic PRESET SEED|FIRST..LAST".into());
    };
    let preset: Preset = preset.parse()?;
    let (first, last) = seeds.split_once("..").unwrap_or((seeds, seeds));
    let seeds: Vec<u64> = (first.parse()?..=last.parse()?).collect();
    let spans = Arc::new(SpanTimes::default());
    if arguments.flag("--spans") {
        tracing::subscriber::set_global_default(spans.clone())?;
    }
    if arguments.flag("--segments") {
        return seeds.iter().try_for_each(|seed| segments_of(preset, *seed, &arguments));
    }
    let switches = Switches {
        primitives: !arguments.flag("--no-primitives"),
        calibration: !arguments.flag("--no-calibration"),
    };
    let pairs = |without: Switches, with: Switches| {
        let pair = |seed: &u64| {
            Ok([runs(preset, *seed, without, &arguments)?, runs(preset, *seed, with, &arguments)?])
        };
        seeds.iter().map(pair).collect::<Result<Vec<_>, Box<dyn Error>>>()
    };
    if arguments.flag("--compare-primitives") {
        let rows =
            pairs(Switches { primitives: false, ..switches }, Switches { primitives: true, ..switches })?;
        table::print_comparison(preset, &seeds, &rows);
    } else if arguments.flag("--compare-calibration") {
        let rows =
            pairs(Switches { calibration: false, ..switches }, Switches { calibration: true, ..switches })?;
        table::print_calibrations(preset, &seeds, &rows);
    } else {
        let row = |seed: &u64| runs(preset, *seed, switches, &arguments);
        let rows = seeds.iter().map(row).collect::<Result<Vec<_>, _>>()?;
        if seeds.len() > 1 {
            table::print_table(preset, &seeds, &rows);
        }
    }
    if arguments.flag("--spans") {
        spans.print();
    }
    Ok(())
}

/// What the comparisons switch off.
#[derive(Clone, Copy)]
struct Switches {
    primitives: bool,
    calibration: bool,
}

fn segments_of(preset: Preset, seed: u64, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let recording = recorded(preset, seed, arguments)?;
    let n_frames = arguments.value("--frames").map_or(Ok(recording.len()), |n| n.parse())?;
    let mut detector = vision::lines::detector(SlamConfig::default().lines.detector)?;
    println!("\n{} {seed}\n", preset.name());
    segments::print_offsets(&recording, detector.as_mut(), n_frames.min(recording.len()))
}

/// One sequence, as often as was asked for.
fn runs(preset: Preset, seed: u64, switches: Switches, arguments: &Arguments) -> Result<Row, Box<dyn Error>> {
    let n_runs: u64 = arguments.value("--runs").map_or(Ok(1), |n| n.parse())?;
    let first = arguments.value("--engine-seed").map_or(Ok(seed), |seed| seed.parse())?;
    let rows = (0..n_runs.max(1)).map(|run| track(preset, seed, first + run, switches, arguments));
    Ok(Row::median_of(rows.collect::<Result<_, _>>()?))
}

/// The sequence as it was asked for.
fn recorded(preset: Preset, seed: u64, arguments: &Arguments) -> Result<Recording, Box<dyn Error>> {
    let folder = arguments.value("--images").map(Path::new);
    let readout_ms = arguments.value("--readout").map_or(Ok(0.0), |ms| ms.parse())?;
    Recording::new(preset, seed, folder, arguments.flag("--backwards"), readout_ms)
}

/// What the engine is told of the readout; nothing where there is none.
fn told_readout(arguments: &Arguments) -> Result<RollingShutterConfig, Box<dyn Error>> {
    let told = arguments.value("--told-readout").or_else(|| arguments.value("--readout"));
    match told.map(String::as_str) {
        None | Some("unknown") => Ok(RollingShutterConfig::default()),
        Some(ms) => Ok(RollingShutterConfig::of_ms(ms.parse()?)),
    }
}

/// The camera as the engine is told of it.
fn given_camera(camera: &Camera, arguments: &Arguments) -> Result<Camera, Box<dyn Error>> {
    let share = |name: &str| arguments.value(name).map_or(Ok(0.0), |share| share.parse::<f64>());
    let (focal, center) = (share("--focal-error")?, share("--centre-error")?);
    let true_to = camera.parameters();
    let (fx, fy) = (true_to.fx * (1.0 + focal), true_to.fy * (1.0 + focal));
    let cx = true_to.cx + true_to.fx * center;
    Ok(Camera::new(CameraParameters { fx, fy, cx, ..true_to.clone() })?)
}

fn track(
    preset: Preset,
    seed: u64,
    engine_seed: u64,
    switches: Switches,
    arguments: &Arguments,
) -> Result<Row, Box<dyn Error>> {
    let flag = |name: &str| arguments.flag(name);
    let value = |name: &str| arguments.value(name);
    let recording = recorded(preset, seed, arguments)?;
    let mut config = SlamConfig { seed: engine_seed, ..SlamConfig::default() };
    config.threading = if flag("--inline") { Threading::Inline } else { Threading::Background };
    config.features.loop_closing = !flag("--no-loops");
    config.features.refine_calibration = switches.calibration;
    config.features.lines = !flag("--no-lines");
    config.features.global_primitives = switches.primitives;
    config.rolling_shutter = told_readout(arguments)?;
    let clock = Arc::new(WallClock::start());
    let mut camera = given_camera(recording.camera(), arguments)?;
    if flag("--unknown-camera") {
        config.calibration.trust = slam::CalibrationTrust::Unknown;
        camera = Camera::new(config.calibration.camera_of_size(camera.width(), camera.height()))?;
    }
    if flag("--log") {
        tracing_subscriber::fmt().with_max_level(tracing::Level::DEBUG).with_ansi(false).init();
    }
    let nominal = camera.clone();
    let mut pipeline = Pipeline::resume(config.clone(), camera, clock, ResumeState::default())?;

    let n_frames = value("--frames").map_or(Ok(recording.len()), |n| n.parse())?.min(recording.len());
    let every: usize = value("--every").map_or(Ok(1), |n| n.parse())?;
    if every == 0 {
        return Err("--every must be 1 or more".into());
    }
    let n_shown = n_frames.div_ceil(every);
    let mut run = Run::default();
    pipeline.set_lossless(!flag("--realtime"));
    let start = Instant::now();
    for index in (0..n_frames).step_by(every) {
        let timestamp_ns = recording.timestamp_ns(index);
        if flag("--realtime") {
            let due = Duration::from_nanos((timestamp_ns - recording.timestamp_ns(0)) as u64);
            std::thread::sleep(due.saturating_sub(start.elapsed()));
        }
        let report = pipeline.process_frame(Frame {
            sequence: index as u64,
            timestamp_ns,
            image: recording.image(index)?,
        })?;
        print_report(&report, index, &pipeline, &recording, flag("--verbose"));
        run.note(&report);
        run.store(pipeline.take_updates());
    }
    run.store(pipeline.finish());
    let map = pipeline.map();
    map.check()?;
    let places = Places::of(&run.records, &map);
    if let Some(out) = value("--out") {
        std::fs::write(out, places.to_tum(&recording))?;
    }
    if let Some(truth) = value("--truth") {
        std::fs::write(truth, recording.to_tum())?;
    }
    let revisit = Revisit::of(&map, &recording, n_frames);
    let (n_loops, n_merges) = (run.n_loops, run.n_merges);
    let run_camera = run.camera;
    print_camera(recording.camera(), &nominal.with_correction(map.correction()));
    if let Some(readout) = map.readout() {
        println!("found readout: {:.2} ms, standard deviation {:.2}", readout.ms(), readout.sigma_ms());
    }
    run.print(&map);
    places.print(&recording, n_shown);
    if let Some(revisit) = &revisit {
        revisit.print();
    }
    if flag("--directions") {
        directions::print_primitives(&map, &recording);
        directions::print_segments(&map, &recording);
    }
    if flag("--flow") {
        flow::print_flow(&map, &recording);
    }
    if let Some(contrast) = value("--relocalise") {
        relocalize::print_relocalized(&map, &recording, &config, contrast.parse()?)?;
    }
    let largest = places.0.values().max_by_key(|places| places.len());
    let score = largest.and_then(|places| Score::of(places, &recording));
    Ok(Row {
        coverage: largest.map_or(0, BTreeMap::len) as f64 / n_frames as f64,
        n_submaps: places.0.len(),
        n_loops,
        n_merges,
        revisit,
        ate_share: score.as_ref().map(|score| score.ate / score.path),
        drift_deg: score.as_ref().map(|score| score.rotation_drift_deg),
        camera: run_camera,
    })
}

/// The camera as it was found beside the true one.
fn print_camera(truth: &Camera, found: &Camera) {
    for (name, camera) in [("true", truth.clone()), ("found", found.clone())] {
        let CameraParameters { fx, fy, cx, cy, distortion, .. } = camera.corrected_parameters();
        println!("{name} camera: fx {fx:.2} fy {fy:.2} cx {cx:.2} cy {cy:.2} distortion {distortion:.4?}");
    }
}

fn print_report(
    report: &FrameReport,
    index: usize,
    pipeline: &Pipeline,
    recording: &Recording,
    verbose: bool,
) {
    if verbose {
        println!(
            "{index} {:?} submap {} keypoints {} segments {} points {} lines {} keyframe {} {}",
            report.outcome.state(),
            report.submap,
            report.n_keypoints,
            report.n_segments,
            report.n_inlier_points,
            report.n_inlier_lines,
            report.is_keyframe,
            report.outcome.reason(),
        );
    }
    for event in &report.map_events {
        println!("frame {index}: {event:?}; {}", places::truth_of(event, &pipeline.map(), recording));
    }
    if report.relocalized {
        let truth = places::truth_of_place(report, &pipeline.map(), recording, index);
        println!("frame {index}: relocalised {truth}");
    }
}
