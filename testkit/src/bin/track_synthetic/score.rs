//! Trajectories against the truth.

use crate::recording::Recording;
use geometry::nalgebra::UnitQuaternion;
use geometry::{Pose, Similarity};
use slam::Map;
use slam::map::{FrameRecord, SubmapId};
use std::collections::BTreeMap;
use testkit::laboratory::write_pose;

/// The cameras' places by frame number, per submap.
pub struct Places(pub BTreeMap<SubmapId, BTreeMap<usize, Pose>>);

impl Places {
    pub fn of(records: &BTreeMap<u64, FrameRecord>, map: &Map) -> Self {
        let mut places: BTreeMap<SubmapId, BTreeMap<usize, Pose>> = BTreeMap::new();
        for record in records.values() {
            let Some((submap, camera_from_world)) = record.pose.and_then(|pose| map.locate(&pose)) else {
                continue;
            };
            places.entry(submap).or_default().insert(record.sequence as usize, camera_from_world.inverse());
        }
        Self(places)
    }

    pub fn print(&self, recording: &Recording, n_frames: usize) {
        let n_posed: usize = self.0.values().map(BTreeMap::len).sum();
        println!("coverage {:.4}", n_posed as f64 / n_frames as f64);
        for (submap, places) in &self.0 {
            match Score::of(places, recording) {
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

    pub fn to_tum(&self, recording: &Recording) -> String {
        let mut text = String::new();
        for (index, pose) in self.0.values().flatten() {
            write_pose(&mut text, recording.timestamp_ns(*index), pose);
        }
        text
    }
}

/// How a trajectory compares with the truth after it was aligned by one similarity.
pub struct Score {
    /// Length of the true path, units of the world.
    pub path: f64,
    /// Root mean square distance, units of the world.
    pub ate: f64,
    pub rotation_rms_deg: f64,
    /// Turn of the estimate against the truth from the first frame to the last.
    pub rotation_drift_deg: f64,
    /// Scale of the last third against that of the first.
    pub scale_drift: f64,
}

impl Score {
    pub fn of(places: &BTreeMap<usize, Pose>, recording: &Recording) -> Option<Self> {
        let truth_of = |index: usize| recording.camera_from_world(index).inverse();
        let by_number = places.iter().map(|(index, pose)| (*index as u64, *pose)).collect();
        let evaluation = testkit::evaluate(&by_number, |number| truth_of(number as usize)).ok()?;
        let truth: Vec<Pose> = places.keys().map(|index| truth_of(*index)).collect();
        let positions = |poses: &[Pose]| poses.iter().map(|pose| pose.translation).collect::<Vec<_>>();
        let estimate: Vec<Pose> = places.values().copied().collect();
        let (seen, wanted) = (positions(&estimate), positions(&truth));
        let aligned = Similarity::from_correspondences(&seen, &wanted, true)?;
        let turns: Vec<UnitQuaternion<f64>> = estimate
            .iter()
            .zip(&truth)
            .map(|(e, t)| (aligned.rotation * e.rotation) * t.rotation.inverse())
            .collect();
        let third = seen.len() / 3;
        let scale = |range: std::ops::Range<usize>| {
            Similarity::from_correspondences(&wanted[range.clone()], &seen[range], true)
                .map_or(f64::NAN, |seen_from_wanted| seen_from_wanted.scale)
        };
        Some(Self {
            path: evaluation.path,
            ate: evaluation.ate_rmse,
            rotation_rms_deg: evaluation.rot_rmse_deg,
            rotation_drift_deg: (turns.last()? * turns.first()?.inverse()).angle().to_degrees(),
            scale_drift: scale(2 * third..seen.len()) / scale(0..third),
        })
    }
}
