//! A camera that is covered and moved: two submaps, one again as soon as they meet.

use geometry::Similarity;
use geometry::nalgebra::Vector3;
use slam::map::FrameRecord;
use slam::{Frame, FrameReport, MapEvent, MapUpdate, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use synthetic::{Preset, Sequence};
use vision::GrayImage;

/// Every second frame of a walk around a room.
const STEP: usize = 2;
const INTERVAL_NS: i64 = 100_000_000;
/// Frames for which the lens is covered: three seconds.
const N_COVERED: u64 = 30;
/// Share of the path that the whole may be off by, root mean square.
const MAX_ERROR_SHARE: f64 = 0.02;

struct Session {
    sequence: Sequence,
    pipeline: Pipeline,
    records: BTreeMap<u64, FrameRecord>,
    /// Which view of the walk each frame showed.
    views: BTreeMap<u64, usize>,
    next: u64,
}

impl Session {
    fn new(seed: u64) -> Self {
        let sequence = Sequence::preset(Preset::RoomRich, seed);
        let config = SlamConfig { threading: Threading::Inline, seed, ..SlamConfig::default() };
        let clock = Arc::new(NoClock);
        let pipeline =
            Pipeline::resume(config, sequence.camera().clone(), clock, ResumeState::default()).unwrap();
        Self { sequence, pipeline, records: BTreeMap::new(), views: BTreeMap::new(), next: 0 }
    }

    fn show(&mut self, view: usize) -> FrameReport {
        let rendered = self.sequence.frame(view).image;
        let (width, height) = (rendered.width(), rendered.height());
        self.views.insert(self.next, view);
        self.process(GrayImage::from_raw(width, height, rendered.into_pixels()).unwrap())
    }

    fn cover(&mut self) -> FrameReport {
        let (width, height) = (self.sequence.camera().width(), self.sequence.camera().height());
        self.process(GrayImage::from_raw(width, height, vec![9; (width * height) as usize]).unwrap())
    }

    fn process(&mut self, image: GrayImage) -> FrameReport {
        let sequence = self.next;
        self.next += 1;
        let timestamp_ns = sequence as i64 * INTERVAL_NS;
        let report = self.pipeline.process_frame(Frame { sequence, timestamp_ns, image }).unwrap();
        self.store();
        report
    }

    fn store(&mut self) {
        let updates = self.pipeline.take_updates();
        self.store_all(updates);
    }

    fn finish(&mut self) {
        let updates = self.pipeline.finish();
        self.store_all(updates);
    }

    fn store_all(&mut self, updates: Vec<MapUpdate>) {
        for update in updates {
            update.map.check().unwrap();
            self.records.extend(update.frames.iter().map(|record| (record.sequence, *record)));
        }
    }

    /// Error after alignment as a share of the path, root mean square, and how many frames have a pose.
    fn error(&self) -> (f64, usize) {
        let map = self.pipeline.map();
        let place = |record: &FrameRecord| Some(map.locate(&record.pose?)?.1.centre());
        let placed: Vec<(u64, Vector3<f64>)> =
            self.records.iter().filter_map(|(number, record)| Some((*number, place(record)?))).collect();
        let truth_of = |number: u64| self.sequence.camera_from_world(self.views[&number]).centre();
        let estimate: Vec<Vector3<f64>> = placed.iter().map(|(_, position)| *position).collect();
        let truth: Vec<Vector3<f64>> = placed.iter().map(|(number, _)| truth_of(*number)).collect();
        let aligned = Similarity::from_correspondences(&estimate, &truth, true).unwrap();
        let squared: f64 =
            estimate.iter().zip(&truth).map(|(e, t)| (aligned.transform(e) - t).norm_squared()).sum();
        let path: f64 = truth.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        ((squared / placed.len() as f64).sqrt() / path, placed.len())
    }
}

#[test]
fn a_covered_lens_begins_a_submap_that_is_merged_when_the_two_meet() {
    let mut session = Session::new(3);
    let (n_first, far) = (30, 150);
    let first: Vec<FrameReport> = (0..n_first).map(|i| session.show(i * STEP)).collect();
    assert!(first.last().unwrap().world_from_camera.is_some());

    let covered: Vec<FrameReport> = (0..N_COVERED).map(|_| session.cover()).collect();
    for report in &covered {
        assert!(report.world_from_camera.is_none(), "a covered lens shows no place");
        assert!(!report.outcome.reason().is_empty(), "the user is told why");
    }

    // Elsewhere, and from there back to where it all began.
    let mut submaps = BTreeSet::new();
    let mut merged = None;
    for view in (0..=far).rev() {
        let report = session.show(view * STEP);
        submaps.extend(report.world_from_camera.map(|_| report.submap));
        let is_merger = |event: &MapEvent| matches!(event, MapEvent::SubmapsMerged { .. });
        if merged.is_none() && report.map_events.iter().any(is_merger) {
            merged = Some(view);
        }
    }
    session.finish();
    let map = session.pipeline.map();
    map.check().unwrap();

    let merged = merged.expect("the submaps met");
    assert!(submaps.len() == 2, "submaps {submaps:?}");
    assert_eq!(map.submaps().len(), 1, "one frame of reference in the end");
    let (error, n_placed) = session.error();
    let n_shown = session.views.len();
    println!(
        "merged at view {merged}, error {:.3} % of the path, {n_placed} of {n_shown} frames",
        100.0 * error
    );
    assert!(error < MAX_ERROR_SHARE, "error {:.2} % of the path", 100.0 * error);
    assert!(n_placed * 100 >= n_shown * 97, "{n_placed} of {n_shown} frames have a pose");
}
