//! Self-calibration: when the camera is checked against the images, and what comes of it.
//! [method: Self-calibration]

use crate::bundle::calibration::{Calibration, Estimate, Knowledge};
use crate::bundle::global::{GlobalResult, adjust_to_camera};
use crate::config::{CalibrationConfig, CalibrationTrust, SlamConfig};
use crate::map::{Map, SubmapId};
use crate::report::MapEvent;
use geometry::CameraCorrection;
use optim::chi2_95;
use std::sync::atomic::{AtomicBool, Ordering};

/// When the camera is looked at next, and what was found so far.
#[derive(Clone, Debug)]
pub(super) struct IntrinsicsMonitor {
    /// Keyframes from which on it is looked at again.
    next_keyframes: usize,
    memory: Memory,
    /// Looking again would not help.
    is_over: bool,
}

/// What is kept from one look for the next.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Memory {
    /// What the last look found, if that was doubtful.
    doubt: Option<Doubt>,
    /// Whether the last looks agreed on a camera of which little was known before.
    is_known: bool,
}

/// What makes a camera doubtful.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    /// How it seems to differ from the calibration.
    correction: CameraCorrection,
    /// How it would differ if little were known of it, where that is by more than a calibration can be wrong
    /// by.
    contradiction: Option<CameraCorrection>,
}

/// What a look at the camera came to.
pub(super) struct IntrinsicsCheck {
    memory: Memory,
    event: Option<MapEvent>,
    is_over: bool,
    /// The submap as it is with another camera.
    pub adjusted: Option<GlobalResult>,
}

impl IntrinsicsMonitor {
    pub fn new(config: &CalibrationConfig) -> Self {
        Self { next_keyframes: config.first_look(), memory: Memory::default(), is_over: false }
    }

    /// The submap by which the camera is to be looked at now, if it is; `share` of the planned keyframes
    /// will do. Only while the map is in one piece: another piece would not be adjusted with it.
    pub fn is_due(&mut self, map: &Map, share: f64, config: &CalibrationConfig) -> Option<SubmapId> {
        let n_keyframes = map.n_keyframes();
        let n_required = (self.next_keyframes as f64 * share).max(config.first_look() as f64);
        if self.is_over || (n_keyframes as f64) < n_required || n_keyframes > config.max_keyframes {
            return None;
        }
        let mut submaps = map.submaps().into_iter();
        let (Some(submap), None) = (submaps.next(), submaps.next()) else { return None };
        let growth = if config.trust == CalibrationTrust::Given || self.memory.is_known {
            config.growth
        } else {
            config.growth_while_unknown
        };
        self.next_keyframes = (n_keyframes as f64 * growth).ceil() as usize;
        Some(submap)
    }

    /// Whether the images were found to contradict the calibration by more than it may be corrected.
    pub fn is_contradicted(&self) -> bool {
        self.is_over
    }

    /// What is kept from the last look.
    pub fn memory(&self) -> Memory {
        self.memory
    }

    /// Takes note of a look, and tells what there is to tell.
    pub fn note(&mut self, check: &IntrinsicsCheck) -> Option<MapEvent> {
        self.memory = check.memory;
        self.is_over |= check.is_over;
        check.event
    }
}

/// A look at the camera of a submap.
pub(super) struct Look<'a> {
    pub map: &'a Map,
    pub submap: SubmapId,
    pub config: &'a SlamConfig,
    pub abort: &'a AtomicBool,
}

