//! Rolling shutter: looking for a readout that was not told, and taking it out of what the keyframes
//! measured. [method: Rolling shutter]

use crate::bundle::global::{GlobalResult, adjust};
use crate::bundle::readout::{ReadoutEstimate, Rolling};
use crate::config::{RollingShutterConfig, SlamConfig};
use crate::map::{FrameRecord, Keyframe, KeyframeId, Map, Readout, SubmapId};
use crate::rolling_shutter::{MotionLog, Motions, RollingShutter};
use crate::tracking::frame::TrackedFrame;
use geometry::Camera;
use geometry::nalgebra::Vector2;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

/// Looks for the readout as the map grows, and takes it out of the keyframes.
pub(super) struct ReadoutMonitor {
    shutter: RollingShutter,
    log: MotionLog,
    /// Whether the readout was neither told nor found before.
    is_looked_for: bool,
    /// Keyframes out of which the readout was taken by a motion that will not be known better.
    settled: BTreeSet<KeyframeId>,
}

/// What a look at the readout begins with.
#[derive(Clone)]
pub(super) struct ReadoutLook {
    shutter: RollingShutter,
    motions: Motions,
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
        let is_looked_for = known_ns.is_none() && config.features.refine_calibration;
        let shutter = RollingShutter::new(working_camera, known_ns.unwrap_or(0));
        let (log, settled) = (MotionLog::default(), map.keyframes().map(|keyframe| keyframe.id).collect());
        let is_rolling = is_looked_for || shutter.readout_ns() != 0;
        is_rolling.then_some(Self { shutter, log, is_looked_for, settled })
    }

    /// Takes note of frames that were placed.
    pub fn note(&mut self, records: &[FrameRecord]) {
        self.log.note(records);
    }

    /// What a look at a submap begins with, if the readout is looked for.
    pub fn look(&self, map: &Map, submap: SubmapId) -> Option<ReadoutLook> {
        let motions = || self.log.motions(map, map.keyframes_of(submap));
        self.is_looked_for.then(|| ReadoutLook { shutter: self.shutter.clone(), motions: motions() })
    }

    /// Takes over a readout that was found.
    pub fn set_readout_ns(&mut self, readout_ns: i64) {
        self.shutter.set_readout_ns(readout_ns);
        self.settled.clear();
    }

    /// Takes the readout out of the keyframes in which it is not yet taken out, or was by what was known of
    /// the motion before there were frames after them.
    pub fn unroll(&mut self, map: &mut Map) {
        if self.shutter.readout_ns() == 0 {
            return;
        }
        let open = map.keyframes().filter(|keyframe| !self.settled.contains(&keyframe.id));
        let motions = self.log.motions(map, open);
        unroll_keyframes(map, &self.shutter, &motions);
        self.settled.extend(motions.iter().filter(|(_, motion)| motion.is_between).map(|(id, _)| *id));
    }
}

impl ReadoutLook {
    /// The readout, if the submap shows it, it is another than what was taken out so far, and keyframes left
    /// out of the fit agree. `None` within if it does not; `None` if `aborted` said so.
    pub fn check(
        &self,
        map: &Map,
        submap: SubmapId,
        config: &SlamConfig,
        abort: &AtomicBool,
        aborted: impl Fn() -> bool + Copy,
    ) -> Option<Option<FoundReadout>> {
        let Self { shutter, motions } = self;
        let (calibration, rolling_shutter) = (&config.calibration, &config.rolling_shutter);
        let rolling = Rolling { map, submap, shutter, motions, calibration };
        let Some(estimate) = rolling.estimate(aborted) else { return (!aborted()).then_some(None) };
        let before_ns = shutter.readout_ns();
        let readout_ns = before_ns + estimate.change_ns.round() as i64;
        let (n_keyframes, n_moving) = (map.n_keyframes(), motions.len());
        let (change_ns, sigma_ns) = (estimate.change_ns, estimate.sigma_ns);
        tracing::debug!(n_keyframes, n_moving, before_ns, change_ns, sigma_ns, "readout that explains the submap best");
        if !rolling_shutter.is_moved(before_ns, &estimate) {
            return Some(None);
        }
        let held_out = rolling.hold_out(aborted);
        if aborted() {
            return None;
        }
        tracing::debug!(?held_out, "what keyframes left out of the fit say of the readout");
        let agrees = held_out.is_some_and(|held_out| {
            let difference_ns = (held_out.change_ns - change_ns).abs();
            held_out.gain >= rolling_shutter.min_held_out_gain
                && difference_ns <= rolling_shutter.max_disagreement * change_ns.abs()
        });
        if !agrees {
            return Some(None);
        }
        let readout = Readout { readout_ns, sigma_ns: sigma_ns.round() as i64 };
        let mut map = map.clone();
        estimate.write_into(&mut map);
        map.set_readout(readout);
        let mut shutter = shutter.clone();
        shutter.set_readout_ns(readout_ns);
        unroll_keyframes(&mut map, &shutter, motions);
        let adjusted = adjust(&map, submap, config, abort)?;
        Some(Some(FoundReadout { readout, adjusted }))
    }
}

impl RollingShutterConfig {
    /// Whether an estimate shows a readout that differs from the one so far.
    fn is_moved(&self, before_ns: i64, estimate: &ReadoutEstimate) -> bool {
        let readout_ns = before_ns as f64 + estimate.change_ns;
        let is_credible = (self.min_readout_ns as f64..=self.max_found_ns as f64).contains(&readout_ns);
        let min_sigmas = if before_ns == 0 { self.min_sigmas } else { self.min_move_sigmas };
        is_credible && estimate.change_ns.abs() >= min_sigmas * estimate.sigma_ns
    }
}

/// Takes the readout out of the features of the keyframes whose motion is given. What was taken out by the
/// motion before a keyframe is as good as what follows from that alone.
fn unroll_keyframes(map: &mut Map, shutter: &RollingShutter, motions: &Motions) {
    for (id, motion) in motions {
        let is_better = |keyframe: &&Keyframe| motion.is_between || keyframe.features.unrolled.norm() == 0.0;
        let Some(keyframe) = map.keyframe(*id).filter(is_better) else { continue };
        let frame = TrackedFrame::of_keyframe(keyframe);
        let Some(depths) = frame.inverse_depths(map) else { continue };
        let inverse_depth = |feature_idx: Option<usize>, place: &Vector2<f64>| {
            let seen = feature_idx.and_then(|idx| frame.inverse_depth_of(idx, map));
            seen.unwrap_or_else(|| depths.at(place))
        };
        let unrolled = shutter.unroll(&keyframe.features, &motion.velocity, inverse_depth);
        if let Some(settled) = shutter.settle(&unrolled) {
            map.move_features(*id, settled);
        }
    }
}
