//! Runs the engine over a rendered sequence whose truth is known and prints how well it did.
//!
//! `cargo run --release -p slam --example primitives_synthetic -- PRESET SEED [--inline] [--frames N] [--engine-seed N] [--no-lines]
//! [--no-primitives] [--verbose] [--out TRAJECTORY.txt] [--images FOLDER]`
//!
//! Rendering takes longer than tracking: `--images` keeps the images of this preset and seed for the next run.
//!
//! Presets: room-rich, room-poor, corridor-straight, corridor-ring, corridor-corners, four-rooms, atlanta, unstructured, look-alike.

use geometry::nalgebra::{UnitQuaternion, Vector3};
use geometry::{Direction, Pose, Similarity};
use slam::map::{FrameRecord, Keyframe, SubmapId, VanishingObservation};
use slam::{Clock, Frame, FrameReport, Map, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use synthetic::{Preset, Sequence};
use tracing::span::{Attributes, Id};
use tracing::{Event, Metadata, Subscriber};
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
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| arguments.iter().any(|argument| argument == name);
    let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1));
    let [preset, seed, ..] = arguments.as_slice() else {
        return Err("usage: primitives_synthetic PRESET SEED".into());
    };
    let seed: u64 = seed.parse()?;
    let sequence = Sequence::preset(preset.parse::<Preset>()?, seed);
    let engine_seed = value("--engine-seed").map_or(Ok(seed), |seed| seed.parse())?;
    let mut config = SlamConfig { seed: engine_seed, ..SlamConfig::default() };
    config.threading = if flag("--inline") { Threading::Inline } else { Threading::Background };
    config.features.lines = !flag("--no-lines");
    config.features.global_primitives = !flag("--no-primitives");
    let spans = Arc::new(SpanTimes::default());
    tracing::subscriber::set_global_default(spans.clone())?;
    let clock = Arc::new(WallClock(Instant::now()));
    let mut pipeline = Pipeline::resume(config, sequence.camera().clone(), clock, ResumeState::default())?;

    let n_frames = value("--frames").map_or(Ok(sequence.len()), |n| n.parse())?.min(sequence.len());
    let mut run = Run::default();
    for index in 0..n_frames {
        let image = image(&sequence, index, value("--images").map(Path::new))?;
        let frame = Frame { sequence: index as u64, timestamp_ns: sequence.timestamp_ns(index), image };
        let report = pipeline.process_frame(frame)?;
        if flag("--verbose") {
            println!(
                "{index} {:?} submap {} keypoints {} points {} lines {} keyframe {} {}",
                report.outcome.state(),
                report.submap,
                report.n_keypoints,
                report.n_inlier_points,
                report.n_inlier_lines,
                report.is_keyframe,
                report.outcome.reason(),
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
    run.print(&map);
    places.print(&sequence, n_frames);
    print_primitives(&map, &sequence);
    print_segments(&map, &sequence);
    spans.print();
    Ok(())
}

/// How the primitives and the vanishing points of the key frames lie to the true directions.
fn print_primitives(map: &Map, sequence: &Sequence) {
    let truths = sequence.world().vanishing_directions();
    let nearest = |direction: &Vector3<f64>| {
        let angle = |truth: &Direction| {
            truth.as_vector().cross(direction).norm().atan2(truth.as_vector().dot(direction).abs())
        };
        let angles = truths.iter().enumerate().map(|(idx, truth)| (angle(truth).to_degrees(), idx));
        angles.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NAN, 0))
    };
    let truth = |keyframe: &Keyframe| sequence.camera_from_world(keyframe.sequence as usize).rotation;
    for primitive in map.primitives() {
        // Per sighting: the primitive in the true world by the attitude the key frame has and should have.
        let errors: Vec<(f64, usize)> = primitive
            .observations
            .iter()
            .filter_map(|seen| map.keyframe(seen.keyframe))
            .map(|keyframe| {
                let world_from_map = truth(keyframe).inverse() * keyframe.camera_from_world.rotation;
                nearest(&(world_from_map * primitive.direction.as_vector()))
            })
            .collect();
        let (first, last) = (primitive.observations.first(), primitive.observations.last());
        let n_segments: usize = primitive
            .observations
            .iter()
            .filter_map(|seen| {
                Some(map.keyframe(seen.keyframe)?.vanishing[seen.vanishing_idx as usize].segments.len())
            })
            .sum();
        println!(
            "primitive {}: {} key frames {:?}-{:?}, {n_segments} segments, {} lines, true direction {:?}, off by {}",
            primitive.id,
            primitive.observations.len(),
            first.map(|seen| seen.keyframe.get()),
            last.map(|seen| seen.keyframe.get()),
            map.lines_of_primitive(primitive.id).len(),
            errors.first().map(|error| error.1),
            summary(&mut errors.iter().map(|error| error.0).collect::<Vec<_>>()),
        );
    }
    let (mut errors, mut n_wrong) = (Vec::new(), 0);
    for keyframe in map.keyframes() {
        let in_world = |vanishing: &VanishingObservation| truth(keyframe).inverse() * vanishing.direction;
        for vanishing in keyframe.vanishing.iter().filter(|vanishing| vanishing.primitive.is_some()) {
            match nearest(&in_world(vanishing)).0 {
                error if error < 5.0 => errors.push(error),
                _ => n_wrong += 1,
            }
        }
    }
    println!(
        "vanishing points: {} of a true direction, off by {} deg; {n_wrong} of none",
        errors.len(),
        summary(&mut errors)
    );
}

