//! Whether poses are what their state says: "tracked" should mean that the pose is right.

use recordings::{StampedPose, Trajectory, pose_errors};
use slam::Map;
use slam::map::{FrameRecord, FrameState, SubmapId};
use std::collections::BTreeMap;

/// Poses further apart in time than this are not of the same image, nanoseconds: less than half the interval
/// of every recording.
const MAX_DT_NS: i64 = 10_000_000;

/// What became of the frames of one state.
#[derive(Debug, Default)]
struct Row {
    n_frames: usize,
    n_measured: usize,
    n_wrong: usize,
    worst_deg: f64,
    worst_share: f64,
}

/// A table of the states: frames, those with a truth, and those of them that are off by more than 5 degrees
/// or 5 % of the path. Each submap is aligned with the truth by itself.
pub fn table(records: &BTreeMap<u64, FrameRecord>, map: &Map, truth: &Trajectory) -> String {
    let mut rows: BTreeMap<&str, Row> = BTreeMap::new();
    let mut submaps: BTreeMap<SubmapId, Vec<StampedPose>> = BTreeMap::new();
    for record in records.values() {
        rows.entry(name(record)).or_default().n_frames += 1;
        let Some((submap, camera_from_world)) = record.pose.and_then(|pose| map.locate(&pose)) else {
            continue;
        };
        let world_from_camera = camera_from_world.inverse();
        let pose = StampedPose { timestamp_ns: record.timestamp_ns, world_from_camera };
        submaps.entry(submap).or_default().push(pose);
    }
    let names: BTreeMap<i64, &str> =
        records.values().map(|record| (record.timestamp_ns, name(record))).collect();
    for poses in submaps.into_values() {
        for error in pose_errors(truth, &Trajectory::new(poses), MAX_DT_NS) {
            let row = rows.entry(names[&error.timestamp_ns]).or_default();
            row.n_measured += 1;
            row.n_wrong += usize::from(error.is_wrong());
            row.worst_deg = row.worst_deg.max(error.attitude_deg);
            row.worst_share = row.worst_share.max(error.position_share);
        }
    }
    let mut text = String::from(
        "| state | frames | with truth | off by more than 5 degrees or 5 % of the path | worst attitude, degrees \
         | worst position, % of the path |\n| --- | ---: | ---: | ---: | ---: | ---: |\n",
    );
    for (name, row) in rows {
        let share = 100.0 * row.n_wrong as f64 / row.n_measured.max(1) as f64;
        text += &format!(
            "| {name} | {} | {} | {} ({share:.1} %) | {:.1} | {:.1} |\n",
            row.n_frames,
            row.n_measured,
            row.n_wrong,
            row.worst_deg,
            100.0 * row.worst_share,
        );
    }
    text
}

fn name(record: &FrameRecord) -> &'static str {
    match record.state {
        FrameState::Tracked if record.backfilled => "tracked, placed afterwards",
        FrameState::Tracked => "tracked",
        FrameState::Weak => "weak",
        FrameState::Initialising => "initializing",
        FrameState::Lost => "lost",
    }
}
