//! Rolling shutter: looking for a readout that was not told, and taking it out of what the keyframes
//! measured. [method: Rolling shutter]
//!
//! All of it concerns the map's own camera: what an added one measured is taken as its frames had it.

use super::NewKeyframe;
use crate::bundle::global::{GlobalResult, adjust};
use crate::bundle::readout::{HeldOutReadout, ReadoutEstimate, Rolling};
use crate::config::{RollingShutterConfig, SlamConfig};
use crate::map::{CameraId, FramePose, FrameRecord, Keyframe, KeyframeId, Map, Readout, SubmapId};
use crate::rolling_shutter::{MotionLog, Motions, RollingShutter, Velocity};
use crate::tracking::frame::TrackedFrame;
use geometry::nalgebra::Vector2;
use geometry::{Camera, Pose};
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

/// Looks for the readout as the map grows, and takes it out of the keyframes.
pub(super) struct ReadoutMonitor {
    shutter: RollingShutter,
    log: MotionLog,
    /// Whether the readout was neither told nor found before.
    is_looked_for: bool,
    /// What the last look found, nanoseconds.
    last_ns: Option<f64>,
    /// Keyframes of before the session was taken up again, out of which it was taken before they were stored.
    stored: BTreeSet<KeyframeId>,
}

/// What a look at the readout begins with.
#[derive(Clone)]
pub(super) struct ReadoutLook {
    shutter: RollingShutter,
    motions: Motions,
    /// What the look before found, nanoseconds.
    before_ns: Option<f64>,
}

/// What a look at the readout came to.
pub(super) struct ReadoutCheck {
    /// By which readout the submap is explained best, nanoseconds, if it shows one.
    pub seen_ns: Option<f64>,
    /// That readout, if it is to be taken over.
    pub found: Option<FoundReadout>,
}

/// A readout that was found, and the submap as it is with it.
pub(super) struct FoundReadout {
    pub readout: Readout,
    pub adjusted: GlobalResult,
}

impl ReadoutMonitor {
    /// `None` for a global shutter. `working_camera` is that of the images that features are looked for in.
    pub fn new(config: &SlamConfig, working_camera: &Camera, map: &Map) -> Option<Self> {
        let known_ns = config.rolling_shutter.readout_ns.or(map.readout().map(|readout| readout.readout_ns));
        let is_looked_for = config.looks_for_readout(map.readout().is_some());
        let shutter = RollingShutter::new(working_camera, known_ns.unwrap_or(0));
        let (log, stored) = (MotionLog::default(), map.keyframes().map(|keyframe| keyframe.id).collect());
        let is_rolling = is_looked_for || shutter.readout_ns() != 0;
        is_rolling.then_some(Self { shutter, log, is_looked_for, last_ns: None, stored })
    }

    /// Takes note of frames that were placed in this map.
    pub fn note(&mut self, records: &[FrameRecord], map: &Map) {
        if records.iter().all(|record| record.camera == CameraId::default()) {
            self.log.note(records, map);
        }
    }

    /// Takes note of frames that were placed in this map, the last of which becomes a keyframe of it.
    pub fn note_keyframe(&mut self, new: &NewKeyframe, map: &Map) {
        let NewKeyframe { keyframe, place, frames, .. } = new;
        if !is_own(keyframe) {
            return;
        }
        let as_tracked = |record: &FrameRecord| match record.pose {
            Some(pose) if pose.reference == keyframe.id => {
                FrameRecord { pose: Some(*place), ..record.clone() }
            }
            _ => record.clone(),
        };
        let frames: Vec<FrameRecord> = frames.iter().map(as_tracked).collect();
        self.log.note(&frames, map);
        let (reference, camera_from_reference) = (keyframe.id, Pose::identity());
        self.log.settle(keyframe.timestamp_ns, FramePose { reference, camera_from_reference, ..*place });
    }

    /// What a look at a submap begins with, if the readout is looked for.
    pub fn look(&self, map: &Map, submap: SubmapId) -> Option<ReadoutLook> {
        let motions = || self.log.motions(map.keyframes_of(submap));
        let (shutter, before_ns) = (&self.shutter, self.last_ns);
        let is_looked_for = self.is_looked_for && map.keyframes_of(submap).all(is_own);
        is_looked_for.then(|| ReadoutLook { shutter: shutter.clone(), motions: motions(), before_ns })
    }

    /// Takes note of what the last look found, and of the readout if it is to be taken over.
    pub fn note_look(&mut self, seen_ns: Option<f64>, found: Option<Readout>) {
        self.last_ns = seen_ns;
        if let Some(Readout { readout_ns, .. }) = found {
            self.shutter.set_readout_ns(readout_ns);
        }
    }

    /// Takes the readout out of the keyframes in which it is not yet taken out; out of all, as far as their
    /// motion is known, if it is `another` than before.
    pub fn unroll(&self, map: &mut Map, another: bool) {
        if self.shutter.readout_ns() == 0 {
            return;
        }
        let is_rolled = |keyframe: &&Keyframe| another || keyframe.features.unrolled == Velocity::zeros();
        let is_open = |keyframe: &&Keyframe| {
            is_own(keyframe) && is_rolled(keyframe) && !self.stored.contains(&keyframe.id)
        };
        let motions = self.log.motions(map.keyframes().filter(is_open));
        unroll_keyframes(map, &self.shutter, &motions);
    }
}

