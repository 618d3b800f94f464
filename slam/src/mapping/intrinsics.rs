//! Self-calibration: when the camera is checked against the images, and what comes of it.
//! [method: Self-calibration]

use super::readout::{FoundReadout, ReadoutLook};
use crate::bundle::calibration::{Calibration, Estimate, Knowledge};
use crate::bundle::global::{GlobalResult, adjust_to_camera};
use crate::bundle::held_out::hold_out;
use crate::config::{CalibrationConfig, CalibrationTrust, SlamConfig};
use crate::cores;
use crate::features::FrameFeatures;
use crate::map::{Map, Readout, SubmapId};
use crate::report::MapEvent;
use geometry::nalgebra::Vector2;
use geometry::{CameraCorrection, CorrectedPixels};
use optim::chi2_95;
use std::sync::atomic::{AtomicBool, Ordering};

/// A map whose camera is off by so many standard deviations of a calibration that was given has given it up.
const GIVEN_UP_SIGMAS: f64 = 5.0;

/// When the camera is looked at next, and what was found so far.
#[derive(Clone, Debug)]
pub(super) struct IntrinsicsMonitor {
    /// Keyframes from which on it is looked at again.
    next_keyframes: usize,
    memory: Memory,
    /// The last look moved the camera far, and what the map consists of with it.
    moved_far: bool,
    /// Looking again would not help.
    is_over: bool,
}

/// What is kept from one look for the next.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Memory {
    /// What the last look found, if that was doubtful.
    doubt: Option<Doubt>,
    /// Whether the last look determined a camera of which little was known before.
    is_known: bool,
    /// Whether the calibration was given up.
    is_given_up: bool,
    /// Whether it was told that the motion does not determine the camera.
    is_undetermined: bool,
}

/// What makes a camera doubtful.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    /// How it seems to differ from the calibration.
    correction: CameraCorrection,
    /// How it would differ if little were known of it, where that is by more than a calibration can be wrong
    /// by.
    contradiction: Option<CameraCorrection>,
    /// Whether that is so far off that it does not matter what the camera is instead.
    is_gross: bool,
    /// Keyframes it was found by.
    n_keyframes: usize,
}

/// What a look at the camera came to.
#[derive(Default)]
pub(super) struct IntrinsicsCheck {
    memory: Memory,
    event: Option<MapEvent>,
    is_over: bool,
    /// The submap as it is with another camera.
    pub adjusted: Option<GlobalResult>,
    /// The readout of the shutter that the submap shows, nanoseconds, if it shows one.
    pub seen_readout_ns: Option<f64>,
    /// The readout, if it was taken over.
    pub readout: Option<Readout>,
    /// Where the new camera is so far from the one before that its map has to be gone over.
    pub search_again: Option<SubmapId>,
}

impl IntrinsicsMonitor {
    /// `is_contradicted` is what was known before a restart. Where the calibration may be given up, it is
    /// looked at again.
    pub fn new(config: &CalibrationConfig, is_contradicted: bool) -> Self {
        Self {
            next_keyframes: config.first_look(),
            memory: Memory::default(),
            moved_far: false,
            is_over: is_contradicted && !config.wide,
        }
    }

