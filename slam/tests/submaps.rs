//! A camera that is covered and moved: two submaps, one again as soon as they meet.

use slam::{FrameReport, MapEvent};
use std::collections::{BTreeMap, BTreeSet};
use synthetic::{Preset, Sequence};
use testkit::{Session, evaluate, gray_image, inline};
use vision::GrayImage;

/// Every second frame of a walk around a room.
const STEP: usize = 2;
const INTERVAL_NS: i64 = 100_000_000;
/// Frames for which the lens is covered: three seconds.
const N_COVERED: u64 = 30;
/// Share of the path that the whole may be off by, root mean square.
const MAX_ERROR_SHARE: f64 = 0.02;

struct Walk {
    sequence: Sequence,
    session: Session,
    /// Which view of the walk each frame showed.
    views: BTreeMap<u64, usize>,
    next: u64,
}

impl Walk {
    fn new(seed: u64) -> Self {
        let sequence = Sequence::preset(Preset::RoomRich, seed);
        let session = Session::new(inline(seed), sequence.camera());
        Self { sequence, session, views: BTreeMap::new(), next: 0 }
    }

    fn show(&mut self, view: usize) -> FrameReport {
        self.views.insert(self.next, view);
        self.process(gray_image(self.sequence.frame(view).image))
    }

    fn cover(&mut self) -> FrameReport {
        let camera = self.sequence.camera();
        self.process(GrayImage::from_fn(camera.width(), camera.height(), |_, _| 9))
    }

    fn process(&mut self, image: GrayImage) -> FrameReport {
        let number = self.next;
        self.next += 1;
        self.session.show(number, number as i64 * INTERVAL_NS, image)
    }

    /// Error after alignment as a share of the path, root mean square, and how many frames have a pose.
    fn error(&self) -> (f64, usize) {
        let truth = |number: u64| self.sequence.camera_from_world(self.views[&number]).inverse();
        let evaluation = evaluate(&self.session.trajectory(), truth).unwrap();
        (evaluation.ate_rmse / evaluation.path, evaluation.matched)
    }
}

#[test]
fn a_covered_lens_begins_a_submap_that_is_merged_when_the_two_meet() {
    let mut walk = Walk::new(3);
    let (n_first, far) = (30, 150);
    let first: Vec<FrameReport> = (0..n_first).map(|i| walk.show(i * STEP)).collect();
    assert!(first.last().unwrap().world_from_camera.is_some());

    let covered: Vec<FrameReport> = (0..N_COVERED).map(|_| walk.cover()).collect();
    for report in &covered {
        assert!(report.world_from_camera.is_none(), "a covered lens shows no place");
        assert!(!report.outcome.reason().is_empty(), "the user is told why");
    }

    // Elsewhere, and from there back to where it all began.
    let mut submaps = BTreeSet::new();
    let mut merged = None;
    for view in (0..=far).rev() {
        let report = walk.show(view * STEP);
        submaps.extend(report.world_from_camera.map(|_| report.submap));
        let is_merger = |event: &MapEvent| matches!(event, MapEvent::SubmapsMerged { .. });
        if merged.is_none() && report.map_events.iter().any(is_merger) {
            merged = Some(view);
        }
    }
    let map = walk.session.finish();

    let merged = merged.expect("the submaps met");
    assert!(submaps.len() == 2, "submaps {submaps:?}");
    assert_eq!(map.submaps().len(), 1, "one frame of reference in the end");
    let (error, n_placed) = walk.error();
    let n_shown = walk.views.len();
    println!(
        "merged at view {merged}, error {:.3} % of the path, {n_placed} of {n_shown} frames",
        100.0 * error
    );
    assert!(error < MAX_ERROR_SHARE, "error {:.2} % of the path", 100.0 * error);
    assert!(n_placed * 100 >= n_shown * 97, "{n_placed} of {n_shown} frames have a pose");
}
