//! Finding the map's lines among the segments of a view by the track a segment belongs to.
//! [method: Line tracking by optical flow; Pose from the last frame]

use super::frame::TrackedFrame;
use crate::config::LineConfig;
use crate::map::{Keyframe, LineId, Map};
use crate::matching::PredictedSegment;
use std::collections::{BTreeMap, BTreeSet};

/// A segment of a known track may lie this many search radii from where its line is expected: the robust pose
/// decides.
const TRACK_RADIUS_FACTOR: f64 = 4.0;
/// Keyframes, counted from the newest, whose segments tell which track sees which line.
const N_TRACK_KEYFRAMES: usize = 5;

/// Which track of segments sees which line.
#[derive(Clone, Debug, Default)]
pub(super) struct LineTracks {
    lines: BTreeMap<u64, LineId>,
}

/// The keyframes that tell what the live tracks are, oldest first.
pub(super) fn newest_keyframes(map: &Map) -> Vec<&Keyframe> {
    let mut keyframes: Vec<&Keyframe> = map.keyframes().collect();
    keyframes.split_off(keyframes.len().saturating_sub(N_TRACK_KEYFRAMES))
}

impl LineTracks {
    /// Takes over what mapping found out about the tracks of the newest keyframes.
    pub fn update(&mut self, map: &Map) {
        for keyframe in newest_keyframes(map) {
            for (idx, id) in keyframe.observed_lines() {
                self.lines.insert(keyframe.features.lines[idx].track, id);
            }
        }
    }

    /// Keeps what a placed frame knows of its own tracks.
    pub fn remember(&mut self, frame: &TrackedFrame) {
        for (segment, line) in frame.features.lines.iter().zip(&frame.lines) {
            match line {
                Some(id) => self.lines.insert(segment.track, *id),
                None => self.lines.remove(&segment.track),
            };
        }
        let live: BTreeSet<u64> = frame.features.lines.iter().map(|segment| segment.track).collect();
        self.lines.retain(|track, _| live.contains(track));
    }

    /// Gives segments of known tracks their lines, where that is anywhere near what the pose says.
    pub fn associate(&self, frame: &mut TrackedFrame, map: &Map, config: &LineConfig) {
        let mut taken: BTreeSet<LineId> = frame.lines.iter().flatten().copied().collect();
        let min_cosine = (2.0 * config.search_angle_deg).to_radians().cos();
        let features = frame.features.clone();
        for (idx, segment) in features.lines.iter().enumerate() {
            if frame.lines[idx].is_some() {
                continue;
            }
            let Some(line) = self.lines.get(&segment.track).and_then(|id| map.line(*id)) else { continue };
            let Some(expected) = PredictedSegment::of(&line.endpoints, &frame.camera_from_world, &features)
            else {
                continue;
            };
            let radius = TRACK_RADIUS_FACTOR * config.search_radius_px;
            if expected.compare(segment, radius, min_cosine, 0.0).is_some() && taken.insert(line.id) {
                frame.lines[idx] = Some(line.id);
            }
        }
    }
}