/// Whether the map's own camera took it.
fn is_own(keyframe: &Keyframe) -> bool {
    keyframe.camera.id == CameraId::default()
}

impl ReadoutLook {
    /// The readout is to be taken over if the submap shows it, it is another than what was taken out so far,
    /// it is much the same without every third keyframe, and these are explained better by it, or the look
    /// before found the same. `None` if `aborted` said so.
    pub fn check(
        &self,
        map: &Map,
        submap: SubmapId,
        config: &SlamConfig,
        abort: &AtomicBool,
        aborted: impl Fn() -> bool + Copy,
    ) -> Option<ReadoutCheck> {
        let Self { shutter, motions, .. } = self;
        let calibration = &config.calibration;
        let rolling = Rolling { map, submap, shutter, motions, calibration };
        let nothing = ReadoutCheck { seen_ns: None, found: None };
        let Some(estimate) = rolling.estimate(aborted) else { return (!aborted()).then_some(nothing) };
        let (n_keyframes, n_moving, known_ns) = (map.n_keyframes(), motions.len(), shutter.readout_ns());
        let (change_ns, sigma_ns) = (estimate.change_ns, estimate.sigma_ns);
        tracing::debug!(n_keyframes, n_moving, known_ns, change_ns, sigma_ns, "readout that explains best");
        if !config.rolling_shutter.shows(known_ns, &estimate) {
            return Some(nothing);
        }
        let seen_ns = Some(known_ns as f64 + change_ns);
        let held_out = rolling.hold_out(aborted);
        if aborted() {
            return None;
        }
        tracing::debug!(?held_out, "what keyframes left out of the fit say of the readout");
        if !held_out.is_some_and(|held_out| self.is_confirmed(&estimate, &held_out, &config.rolling_shutter))
        {
            return Some(ReadoutCheck { seen_ns, found: None });
        }
        let readout_ns = known_ns + change_ns.round() as i64;
        let readout = Readout { readout_ns, sigma_ns: sigma_ns.round() as i64 };
        let mut map = map.clone();
        estimate.write_into(&mut map);
        map.set_readout(readout);
        let mut shutter = shutter.clone();
        shutter.set_readout_ns(readout_ns);
        unroll_keyframes(&mut map, &shutter, motions);
        let adjusted = adjust(&map, submap, config, abort)?;
        Some(ReadoutCheck { seen_ns, found: Some(FoundReadout { readout, adjusted }) })
    }

    /// Whether an estimate may be believed.
    fn is_confirmed(
        &self,
        estimate: &ReadoutEstimate,
        held_out: &HeldOutReadout,
        config: &RollingShutterConfig,
    ) -> bool {
        let known_ns = self.shutter.readout_ns();
        let now_ns = known_ns as f64 + estimate.change_ns;
        let was_seen = self.before_ns.is_some_and(|before_ns| config.agree(before_ns, now_ns));
        let (is_certain, min_gain) = if known_ns == 0 {
            (estimate.change_ns >= config.certain_sigmas * estimate.sigma_ns, config.min_held_out_gain)
        } else {
            (true, 0.0)
        };
        let difference_ns = (held_out.change_ns - estimate.change_ns).abs();
        difference_ns <= config.max_held_out_difference * estimate.change_ns.abs()
            && (was_seen || (is_certain && held_out.gain >= min_gain))
    }
}

impl RollingShutterConfig {
    /// Whether an estimate shows a readout that differs from the one known so far.
    fn shows(&self, known_ns: i64, estimate: &ReadoutEstimate) -> bool {
        let readout_ns = known_ns as f64 + estimate.change_ns;
        let is_credible = (self.min_readout_ns as f64..=self.max_found_ns as f64).contains(&readout_ns);
        let min_sigmas = if known_ns == 0 { self.min_sigmas } else { self.min_move_sigmas };
        is_credible && estimate.change_ns.abs() >= min_sigmas * estimate.sigma_ns
    }

    /// Whether two looks found the same.
    fn agree(&self, before_ns: f64, now_ns: f64) -> bool {
        (now_ns - before_ns).abs() <= self.max_disagreement * now_ns.abs()
    }
}

/// Takes the readout out of the features of the keyframes whose motion is given.
fn unroll_keyframes(map: &mut Map, shutter: &RollingShutter, motions: &Motions) {
    for (id, velocity) in motions {
        let Some(keyframe) = map.keyframe(*id) else { continue };
        let frame = TrackedFrame::of_keyframe(keyframe);
        let Some(depths) = frame.inverse_depths(map) else { continue };
        let inverse_depth = |feature_idx: Option<usize>, place: &Vector2<f64>| {
            let seen = feature_idx.and_then(|idx| frame.inverse_depth_of(idx, map));
            seen.unwrap_or_else(|| depths.at(place))
        };
        let unrolled = shutter.unroll(&keyframe.features, velocity, inverse_depth);
        if let Some(settled) = shutter.settle(&unrolled) {
            map.move_features(*id, settled);
        }
    }
}
