//! Self-calibration: when the intrinsics are checked against the images, and what comes of it.

use crate::bundle::calibration::{IntrinsicsDoubt, IntrinsicsFinding, refine_intrinsics};
use crate::bundle::global::{GlobalResult, adjust_to_camera};
use crate::config::{CalibrationConfig, SlamConfig};
use crate::map::{Map, SubmapId};
use crate::report::MapEvent;
use std::sync::atomic::{AtomicBool, Ordering};

/// When the camera is looked at next, and what was found so far.
#[derive(Clone, Debug)]
pub(super) struct IntrinsicsMonitor {
    /// Keyframes from which on it is looked at again.
    next_keyframes: usize,
    /// What the last look found, if that was doubtful.
    doubt: Option<IntrinsicsDoubt>,
    /// Looking again would not help.
    is_over: bool,
}

/// What a look at the camera came to.
pub(super) struct IntrinsicsCheck {
    doubt: Option<IntrinsicsDoubt>,
    event: Option<MapEvent>,
    /// The submap as it is with another camera.
    pub adjusted: Option<GlobalResult>,
}

impl IntrinsicsMonitor {
    pub fn new(config: &CalibrationConfig) -> Self {
        Self { next_keyframes: config.min_keyframes, doubt: None, is_over: false }
    }

    /// The submap by which the camera is to be looked at now, if it is; `share` of the planned keyframes
    /// will do. Only while the map is in one piece: another piece would not be adjusted with it.
    pub fn is_due(&mut self, map: &Map, share: f64, config: &CalibrationConfig) -> Option<SubmapId> {
        let n_keyframes = map.n_keyframes();
        let n_required = (self.next_keyframes as f64 * share).max(config.min_keyframes as f64);
        if self.is_over || (n_keyframes as f64) < n_required || n_keyframes > config.max_keyframes {
            return None;
        }
        let mut submaps = map.submaps().into_iter();
        let (Some(submap), None) = (submaps.next(), submaps.next()) else { return None };
        self.next_keyframes = (n_keyframes as f64 * config.growth).ceil() as usize;
        Some(submap)
    }

    /// Whether the images were found to contradict the calibration by more than it may be corrected.
    pub fn is_contradicted(&self) -> bool {
        self.is_over
    }

    /// What made the last look doubtful.
    pub fn doubt(&self) -> Option<IntrinsicsDoubt> {
        self.doubt
    }

    /// Takes note of a look, and tells what there is to tell.
    pub fn note(&mut self, check: &IntrinsicsCheck) -> Option<MapEvent> {
        self.doubt = check.doubt;
        self.is_over |= matches!(check.event, Some(MapEvent::CalibrationContradicted { .. }));
        check.event
    }
}

/// Looks at the camera and, if it is another than was thought, adjusts the submap to it. `None` if `abort`
/// was set meanwhile.
pub(super) fn check_intrinsics(
    map: &Map,
    submap: SubmapId,
    doubt: Option<IntrinsicsDoubt>,
    config: &SlamConfig,
    abort: &AtomicBool,
) -> Option<IntrinsicsCheck> {
    let aborted = || abort.load(Ordering::Relaxed);
    let nothing = IntrinsicsCheck { doubt: None, event: None, adjusted: None };
    Some(match refine_intrinsics(map, submap, doubt, &config.calibration, aborted)? {
        IntrinsicsFinding::Confirmed => nothing,
        IntrinsicsFinding::Doubtful(doubt) => IntrinsicsCheck { doubt: Some(doubt), ..nothing },
        IntrinsicsFinding::Refined(estimate) => IntrinsicsCheck {
            adjusted: Some(adjust_to_camera(map, submap, Some(&estimate), config, abort)?),
            event: Some(MapEvent::CalibrationRefined { correction: estimate.correction }),
            doubt: None,
        },
        IntrinsicsFinding::Contradicted(correction) => IntrinsicsCheck {
            // A camera taken over earlier was a first step towards something that no camera explains.
            adjusted: if map.correction().is_none() {
                None
            } else {
                Some(adjust_to_camera(map, submap, None, config, abort)?)
            },
            event: Some(MapEvent::CalibrationContradicted { correction }),
            doubt: None,
        },
    })
}