    /// The submap by which the camera is to be looked at now, if it is; `share` of the planned keyframes
    /// will do. Only while the map is in one piece: another piece would not be adjusted with it. And only
    /// while all its cameras have the map's calibration: what another sees says nothing of this one.
    pub fn is_due(&mut self, map: &Map, share: f64, config: &CalibrationConfig) -> Option<SubmapId> {
        let n_keyframes = map.n_keyframes();
        let n_required = (self.next_keyframes as f64 * share).max(config.first_look() as f64);
        if self.is_over || (n_keyframes as f64) < n_required || n_keyframes > config.max_keyframes {
            return None;
        }
        if map.keyframes().any(|keyframe| !keyframe.camera.is_refined) {
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

    /// Whether the last look changed so much that the next will find something else.
    pub fn wants_another_look(&self) -> bool {
        self.moved_far && !self.is_over
    }

    /// What is kept from the last look.
    pub fn memory(&self) -> Memory {
        self.memory
    }

    /// Takes note of a look, and tells what there is to tell.
    pub fn note(&mut self, check: &IntrinsicsCheck) -> Option<MapEvent> {
        self.memory = check.memory;
        self.is_over |= check.is_over;
        self.moved_far = check.search_again.is_some() && check.readout.is_none();
        if self.moved_far {
            self.next_keyframes = 0;
        }
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
    /// Asked again and again in the middle of the work.
    fn is_aborted(&self) -> bool {
        cores::let_others();
        self.abort.load(Ordering::Relaxed)
    }

    /// Looks at the camera and, if it is another than was thought, adjusts the submap to it: at the readout
    /// of its shutter first, which would be taken for errors of the intrinsics. `None` if `abort` was set
    /// meanwhile.
    pub fn check(&self, before: Memory, readout: Option<&ReadoutLook>) -> Option<IntrinsicsCheck> {
        let aborted = || self.is_aborted();
        let (seen_readout_ns, found) = match readout {
            Some(look) => {
                let check = look.check(self.map, self.submap, self.config, self.abort, aborted)?;
                (check.seen_ns, check.found)
            }
            None => (None, None),
        };
        let check = match found {
            Some(found) => self.with_readout(found, before),
            None => self.check_intrinsics(before)?,
        };
        Some(IntrinsicsCheck { seen_readout_ns, ..check })
    }

    fn with_readout(&self, found: FoundReadout, before: Memory) -> IntrinsicsCheck {
        let FoundReadout { readout, adjusted } = found;
        let event = Some(MapEvent::ReadoutFound(readout));
        let (readout, adjusted) = (Some(readout), Some(adjusted));
        let search_again = Some(self.submap);
        IntrinsicsCheck { memory: before, event, readout, adjusted, search_again, ..Default::default() }
    }

    fn check_intrinsics(&self, before: Memory) -> Option<IntrinsicsCheck> {
        let config = &self.config.calibration;
        match config.trust {
            CalibrationTrust::Given if before.is_given_up || self.was_given_up() => {
                let features = &self.map.keyframes_of(self.submap).next()?.features;
                self.find(config.knowledge_of_size(features), before)
            }
            CalibrationTrust::Given => self.check_given(before),
            CalibrationTrust::Approximate | CalibrationTrust::Unknown => {
                self.find(config.knowledge(), before)
            }
        }
    }

    /// Whether the map has a camera that only a calibration given up leads to: so it is after a restart.
    fn was_given_up(&self) -> bool {
        let (config, now) = (&self.config.calibration, self.map.correction());
        let given = config.knowledge().sigmas;
        let off = [now.focal.ln_1p(), now.center_x, now.center_y];
        let is_far = |axis: usize| off[axis].abs() > GIVEN_UP_SIGMAS * given[axis];
        config.wide && ((0..3).any(is_far) || now.bends())
    }

    /// Finds a camera of which little was known.
    fn find(&self, knowledge: Knowledge, before: Memory) -> Option<IntrinsicsCheck> {
        let config = &self.config.calibration;
        let estimate = self.estimate(knowledge, !before.is_known)?;
        let is_known = estimate.focal_sigma() <= config.known_focal_sigma;
        let focal_sigma = estimate.focal_sigma();
        let is_undetermined = self.map.n_keyframes() >= config.undetermined_keyframes
            && focal_sigma > config.undetermined_focal_sigma;
        let memory = Memory { is_known, doubt: None, is_undetermined, ..before };
        let undetermined = (is_undetermined && !before.is_undetermined)
            .then_some(MapEvent::CalibrationUndetermined { focal_sigma });
        let nothing = IntrinsicsCheck { memory, ..IntrinsicsCheck::default() };
        if !estimate.moves(&self.map.correction(), config.min_move_sigmas) {
            return Some(IntrinsicsCheck { event: undetermined, ..nothing });
        }
        let refined = MapEvent::CalibrationRefined { correction: estimate.correction, focal_sigma };
        let event = undetermined.or(Some(refined));
        let features = &self.map.keyframes_of(self.submap).next()?.features;
        let shift_px = shift_px(features, &self.map.correction(), &estimate.correction);
        let search_again = (shift_px > config.search_again_px).then_some(self.submap);
        let adjusted = Some(self.adjust(Some(&estimate))?);
        Some(IntrinsicsCheck { event, adjusted, search_again, ..nothing })
    }

    /// Holds a calibration that was given against the images.
    ///
    /// Errors of keypoints that are not independent feign small errors of the camera, with a χ² that looks
    /// significant. They differ from one look to the next, while the camera stays the same: hence two looks
    /// have to agree, unless one is beyond doubt.
    fn check_given(&self, before: Memory) -> Option<IntrinsicsCheck> {
        let config = &self.config.calibration;
        let held = self.estimate(config.knowledge(), false)?;
        let nothing = IntrinsicsCheck::default();
        if config.suspected
            && let Some(contradicted) = self.check_suspected()?
        {
            return Some(contradicted);
        }
        // Fitted to errors of keypoints that are correlated, a camera is less certain than χ² says.
        if held.gain < config.min_gain || !held.moves(&self.map.correction(), config.min_given_sigmas) {
            return Some(nothing);
        }
        let features = &self.map.keyframes_of(self.submap).next()?.features;
        let wide = self.estimate(config.knowledge_of_size(features), false)?;
        let distance = squared_distance(&wide, config);
        let contradiction = (distance > chi2_95(3)).then_some(wide.correction);
        let is_gross = distance > config.gross_contradiction;
        let n_keyframes = self.map.n_keyframes();
        let doubt = Doubt { correction: held.correction, contradiction, is_gross, n_keyframes };
        let before = before.doubt;
        if let Some(correction) =
            contradiction.filter(|_| before.is_some_and(|before| doubt.is_contradicted_as(&before, config)))
        {
            if config.wide {
                let memory = Memory { is_given_up: true, ..Memory::default() };
                return self.find(config.knowledge_of_size(features), memory);
            }
            // A camera taken over earlier was a first step towards something that no camera explains.
            let adjusted = if self.map.correction().is_none() { None } else { Some(self.adjust(None)?) };
            let event = Some(MapEvent::CalibrationContradicted { correction });
            return Some(IntrinsicsCheck { event, adjusted, is_over: true, ..nothing });
        }
        // Two looks at nearly the same keyframes agree whatever they find.
        let has_grown = |before: &Doubt| n_keyframes as f64 >= before.n_keyframes as f64 * config.growth;
        let agreed = before
            .filter(has_grown)
            .is_some_and(|before| agree(&before.correction, &held.correction, config));
        let is_certain = held.gain >= config.certain_gain && held.inflation <= config.most_certain_inflation;
        let is_meant = contradiction.is_none() && (is_certain || agreed);
        if is_meant && self.holds_elsewhere(&held.correction)? {
            let (correction, focal_sigma) = (held.correction, held.focal_sigma());
            let event = Some(MapEvent::CalibrationRefined { correction, focal_sigma });
            return Some(IntrinsicsCheck { event, adjusted: Some(self.adjust(Some(&held))?), ..nothing });
        }
        let doubt = before.filter(|before| !has_grown(before) && !is_gross).unwrap_or(doubt);
        Some(IntrinsicsCheck { memory: Memory { doubt: Some(doubt), ..Memory::default() }, ..nothing })
    }

    /// Looks at a calibration that is doubtful by its numbers: contradicted if the images, too, agree better
    /// with another camera, however far that is. `None` within if they do not; `None` if `abort` was set.
    fn check_suspected(&self) -> Option<Option<IntrinsicsCheck>> {
        let config = &self.config.calibration;
        let features = &self.map.keyframes_of(self.submap).next()?.features;
        let knowledge = config.knowledge_of_size(features);
        let wide = self.estimate(knowledge, true)?;
        if wide.image_gain < config.min_gain || squared_distance(&wide, config) < config.gross_contradiction {
            return Some(None);
        }
        if config.wide {
            let memory = Memory { is_given_up: true, ..Memory::default() };
            return self.find(knowledge, memory).map(Some);
        }
        Some(Some(IntrinsicsCheck {
            event: Some(MapEvent::CalibrationContradicted { correction: wide.correction }),
            is_over: true,
            ..IntrinsicsCheck::default()
        }))
    }

    /// Whether keyframes that it was not fitted to speak for a camera as well: fitted to the others alone it
    /// is much the same, and explains them better than the present one. `None` if `abort` was set meanwhile.
    fn holds_elsewhere(&self, correction: &CameraCorrection) -> Option<bool> {
        let aborted = || self.is_aborted();
        let config = &self.config.calibration;
        let held_out = hold_out(self.map, self.submap, config, aborted);
        if aborted() {
            return None;
        }
        tracing::debug!(?held_out, "what keyframes left out of the fit say of the camera");
        Some(held_out.is_some_and(|held_out| {
            held_out.gain >= config.min_held_out_gain && agree(&held_out.correction, correction, config)
        }))
    }

    fn estimate(&self, knowledge: Knowledge, search: bool) -> Option<Estimate> {
        let aborted = || self.is_aborted();
        let calibration = Calibration::of(self.map, self.submap, knowledge, &self.config.calibration);
        let estimate = calibration.estimate(search, aborted)?;
        let Estimate { correction, sigmas, inflation, gain, image_gain, .. } = &estimate;
        let (submap, n_keyframes) = (self.submap, self.map.n_keyframes());
        let sigmas = sigmas.as_slice();
        tracing::debug!(%submap, n_keyframes, ?correction, ?sigmas, inflation, gain, image_gain, "camera that explains the submap best");
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
        let is_gross = before.is_gross && self.is_gross;
        both.is_some_and(|(before, now)| is_gross || agree(&before, &now, config))
    }
}

/// How far the camera that fits best is from a calibration that was given, squared, in standard deviations of
/// both.
fn squared_distance(wide: &Estimate, config: &CalibrationConfig) -> f64 {
    let given = config.knowledge().sigmas;
    let CameraCorrection { focal, center_x, center_y, .. } = wide.correction;
    let off = [focal.ln_1p(), center_x, center_y];
    let squared = |axis: usize| off[axis].powi(2) / (given[axis].powi(2) + wide.sigmas[axis].powi(2));
    (0..3).map(squared).sum()
}

/// How far at most two cameras see apart what is seen at the image's corners, pixels.
fn shift_px(features: &FrameFeatures, before: &CameraCorrection, after: &CameraCorrection) -> f64 {
    let (low, high) = features.nominal_corners();
    let nominal = &features.nominal_pinhole;
    let rays = [before, after].map(|camera| (CorrectedPixels::new(nominal, camera), camera.apply(nominal)));
    let corners = [low, high, Vector2::new(low.x, high.y), Vector2::new(high.x, low.y)];
    let shift = |corner: &Vector2<f64>| {
        let [first, second] = rays.map(|(pixels, pinhole)| pinhole.normalized(&pixels.ideal(corner)));
        (second - first).norm() * nominal.mean_focal_px()
    };
    corners.iter().map(shift).fold(0.0, f64::max)
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
        Doubt { correction, contradiction: Some(correction), is_gross: false, n_keyframes: 10 }
    }

    #[test]
    fn two_contradictions_that_disagree_are_none() {
        let config = CalibrationConfig::default();
        assert!(doubt(-0.06).is_contradicted_as(&doubt(-0.055), &config));
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(-0.02), &config), "these are errors of keypoints");
        assert!(!doubt(-0.06).is_contradicted_as(&doubt(0.06), &config));
        let tolerable = Doubt { contradiction: None, ..doubt(-0.06) };
        assert!(!doubt(-0.06).is_contradicted_as(&tolerable, &config));
        let gross = |focal| Doubt { is_gross: true, ..doubt(focal) };
        assert!(gross(0.9).is_contradicted_as(&gross(0.4), &config), "both are far off");
    }
}
