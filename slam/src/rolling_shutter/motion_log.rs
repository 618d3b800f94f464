//! How the camera moved when keyframes were taken, by the frames beside them. [method: Rolling shutter]

use super::{MAX_INTERVAL_NS, Velocity};
use crate::map::{FramePose, FrameRecord, FrameState, Keyframe, KeyframeId, Map};
use std::collections::BTreeMap;

/// Frames that are kept; the oldest go when there are more. Some two minutes, longer than a readout is looked
/// for.
const MAX_FRAMES: usize = 4000;

/// Frames that are looked at to either side of a keyframe.
const N_BESIDE: usize = 2;

/// How the camera moved at a keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    pub velocity: Velocity,
    /// Whether there are frames before and after the keyframe, so that it will not be known better.
    pub is_between: bool,
}

/// How the camera moved at keyframes.
pub(crate) type Motions = BTreeMap<KeyframeId, Motion>;

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

    /// How the camera moved at those keyframes that have frames beside them.
    pub fn motions<'a>(&self, map: &Map, keyframes: impl Iterator<Item = &'a Keyframe>) -> Motions {
        keyframes.filter_map(|keyframe| Some((keyframe.id, self.motion_at(keyframe, map)?))).collect()
    }

    /// The derivative of a smooth way through the places of the frames beside the keyframe: of a polynomial
    /// through as many as there are, two before and two after it at most.
    fn motion_at(&self, keyframe: &Keyframe, map: &Map) -> Option<Motion> {
        let now_ns = keyframe.timestamp_ns;
        let from_now = |(time_ns, place): (&i64, &FramePose)| {
            let (submap, pose) = map.locate(place)?;
            let interval_ns = *time_ns - now_ns;
            let is_beside = submap == keyframe.submap && interval_ns.abs() <= MAX_INTERVAL_NS;
            is_beside.then(|| (interval_ns as f64, (pose * keyframe.camera_from_world.inverse()).log()))
        };
        let before = self.frames.range(..now_ns).rev().take(N_BESIDE).map_while(from_now);
        let after = self.frames.range(now_ns + 1..).take(N_BESIDE).map_while(from_now);
        let beside: Vec<(f64, Velocity)> = before.chain(after).collect();
        let is_between =
            beside.iter().any(|(time, _)| *time < 0.0) && beside.iter().any(|(time, _)| *time > 0.0);
        (!beside.is_empty()).then(|| Motion { velocity: derivative_at_zero(&beside), is_between })
    }
}

/// The derivative at 0 of the polynomial that is 0 there and has these values at these times.
fn derivative_at_zero(places: &[(f64, Velocity)]) -> Velocity {
    let weight = |idx: usize| {
        let (own, _) = places[idx];
        let others = places.iter().enumerate().filter(|(other, _)| *other != idx);
        others.map(|(_, (time, _))| time / (time - own)).product::<f64>() / own
    };
    places.iter().enumerate().map(|(idx, (_, place))| place * weight(idx)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_velocity_of_a_smooth_way_is_found_between_uneven_times() {
        let rate = Velocity::new(0.3, -0.2, 0.1, 1.0, 2.0, -3.0);
        let place = |time: f64| rate * (time + 0.4 * time.powi(2) - 0.3 * time.powi(3) + 0.2 * time.powi(4));
        for times in [vec![-0.2, -0.1, 0.1, 0.25], vec![-0.1, 0.1, 0.2], vec![0.01]] {
            let places: Vec<(f64, Velocity)> = times.iter().map(|time| (*time, place(*time))).collect();
            let tolerance = if times.len() == 4 { 1e-12 } else { 0.03 };
            let found = derivative_at_zero(&places);
            assert!((found - rate).norm() < tolerance * rate.norm(), "{times:?}: {found}");
        }
    }
}
