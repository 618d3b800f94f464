//! How the camera moved when keyframes were taken, by the frames beside them. [method: Rolling shutter]

use super::{MAX_INTERVAL_NS, Velocity};
use crate::map::{FramePose, FrameRecord, FrameState, Keyframe, KeyframeId, Map};
use geometry::Pose;
use std::collections::BTreeMap;

/// Frames that are kept; the oldest go when there are more. Some two minutes, longer than a readout is looked
/// for.
const MAX_FRAMES: usize = 4000;

/// Frames that are looked at to either side of a keyframe.
const N_BESIDE: usize = 2;

/// How the camera moved at keyframes.
pub(crate) type Motions = BTreeMap<KeyframeId, Velocity>;

/// How the camera moved from frame to frame, as it was when they were tracked: adjustment moves keyframes one
/// against the other by more than the camera moves while an image is read.
#[derive(Debug, Default)]
pub(crate) struct MotionLog {
    /// By time, nanoseconds.
    frames: BTreeMap<i64, Noted>,
}

/// A frame that was placed.
#[derive(Debug)]
struct Noted {
    place: FramePose,
    from_before: Option<Step>,
}

/// The way from one frame to the next.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// `camera_after_from_camera_before`.
    motion: Pose,
    /// The [local scale](Keyframe::local_scale) it was measured in.
    local_scale: f64,
}

impl MotionLog {
    /// Takes note of frames that were placed, in the map that they were placed in; poor poses jump about and
    /// are passed over, and so is an image that was sent twice, which is where it was to the last bit.
    pub fn note(&mut self, records: &[FrameRecord], map: &Map) {
        for record in records {
            let before = self.frames.range(..record.timestamp_ns).next_back().map(|(_, before)| before.place);
            let is_good = |place: &FramePose| record.state == FrameState::Tracked && before != Some(*place);
            match record.pose.filter(is_good) {
                Some(place) => self.frames.insert(record.timestamp_ns, Noted { place, from_before: None }),
                None => self.frames.remove(&record.timestamp_ns),
            };
        }
        for record in records {
            let after_ns = self.frames.range(record.timestamp_ns + 1..).next().map(|(time_ns, _)| *time_ns);
            for time_ns in [Some(record.timestamp_ns), after_ns].into_iter().flatten() {
                let step = self.step_to(time_ns, map);
                self.frames.entry(time_ns).and_modify(|noted| noted.from_before = step);
            }
        }
        while self.frames.len() > MAX_FRAMES {
            self.frames.pop_first();
        }
    }

    /// A frame is where it is put from now on; how the camera came there stays.
    pub fn settle(&mut self, time_ns: i64, place: FramePose) {
        self.frames.entry(time_ns).and_modify(|noted| noted.place = place);
    }

    /// How the camera moved at those keyframes that have frames beside them.
    pub fn motions<'a>(&self, keyframes: impl Iterator<Item = &'a Keyframe>) -> Motions {
        keyframes.filter_map(|keyframe| Some((keyframe.id, self.velocity_at(keyframe)?))).collect()
    }

    /// From the frame before, if they are in one submap and not far apart in time.
    fn step_to(&self, time_ns: i64, map: &Map) -> Option<Step> {
        let place = &self.frames.get(&time_ns)?.place;
        let (before_ns, before) = self.frames.range(..time_ns).next_back()?;
        let (submap, camera_from_world) = map.locate(place)?;
        let (submap_before, before_from_world) = map.locate(&before.place)?;
        let is_near = submap == submap_before && time_ns - before_ns <= MAX_INTERVAL_NS;
        let motion = camera_from_world * before_from_world.inverse();
        let local_scale = map.anchor_of(place.reference)?.local_scale;
        is_near.then_some(Step { motion, local_scale })
    }

    /// The derivative of a smooth way through the places of the frames beside the keyframe: of a polynomial
    /// through as many as there are, two before and two after it at most.
    fn velocity_at(&self, keyframe: &Keyframe) -> Option<Velocity> {
        let now_ns = keyframe.timestamp_ns;
        let step_to = |noted: &Noted| {
            let step = noted.from_before?;
            let scale = keyframe.local_scale / step.local_scale;
            Some(Pose { translation: step.motion.translation * scale, ..step.motion })
        };
        let mut beside = Vec::with_capacity(2 * N_BESIDE);
        let mut from_now = Pose::identity();
        let mut noted = self.frames.get(&now_ns);
        for (time_ns, before) in self.frames.range(..now_ns).rev().take(N_BESIDE) {
            let Some(step) = noted.and_then(step_to) else { break };
            from_now = step.inverse() * from_now;
            beside.push(((time_ns - now_ns) as f64, from_now.log()));
            noted = Some(before);
        }
        from_now = Pose::identity();
        for (time_ns, after) in self.frames.range(now_ns + 1..).take(N_BESIDE) {
            let Some(step) = step_to(after) else { break };
            from_now = step * from_now;
            beside.push(((time_ns - now_ns) as f64, from_now.log()));
        }
        // Without the frame itself the steps are between others.
        let is_known = self.frames.contains_key(&now_ns) && !beside.is_empty();
        is_known.then(|| derivative_at_zero(&beside))
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
