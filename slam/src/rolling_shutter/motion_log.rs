//! How the camera moved when keyframes were taken, by the frames beside them. [method: Rolling shutter]

use super::{RollingShutter, Velocity};
use crate::map::{FramePose, FrameRecord, FrameState, Keyframe, KeyframeId, Map, SubmapId};
use geometry::Pose;
use std::collections::BTreeMap;

/// Frames that are kept; the oldest go when there are more. Some two minutes, longer than a readout is looked
/// for.
const MAX_FRAMES: usize = 4000;

/// How the camera moved at keyframes.
pub(crate) type Motions = BTreeMap<KeyframeId, Velocity>;

/// Where frames were taken, as long as it matters how the camera moved between them.
#[derive(Debug, Default)]
pub(crate) struct MotionLog {
    /// By time, nanoseconds.
    frames: BTreeMap<i64, FramePose>,
}

impl MotionLog {
    /// Takes note of frames that were placed; poor poses jump about and are passed over.
    pub fn note(&mut self, records: &[FrameRecord]) {
        for record in records {
            match record.pose.filter(|_| record.state == FrameState::Tracked) {
                Some(pose) => self.frames.insert(record.timestamp_ns, pose),
                None => self.frames.remove(&record.timestamp_ns),
            };
        }
        while self.frames.len() > MAX_FRAMES {
            self.frames.pop_first();
        }
    }

    /// How the camera moved at the keyframes of a submap, those that have frames beside them.
    pub fn motions(&self, map: &Map, submap: SubmapId) -> Motions {
        let motion = |keyframe: &Keyframe| Some((keyframe.id, self.velocity_at(keyframe, map)?));
        map.keyframes_of(submap).filter_map(motion).collect()
    }

    /// As between the frames before and after, whichever there are.
    fn velocity_at(&self, keyframe: &Keyframe, map: &Map) -> Option<Velocity> {
        let now_ns = keyframe.timestamp_ns;
        let located = |(time_ns, place): (&i64, &FramePose)| {
            let (submap, pose) = map.locate(place)?;
            (submap == keyframe.submap).then_some((*time_ns, pose))
        };
        let before = self.frames.range(..now_ns).next_back().and_then(located);
        let after = self.frames.range(now_ns + 1..).next().and_then(located);
        let to = |(time_ns, pose): (i64, Pose)| {
            let motion = pose * keyframe.camera_from_world.inverse();
            Some((RollingShutter::velocity(&motion, time_ns - now_ns)?, (time_ns - now_ns).abs() as f64))
        };
        match (before.and_then(to), after.and_then(to)) {
            // The nearer one counts for more: the motion of a smooth way at this time.
            (Some((before, since)), Some((after, until))) => {
                Some((before * until + after * since) / (since + until))
            }
            (one, other) => one.or(other).map(|(velocity, _)| velocity),
        }
    }
}