/// How far the segments of primitives point past their true vanishing points, in their standard deviations, which is
/// 1 in the median absolute deviation if those are right.
fn print_segments(map: &Map, sequence: &Sequence) {
    let truths = sequence.world().vanishing_directions();
    let mut by_truth: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for keyframe in map.keyframes() {
        let pose = sequence.camera_from_world(keyframe.sequence as usize);
        for vanishing in keyframe.vanishing.iter().filter(|vanishing| vanishing.primitive.is_some()) {
            let angle =
                |truth: &Direction| (pose.rotation * truth.as_vector()).cross(&vanishing.direction).norm();
            let nearest = truths.iter().enumerate().min_by(|a, b| angle(a.1).total_cmp(&angle(b.1)));
            let Some((idx, truth)) = nearest.filter(|(_, truth)| angle(truth) < 0.1) else { continue };
            for segment in vanishing.segments.iter().map(|idx| &keyframe.features.lines[*idx as usize]) {
                let middle = (segment.start + segment.end) / 2.0;
                let middle = Vector3::new(middle.x, middle.y, 1.0);
                let end = Vector3::new(segment.end.x, segment.end.y, 1.0);
                let line =
                    middle.cross(&(keyframe.features.pinhole.matrix() * (pose.rotation * truth.as_vector())));
                let distance = line.dot(&end) / line.xy().norm();
                by_truth.entry(idx).or_default().push(distance.abs() / segment.sigma_px);
            }
        }
    }
    for (idx, mut sigmas) in by_truth {
        let n = sigmas.len();
        sigmas.sort_by(f64::total_cmp);
        let at = |share: f64| sigmas[(n as f64 * share) as usize];
        println!(
            "segments of direction {idx}: {n}, off by {:.2} sigma (median / 0.6745), p90 {:.2}, p97 {:.2}",
            at(0.5) / 0.6745,
            at(0.9),
            at(0.97)
        );
    }
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
        std::fs::write(path, &pixels)?;
    }
    GrayImage::from_raw(width, height, pixels).map_err(|error| error.to_string().into())
}

/// Adds up the time spent in each of the engine's spans, and counts what it reports.
#[derive(Default)]
struct SpanTimes(Mutex<Spans>);

