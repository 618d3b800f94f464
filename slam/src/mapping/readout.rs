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
use std::sync::atomic::AtomicBool;

/// Looks for the readout as the map grows.
pub(super) struct ReadoutMonitor {
    shutter: RollingShutter,
    log: MotionLog,
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
    /// `None` where the readout was told, or was found before. `working_camera` is that of the images that
    /// features are looked for in.
    pub fn new(config: &SlamConfig, working_camera: &Camera, map: &Map) -> Option<Self> {
        let is_unknown = config.rolling_shutter.readout_ns.is_none() && map.readout().is_none();
        let is_looked_for = (is_unknown || std::env::var("DBG_TOLD").is_ok()) && config.features.refine_calibration;
        let shutter = RollingShutter::unknown(working_camera);
        is_looked_for.then(|| Self { shutter, log: MotionLog::default() })
    }

    /// Takes note of frames that were placed.
    pub fn note(&mut self, records: &[FrameRecord]) {
        self.log.note(records);
    }

    pub fn look(&self, map: &Map, submap: SubmapId) -> ReadoutLook {
        ReadoutLook { shutter: self.shutter.clone(), motions: self.log.motions(map, submap) }
    }

    /// Takes the map's readout out of the keyframes of a submap in which it is not yet taken out.
    pub fn unroll(&self, map: &mut Map, submap: SubmapId) {
        unroll_keyframes(map, &self.shutter, &self.log.motions(map, submap));
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
        let before_ns = map.readout().map_or(0, |readout| readout.readout_ns);
        let readout_ns = before_ns + estimate.change_ns.round() as i64;
        let (n_keyframes, n_moving) = (map.n_keyframes(), motions.len());
        let (change_ns, sigma_ns) = (estimate.change_ns, estimate.sigma_ns);
        tracing::debug!(n_keyframes, n_moving, before_ns, change_ns, sigma_ns, "readout that explains the submap best");
        if std::env::var("DBG_TOLD").is_ok() || !rolling_shutter.is_moved(before_ns, &estimate) {
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
        unroll_keyframes(&mut map, shutter, motions);
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

/// Takes the map's readout out of the features of keyframes in which it is not yet taken out and whose motion
/// is known.
fn unroll_keyframes(map: &mut Map, shutter: &RollingShutter, motions: &Motions) {
    let Some(Readout { readout_ns, .. }) = map.readout() else { return };
    let is_rolled = |keyframe: &&Keyframe| keyframe.features.readout_ns != readout_ns;
    let rolled: Vec<KeyframeId> = map.keyframes().filter(is_rolled).map(|keyframe| keyframe.id).collect();
    for id in rolled {
        let (Some(keyframe), Some(velocity)) = (map.keyframe(id), motions.get(&id)) else { continue };
        let shutter = shutter.with_readout(readout_ns - keyframe.features.readout_ns);
        let frame = TrackedFrame::of_keyframe(keyframe);
        let Some(depths) = frame.inverse_depths(map) else { continue };
        let inverse_depth = |feature_idx: Option<usize>, place: &Vector2<f64>| {
            let seen = feature_idx.and_then(|idx| frame.inverse_depth_of(idx, map));
            seen.unwrap_or_else(|| depths.at(place))
        };
        let unrolled = shutter.unroll(&keyframe.features, velocity, inverse_depth);
        if let Some(settled) = shutter.settle(&unrolled) {
            map.move_features(id, settled);
        }
    }
}
