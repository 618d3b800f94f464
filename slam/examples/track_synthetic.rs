//! Runs the engine over a rendered sequence whose truth is known and prints how well it did.
//!
//! `cargo run --release -p slam --example track_synthetic -- PRESET SEED|FIRST..LAST [--inline] [--frames N] [--no-loops] [--no-lines]
//! [--no-primitives] [--verbose] [--out TRAJECTORY.txt] [--images FOLDER]`
//!
//! Several seeds make a table as well.
//!
//! Rendering takes longer than tracking: `--images` keeps the images, one folder for each preset and seed, for the next
//! run.
//!
//! Presets: room-rich, room-poor, corridor-straight, corridor-ring, corridor-corners, four-rooms, atlanta, unstructured, look-alike.

use geometry::nalgebra::{UnitQuaternion, Vector3};
use geometry::{Pose, Similarity};
use slam::map::{FrameRecord, SubmapId};
use slam::{Clock, Frame, FrameReport, Map, MapEvent, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use synthetic::{Preset, Sequence};
use vision::GrayImage;

struct WallClock(Instant);

impl Clock for WallClock {
    fn wall_ns(&self) -> u64 {
        self.0.elapsed().as_nanos() as u64
    }

    fn thread_cpu_ns(&self) -> u64 {
        // schedstat: time on the CPU, time waiting, time slices; nanoseconds.
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
        text.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(0)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments(std::env::args().skip(1).collect());
    let [preset, seeds, ..] = arguments.0.as_slice() else {
        return Err("usage: track_synthetic PRESET SEED|FIRST..LAST".into());
    };
    let preset: Preset = preset.parse()?;
    let (first, last) = seeds.split_once("..").unwrap_or((seeds, seeds));
    let seeds: Vec<u64> = (first.parse()?..=last.parse()?).collect();
    let mut rows = Vec::new();
    for seed in &seeds {
        rows.push(track(preset, *seed, &arguments)?);
    }
    if seeds.len() > 1 {
        print_table(preset, &seeds, &rows);
    }
    Ok(())
}

/// The words of the command line.
struct Arguments(Vec<String>);

impl Arguments {
    fn flag(&self, name: &str) -> bool {
        self.0.iter().any(|argument| argument == name)
    }

    fn value(&self, name: &str) -> Option<&String> {
        self.0.iter().position(|argument| argument == name).and_then(|at| self.0.get(at + 1))
    }
}

/// What became of one sequence, for the table.
struct Row {
    /// Share of the frames with a pose in the largest submap.
    coverage: f64,
    n_submaps: usize,
    n_loops: usize,
    n_merges: usize,
    /// Of the largest submap; root mean square error as a share of the path.
    ate_share: Option<f64>,
    /// Turn from the first frame to the last, degrees.
    drift_deg: Option<f64>,
}

fn track(preset: Preset, seed: u64, arguments: &Arguments) -> Result<Row, Box<dyn Error>> {
    let flag = |name: &str| arguments.flag(name);
    let value = |name: &str| arguments.value(name);
    let sequence = Sequence::preset(preset, seed);
    let mut config = SlamConfig { seed, ..SlamConfig::default() };
    config.threading = if flag("--inline") { Threading::Inline } else { Threading::Background };
    config.features.loop_closing = !flag("--no-loops");
    config.features.lines = !flag("--no-lines");
    config.features.global_primitives = !flag("--no-primitives");
    let clock = Arc::new(WallClock(Instant::now()));
    let mut pipeline = Pipeline::resume(config, sequence.camera().clone(), clock, ResumeState::default())?;

    let images = value("--images").map(|folder| Path::new(folder).join(format!("{}-{seed}", preset.name())));
    let n_frames = value("--frames").map_or(Ok(sequence.len()), |n| n.parse())?.min(sequence.len());
    let mut run = Run::default();
    for index in 0..n_frames {
        let image = image(&sequence, index, images.as_deref())?;
        let frame = Frame { sequence: index as u64, timestamp_ns: sequence.timestamp_ns(index), image };
        let report = pipeline.process_frame(frame)?;
        if flag("--verbose") {
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
            println!("frame {index}: {event:?}; {}", truth_of(event, &pipeline.map(), &sequence));
        }
        if report.relocalised {
            println!(
                "frame {index}: relocalised {}",
                truth_of_place(&report, &pipeline.map(), &sequence, index)
            );
        }
        run.note(&report);
        run.store(pipeline.take_updates());
    }
    run.store(pipeline.finish());
    let map = pipeline.map();
    map.check()?;
    let places = Places::of(&run.records, &map);
    if let Some(out) = value("--out") {
        std::fs::write(out, places.to_tum(&sequence))?;
    }
    let (n_loops, n_merges) = (run.n_loops, run.n_merges);
    run.print(&map);
    places.print(&sequence, n_frames);
    let largest = places.0.values().max_by_key(|places| places.len());
    let score = largest.and_then(|places| Score::of(places, &sequence));
    Ok(Row {
        coverage: largest.map_or(0, BTreeMap::len) as f64 / n_frames as f64,
        n_submaps: places.0.len(),
        n_loops,
        n_merges,
        ate_share: score.as_ref().map(|score| score.ate / score.path),
        drift_deg: score.as_ref().map(|score| score.rotation_drift_deg),
    })
}

fn print_table(preset: Preset, seeds: &[u64], rows: &[Row]) {
    println!(
        "\n| {}, seed | coverage | submaps | loops | mergers | ATE, % of the path | drift of the attitude, deg |",
        preset.name()
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    for (seed, row) in seeds.iter().zip(rows) {
        println!(
            "| {seed} | {:.3} | {} | {} | {} | {} | {} |",
            row.coverage,
            row.n_submaps,
            row.n_loops,
            row.n_merges,
            number(row.ate_share.map(|share| 100.0 * share)),
            number(row.drift_deg),
        );
    }
    let mut errors: Vec<f64> = rows.iter().map(|row| row.ate_share.unwrap_or(f64::INFINITY)).collect();
    errors.sort_by(f64::total_cmp);
    println!(
        "\n{} of {} runs cover more than 95 % of the frames, {} are within 2 % of the path; median {:.3} %, worst {:.3} %.",
        rows.iter().filter(|row| row.coverage > 0.95).count(),
        rows.len(),
        errors.iter().filter(|error| **error < 0.02).count(),
        100.0 * errors[errors.len() / 2],
        100.0 * errors[errors.len() - 1],
    );
}

/// How far apart the two views of a recognised place really are.
fn truth_of(event: &MapEvent, map: &Map, sequence: &Sequence) -> String {
    let (MapEvent::LoopClosed { keyframe, matched, .. } | MapEvent::SubmapsMerged { keyframe, matched, .. }) =
        event;
    let pose = |id| Some(sequence.camera_from_world(map.keyframe(id)?.sequence as usize));
    let Some((a, b)) = pose(*keyframe).zip(pose(*matched)) else { return "culled since".to_owned() };
    let angle_deg = a.rotation.angle_to(&b.rotation).to_degrees();
    format!("truly {:.2} and {angle_deg:.1} deg apart", (a.centre() - b.centre()).norm())
}

/// How far the camera truly is from the key frame that it was found beside.
fn truth_of_place(report: &FrameReport, map: &Map, sequence: &Sequence, index: usize) -> String {
    let Some(world_from_camera) = report.world_from_camera else { return String::new() };
    let distance = |centre: Vector3<f64>| (centre - world_from_camera.translation).norm();
    let beside = map
        .keyframes_of(report.submap)
        .map(|keyframe| (distance(keyframe.camera_from_world.centre()), keyframe.sequence as usize))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, beside)) = beside else { return String::new() };
    let truth = |index: usize| sequence.camera_from_world(index).centre();
    let n_inliers = report.n_inlier_points + report.n_inlier_lines;
    format!(
        "by {n_inliers} landmarks beside frame {beside}, truly {:.2} apart",
        (truth(index) - truth(beside)).norm()
    )
}

/// Renders a frame, or takes it from a folder in which it was kept before.
fn image(sequence: &Sequence, index: usize, folder: Option<&Path>) -> Result<GrayImage, Box<dyn Error>> {
    let (width, height) = (sequence.camera().width(), sequence.camera().height());
    let kept = folder.map(|folder| folder.join(format!("{index:05}.gray")));
    if let Some(pixels) = kept.as_ref().and_then(|path| std::fs::read(path).ok()) {
        return GrayImage::from_raw(width, height, pixels).map_err(|error| error.to_string().into());
    }
    let pixels = sequence.frame(index).image.into_pixels();
    if let (Some(folder), Some(path)) = (folder, kept) {
        std::fs::create_dir_all(folder)?;
        // Several runs may share the folder: a file of that name is always whole.
        let partial = path.with_extension(std::process::id().to_string());
        std::fs::write(&partial, &pixels)?;
        std::fs::rename(&partial, path)?;
    }
    GrayImage::from_raw(width, height, pixels).map_err(|error| error.to_string().into())
}

/// What came of the frames.
#[derive(Default)]
struct Run {
    records: BTreeMap<u64, FrameRecord>,
    states: BTreeMap<String, usize>,
    n_relocalised: usize,
    n_loops: usize,
    n_merges: usize,
    cpu_ms: Vec<f64>,
    wall_ms: Vec<f64>,
    /// Taking over the newest map, corrections among it.
    adopt_ms: Vec<f64>,
}

impl Run {
    fn note(&mut self, report: &FrameReport) {
        *self.states.entry(format!("{:?}", report.outcome.state())).or_default() += 1;
        self.n_relocalised += usize::from(report.relocalised);
        for event in &report.map_events {
            match event {
                MapEvent::LoopClosed { .. } => self.n_loops += 1,
                MapEvent::SubmapsMerged { .. } => self.n_merges += 1,
            }
        }
        self.cpu_ms.push(report.cpu_ns as f64 * 1e-6);
        self.wall_ms.push(report.wall_ns as f64 * 1e-6);
        let adoption = report.stages.iter().filter(|stage| stage.name == "adopt");
        self.adopt_ms.push(adoption.map(|stage| stage.wall_ns as f64 * 1e-6).sum());
    }

    fn store(&mut self, updates: Vec<slam::MapUpdate>) {
        for update in updates {
            self.records.extend(update.frames.iter().map(|record| (record.sequence, *record)));
        }
    }

    fn print(mut self, map: &Map) {
        println!(
            "frames {:?} relocalised {} loops {} merges {}",
            self.states, self.n_relocalised, self.n_loops, self.n_merges
        );
        println!(
            "map: key frames {} (made {}) points {} lines {} primitives {} submaps {:?}",
            map.n_keyframes(),
            map.last_ids().keyframe,
            map.n_points(),
            map.n_lines(),
            map.n_primitives(),
            map.submaps().iter().map(|submap| submap.0).collect::<Vec<_>>(),
        );
        println!(
            "tracking thread: cpu ms {} wall ms {} of it taking over the map {}",
            summary(&mut self.cpu_ms),
            summary(&mut self.wall_ms),
            summary(&mut self.adopt_ms)
        );
    }
}

fn summary(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied().unwrap_or(0.0);
    format!("median {:.2} p95 {:.2} max {:.2}", at(0.5), at(0.95), at(1.0 - 1e-9))
}

/// The cameras' places by frame number, per submap.
struct Places(BTreeMap<SubmapId, BTreeMap<usize, Pose>>);

impl Places {
    fn of(records: &BTreeMap<u64, FrameRecord>, map: &Map) -> Self {
        let mut places: BTreeMap<SubmapId, BTreeMap<usize, Pose>> = BTreeMap::new();
        for record in records.values() {
            let Some((submap, camera_from_world)) = record.pose.and_then(|pose| map.locate(&pose)) else {
                continue;
            };
            places.entry(submap).or_default().insert(record.sequence as usize, camera_from_world.inverse());
        }
        Self(places)
    }

    fn print(&self, sequence: &Sequence, n_frames: usize) {
        let n_posed: usize = self.0.values().map(BTreeMap::len).sum();
        println!("coverage {:.4}", n_posed as f64 / n_frames as f64);
        for (submap, places) in &self.0 {
            match Score::of(places, sequence) {
                Some(score) => println!(
                    "submap {submap}: coverage {:.4} path {:.2} ate {:.4} = {:.3} % of the path, rotation rms {:.3} deg, \
                     drift end to end {:.3} deg, scale first to last third {:.4}",
                    places.len() as f64 / n_frames as f64,
                    score.path,
                    score.ate,
                    100.0 * score.ate / score.path,
                    score.rotation_rms_deg,
                    score.rotation_drift_deg,
                    score.scale_drift,
                ),
                None => println!("submap {submap}: {} frames, not enough to align", places.len()),
            }
        }
    }

    fn to_tum(&self, sequence: &Sequence) -> String {
        let mut text = String::new();
        for (index, pose) in self.0.values().flatten() {
            let (t, q, ns) = (pose.translation, pose.rotation.coords, sequence.timestamp_ns(*index));
            let _ = writeln!(
                text,
                "{}.{:09} {} {} {} {} {} {} {}",
                ns / 1_000_000_000,
                ns % 1_000_000_000,
                t.x,
                t.y,
                t.z,
                q.x,
                q.y,
                q.z,
                q.w
            );
        }
        text
    }
}

/// How a trajectory compares with the truth after it was aligned by one similarity.
struct Score {
    /// Length of the true path, units of the world.
    path: f64,
    /// Root mean square distance, units of the world.
    ate: f64,
    rotation_rms_deg: f64,
    /// Turn of the estimate against the truth from the first frame to the last.
    rotation_drift_deg: f64,
    /// Scale of the last third against that of the first.
    scale_drift: f64,
}

impl Score {
    fn of(places: &BTreeMap<usize, Pose>, sequence: &Sequence) -> Option<Self> {
        let truth: Vec<Pose> =
            places.keys().map(|index| sequence.camera_from_world(*index).inverse()).collect();
        let positions = |poses: &[Pose]| poses.iter().map(|pose| pose.translation).collect::<Vec<_>>();
        let estimate: Vec<Pose> = places.values().copied().collect();
        let (seen, wanted) = (positions(&estimate), positions(&truth));
        let aligned = Similarity::from_correspondences(&seen, &wanted, true)?;
        let n = seen.len() as f64;
        let squared: f64 =
            seen.iter().zip(&wanted).map(|(e, t)| (aligned.transform(e) - t).norm_squared()).sum();
        let turns: Vec<UnitQuaternion<f64>> = estimate
            .iter()
            .zip(&truth)
            .map(|(e, t)| (aligned.rotation * e.rotation) * t.rotation.inverse())
            .collect();
        let third = seen.len() / 3;
        let length =
            |points: &[Vector3<f64>]| points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>();
        let scale = |range: std::ops::Range<usize>| {
            Similarity::from_correspondences(&wanted[range.clone()], &seen[range], true)
                .map_or(f64::NAN, |seen_from_wanted| seen_from_wanted.scale)
        };
        Some(Self {
            path: length(&wanted),
            ate: (squared / n).sqrt(),
            rotation_rms_deg: (turns.iter().map(|turn| turn.angle().powi(2)).sum::<f64>() / n)
                .sqrt()
                .to_degrees(),
            rotation_drift_deg: (turns.last()? * turns.first()?.inverse()).angle().to_degrees(),
            scale_drift: scale(2 * third..seen.len()) / scale(0..third),
        })
    }
}