#[derive(Default)]
struct Spans {
    names: Vec<&'static str>,
    entered: Vec<Option<Instant>>,
    seconds: Vec<f64>,
    counts: Vec<usize>,
    n_reports: usize,
}

impl SpanTimes {
    fn spans(&self) -> MutexGuard<'_, Spans> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn print(&self) {
        let spans = self.spans();
        for (name, (seconds, n)) in spans.names.iter().zip(spans.seconds.iter().zip(&spans.counts)) {
            println!("{name}: {n} times, {seconds:.3} s in all, {:.2} ms each", 1e3 * seconds / *n as f64);
        }
        println!("stage two refused {} times", spans.n_reports);
    }
}

impl Subscriber for SpanTimes {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target() == "slam::bundle::local"
    }

    fn new_span(&self, attributes: &Attributes<'_>) -> Id {
        let mut spans = self.spans();
        let name = attributes.metadata().name();
        let idx = spans.names.iter().position(|known| *known == name).unwrap_or_else(|| {
            spans.names.push(name);
            spans.entered.push(None);
            spans.seconds.push(0.0);
            spans.counts.push(0);
            spans.names.len() - 1
        });
        Id::from_u64(idx as u64 + 1)
    }

    fn enter(&self, span: &Id) {
        self.spans().entered[span.into_u64() as usize - 1] = Some(Instant::now());
    }

    fn exit(&self, span: &Id) {
        let (now, idx) = (Instant::now(), span.into_u64() as usize - 1);
        let mut spans = self.spans();
        if let Some(entered) = spans.entered[idx].take() {
            spans.seconds[idx] += (now - entered).as_secs_f64();
            spans.counts[idx] += 1;
        }
    }

    fn event(&self, _: &Event<'_>) {
        self.spans().n_reports += 1;
    }

    fn record(&self, _: &Id, _: &tracing::span::Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}
}

/// What came of the frames.
#[derive(Default)]
struct Run {
    records: BTreeMap<u64, FrameRecord>,
    states: BTreeMap<String, usize>,
    n_relocalised: usize,
    cpu_ms: Vec<f64>,
    wall_ms: Vec<f64>,
}

impl Run {
    fn note(&mut self, report: &FrameReport) {
        *self.states.entry(format!("{:?}", report.outcome.state())).or_default() += 1;
        self.n_relocalised += usize::from(report.relocalised);
        self.cpu_ms.push(report.cpu_ns as f64 * 1e-6);
        self.wall_ms.push(report.wall_ns as f64 * 1e-6);
    }

    fn store(&mut self, updates: Vec<slam::MapUpdate>) {
        for update in updates {
            self.records.extend(update.frames.iter().map(|record| (record.sequence, *record)));
        }
    }

    fn print(mut self, map: &Map) {
        println!("frames {:?} relocalised {}", self.states, self.n_relocalised);
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
            "tracking thread: cpu ms {} wall ms {}",
            summary(&mut self.cpu_ms),
            summary(&mut self.wall_ms)
        );
    }
}

fn summary(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied().unwrap_or(0.0);
    format!("median {:.3} p95 {:.3} max {:.3}", at(0.5), at(0.95), at(1.0 - 1e-9))
}

/// The cameras' places by frame number, per submap.
struct Places(BTreeMap<SubmapId, BTreeMap<usize, Pose>>);

impl Places {
    fn of(records: &BTreeMap<u64, FrameRecord>, map: &Map) -> Self {
        let mut places: BTreeMap<SubmapId, BTreeMap<usize, Pose>> = BTreeMap::new();
        for record in records.values() {
            let Some(pose) = record.pose else { continue };
            let Some(reference_from_world) = map.camera_from_world(pose.reference) else { continue };
            let camera_from_world = pose.camera_from_reference * reference_from_world;
            places
                .entry(pose.submap)
                .or_default()
                .insert(record.sequence as usize, camera_from_world.inverse());
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
        let scale = |range: std::ops::Range<usize>| length(&seen[range.clone()]) / length(&wanted[range]);
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
