//! Lines of many rendered rooms against their true edges, and what each verification step turned away.
//!
//! The figures in `docs/lines.md` are printed by
//! `cargo test -p slam --test line_truth -- --ignored --nocapture`.

use slam::LineVerdict;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use synthetic::{Preset, Sequence};
use testkit::{LineError, Session, inline, largest_submap, line_error, truth_from_map};

/// A line of the map is right within this angle, degrees, and this distance, world units (metres).
const RIGHT: (f64, f64) = (1.0, 0.02);
/// A candidate is true if it lies within this angle, degrees, of an edge...
const TRUE_ANGLE_DEG: f64 = 5.0;
/// ...and this share of its distance from the camera: what local bundle adjustment puts right.
const TRUE_DISTANCE_SHARE: f64 = 0.05;

/// What a sequence, or several, came to.
#[derive(Clone, Debug, Default)]
struct Tally {
    n_lines: usize,
    /// Of the map's lines that run along an edge at all.
    errors: Vec<LineError>,
    /// False and true candidates by what became of them.
    candidates: BTreeMap<LineVerdict, [usize; 2]>,
}

impl Tally {
    fn of(sequence: &Sequence, frames: impl Iterator<Item = usize>) -> Self {
        let mut session = Session::new(inline(3), sequence.camera());
        session.show_frames(sequence, frames);
        let map = session.finish();
        let mut tally = Self::default();
        let Some((submap, truth_from_map)) = largest_submap(&map).zip(truth_from_map(&map, sequence)) else {
            return tally;
        };
        for line in map.lines().filter(|line| line.submap == submap) {
            tally.n_lines += 1;
            let ends = line.endpoints.map(|end| truth_from_map.transform(&end));
            tally.errors.extend(line_error(&ends, sequence.world()));
        }
        let judgements = session.pipeline.take_line_judgements();
        for judgement in judgements.iter().filter(|judgement| judgement.submap == submap) {
            // From the true camera, so that only the candidate's own error counts, not the map's drift.
            let world_from_camera = sequence.camera_from_world(judgement.sequence as usize).inverse();
            let ends = judgement
                .endpoints_in_camera
                .map(|end| world_from_camera.transform(&(end * truth_from_map.scale)));
            let distance = ((ends[0] + ends[1]) / 2.0 - world_from_camera.translation).norm();
            let is_true = line_error(&ends, sequence.world()).is_some_and(|error| {
                error.angle_deg < TRUE_ANGLE_DEG && error.distance < TRUE_DISTANCE_SHARE * distance
            });
            tally.candidates.entry(judgement.verdict).or_default()[usize::from(is_true)] += 1;
        }
        tally
    }

    fn add(&mut self, other: &Self) {
        self.n_lines += other.n_lines;
        self.errors.extend(&other.errors);
        for (verdict, counts) in &other.candidates {
            let sum = self.candidates.entry(*verdict).or_default();
            *sum = [sum[0] + counts[0], sum[1] + counts[1]];
        }
    }

    /// Every step that has anything to remove removes more false candidates than true ones.
    fn check_steps(&self) {
        for step in [LineVerdict::Reprojection, LineVerdict::Sensitivity, LineVerdict::Overlap] {
            let [n_false, n_true] = self.candidates.get(&step).copied().unwrap_or_default();
            assert!(
                n_false > n_true || (step == LineVerdict::Overlap && n_true == 0),
                "{}: removed {n_false} false lines and {n_true} true ones",
                step.name()
            );
        }
    }

    fn median(&self, value: impl Fn(&LineError) -> f64) -> f64 {
        let mut values: Vec<f64> = self.errors.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    fn share_right(&self) -> f64 {
        let is_right = |error: &&LineError| error.angle_deg < RIGHT.0 && error.distance < RIGHT.1;
        self.errors.iter().filter(is_right).count() as f64 / self.n_lines.max(1) as f64
    }

    fn line(&self) -> String {
        format!(
            "{} lines, median {:.2} degrees and {:.4} m off, {:.0} % within {} degree and {} m",
            self.n_lines,
            self.median(|error| error.angle_deg),
            self.median(|error| error.distance),
            100.0 * self.share_right(),
            RIGHT.0,
            RIGHT.1,
        )
    }
}

/// Every `step`-th frame of each seed's sequence, on as many threads as there are cores.
fn study(preset: Preset, seeds: std::ops::RangeInclusive<u64>, n_frames: usize, step: usize) -> Tally {
    let seeds: Vec<u64> = seeds.collect();
    let (next, tallies) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    let n_threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..n_threads {
            scope.spawn(|| {
                while let Some(seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let sequence = Sequence::preset(preset, *seed);
                    let tally = Tally::of(&sequence, (0..n_frames).map(|i| i * step));
                    tallies.lock().unwrap().insert(*seed, tally);
                }
            });
        }
    });
    let mut sum = Tally::default();
    for (seed, tally) in tallies.into_inner().unwrap() {
        println!("{} {seed}: {}", preset.name(), tally.line());
        sum.add(&tally);
    }
    println!("{} {} to {}: {}", preset.name(), seeds[0], seeds[seeds.len() - 1], sum.line());
    for (verdict, [n_false, n_true]) in &sum.candidates {
        println!("  {}: {n_false} false, {n_true} true", verdict.name());
    }
    sum
}

/// Every sixth of 300 frames, once round the room at five frames a second: at the full rate, segments that
/// are followed from frame to frame hardly ever go astray, and verification would have little to show.
#[test]
fn lines_of_twenty_poor_rooms_are_true_and_verification_removes_false_ones() {
    let sum = study(Preset::RoomPoor, 1..=20, 50, 6);
    assert!(sum.n_lines >= 20 * 60, "only {} lines", sum.n_lines);
    let (angle_deg, distance) = (sum.median(|error| error.angle_deg), sum.median(|error| error.distance));
    assert!(angle_deg < 0.2 && distance < 0.02, "median error {angle_deg:.2} degrees, {distance:.4} m");
    assert!(sum.share_right() > 0.5, "{:.2} within 1 degree and 2 cm", sum.share_right());
    sum.check_steps();
}

#[test]
#[ignore = "takes minutes: prints the figures of docs/lines.md"]
fn figures_of_many_rooms_and_corridors() {
    study(Preset::RoomPoor, 1..=60, 75, 2).check_steps();
    study(Preset::RoomPoor, 1..=20, 75, 4).check_steps();
    study(Preset::CorridorStraight, 1..=6, 100, 1);
}