impl Look<'_> {
    /// Looks at the camera and, if it is another than was thought, adjusts the submap to it. `None` if
    /// `abort` was set meanwhile.
    pub fn check(&self, before: Memory) -> Option<IntrinsicsCheck> {
        match self.config.calibration.trust {
            CalibrationTrust::Given => self.check_given(before),
            CalibrationTrust::Approximate | CalibrationTrust::Unknown => self.find(before),
        }
    }

    /// Finds a camera of which little was known.
    fn find(&self, before: Memory) -> Option<IntrinsicsCheck> {
        let config = &self.config.calibration;
        let estimate = self.estimate(config.knowledge(), !before.is_known)?;
        let is_known = estimate.sigmas[0] <= config.known_focal_sigma * (1.0 + estimate.correction.focal);
        let memory = Memory { is_known, ..Memory::default() };
        let nothing = IntrinsicsCheck { memory, event: None, is_over: false, adjusted: None };
        if !estimate.moves(&self.map.correction(), config.min_move_sigmas) {
            return Some(nothing);
        }
        let event = Some(MapEvent::CalibrationRefined { correction: estimate.correction });
        Some(IntrinsicsCheck { event, adjusted: Some(self.adjust(Some(&estimate))?), ..nothing })
    }

    /// Holds a calibration that was given against the images.
    ///
    /// Errors of keypoints that are not independent feign small errors of the camera, with a χ² that looks
    /// significant. They differ from one look to the next, while the camera stays the same: hence two looks
    /// have to agree, unless one is beyond doubt.
    fn check_given(&self, before: Memory) -> Option<IntrinsicsCheck> {
        let config = &self.config.calibration;
        let held = self.estimate(config.knowledge(), false)?;
        let nothing =
            IntrinsicsCheck { memory: Memory::default(), event: None, is_over: false, adjusted: None };
        if held.gain < config.min_gain {
            return Some(nothing);
        }
        let features = &self.map.keyframes_of(self.submap).next()?.features;
        let wide = self.estimate(config.knowledge_of_size(features), false)?;
        let contradiction = contradicts(&wide, config).then_some(wide.correction);
        let doubt = Doubt { correction: held.correction, contradiction };
        let before = before.doubt;
        if let Some(correction) =
            contradiction.filter(|_| before.is_some_and(|before| doubt.is_contradicted_as(&before, config)))
        {
            // A camera taken over earlier was a first step towards something that no camera explains.
            let adjusted =
                if self.map.correction().is_none() { None } else { Some(self.adjust(None)?) };
            let event = Some(MapEvent::CalibrationContradicted { correction });
            return Some(IntrinsicsCheck { event, adjusted, is_over: true, ..nothing });
        }
        let agreed = before.is_some_and(|before| agree(&before.correction, &held.correction, config));
        if contradiction.is_none() && (held.gain >= config.certain_gain || agreed) {
            let event = Some(MapEvent::CalibrationRefined { correction: held.correction });
            return Some(IntrinsicsCheck { event, adjusted: Some(self.adjust(Some(&held))?), ..nothing });
        }
        Some(IntrinsicsCheck { memory: Memory { doubt: Some(doubt), ..Memory::default() }, ..nothing })
    }

    fn estimate(&self, knowledge: Knowledge, search: bool) -> Option<Estimate> {
        let aborted = || self.abort.load(Ordering::Relaxed);
        let calibration = Calibration::of(self.map, self.submap, knowledge, &self.config.calibration);
        let estimate = calibration.estimate(search, aborted)?;
        let Estimate { correction, sigmas, inflation, gain, .. } = &estimate;
        let (submap, n_keyframes) = (self.submap, self.map.n_keyframes());
        let sigmas = sigmas.as_slice();
        tracing::debug!(%submap, n_keyframes, ?correction, ?sigmas, inflation, gain, "camera that explains the submap best");
        Some(estimate)
    }

    fn adjust(&self, refined: Option<&Estimate>) -> Option<GlobalResult> {
        adjust_to_camera(self.map, self.submap, refined, self.config, self.abort)
    }
}

impl Doubt {
    /// Whether both looks contradict the calibration, and in the same way.
    fn is_contradicted_as(&self, before: &Self, config: &CalibrationConfig) -> bool {
        let both = before.contradiction.zip(self.contradiction);
        both.is_some_and(|(before, now)| agree(&before, &now, config))
    }
}

/// Whether the camera that fits best is another by more than a calibration that was given can be wrong by.
fn contradicts(wide: &Estimate, config: &CalibrationConfig) -> bool {
    let given = config.knowledge().sigmas;
    let CameraCorrection { focal, center_x, center_y, .. } = wide.correction;
    let off = [focal.ln_1p(), center_x, center_y];
    let squared = |axis: usize| off[axis].powi(2) / (given[axis].powi(2) + wide.sigmas[axis].powi(2));
    (0..3).map(squared).sum::<f64>() > chi2_95(3)
}

/// Whether two looks found the same.
fn agree(before: &CameraCorrection, now: &CameraCorrection, config: &CalibrationConfig) -> bool {
    let of = |c: &CameraCorrection| geometry::nalgebra::Vector3::new(c.focal, c.center_x, c.center_y);
    let (before, now) = (of(before), of(now));
    (now - before).norm() <= config.max_disagreement * now.norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A look that wants another focal length, by so much.
    fn doubt(focal: f64) -> Doubt {
        let correction = CameraCorrection { focal, ..CameraCorrection::default() };
        Doubt { correction, contradiction: Some(correction) }
    }

    #[test]
    fn two_contradictions_that_disagree_are_none() {
        let config = CalibrationConfig::default();
        assert!(doubt(-0.06).is_contradicted_as(&doubt(-0.055), &config));
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(-0.02), &config), "these are errors of keypoints");
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(0.06), &config));
        let tolerable = Doubt { contradiction: None, ..doubt(-0.06) };
        assert!(!doubt(-0.06).is_contradicted_as(&tolerable, &config));
    }
}
