//! What the engine reports of the frames.

use slam::map::FrameRecord;
use slam::{FrameReport, Map, MapEvent};
use std::collections::BTreeMap;
use testkit::laboratory::summary;

/// What came of the frames.
#[derive(Default)]
pub struct Run {
    pub records: BTreeMap<u64, FrameRecord>,
    states: BTreeMap<String, usize>,
    n_relocalized: usize,
    pub n_loops: usize,
    pub n_merges: usize,
    /// The last change of the camera that was told: of the focal length, as a share of it, and its standard
    /// deviation.
    pub camera: Option<[f64; 2]>,
    cpu_ms: Vec<f64>,
    wall_ms: Vec<f64>,
    /// Taking over the newest map, corrections among it.
    adopt_ms: Vec<f64>,
}

impl Run {
    pub fn note(&mut self, report: &FrameReport) {
        *self.states.entry(format!("{:?}", report.outcome.state())).or_default() += 1;
        self.n_relocalized += usize::from(report.relocalized);
        for event in &report.map_events {
            match event {
                MapEvent::LoopClosed { .. } => self.n_loops += 1,
                MapEvent::SubmapsMerged { .. } => self.n_merges += 1,
                MapEvent::CalibrationRefined { correction, focal_sigma } => {
                    self.camera = Some([correction.focal, *focal_sigma]);
                }
                MapEvent::CalibrationContradicted { .. }
                | MapEvent::CalibrationUndetermined { .. }
                | MapEvent::ReadoutFound(_) => {}
            }
        }
        self.cpu_ms.push(report.cpu_ns as f64 * 1e-6);
        self.wall_ms.push(report.wall_ns as f64 * 1e-6);
        let adoption = report.stages.iter().filter(|stage| stage.name == "adopt");
        self.adopt_ms.push(adoption.map(|stage| stage.wall_ns as f64 * 1e-6).sum());
    }

    pub fn store(&mut self, updates: Vec<slam::MapUpdate>) {
        for update in updates {
            self.records.extend(update.frames.iter().map(|record| (record.sequence, record.clone())));
        }
    }

    pub fn print(mut self, map: &Map) {
        println!(
            "frames {:?} relocalised {} loops {} merges {}",
            self.states, self.n_relocalized, self.n_loops, self.n_merges
        );
        println!(
            "map: keyframes {} (made {}) points {} lines {} primitives {} submaps {:?}",
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
