//! Intrinsics of a map, as refined by self-calibration.

use super::{Keyframe, KeyframeId, Map};
use geometry::PinholeCorrection;
use std::sync::Arc;

impl Map {
    /// Takes over how the camera differs from its calibration. Pixels stay as they are; the rays of all key
    /// frames change, and with them the directions of their vanishing points. Poses and landmarks are left as
    /// they are.
    pub(crate) fn set_correction(&mut self, correction: PinholeCorrection) {
        let before = std::mem::replace(&mut self.correction, correction);
        if before == correction {
            return;
        }
        self.changes.correction = true;
        let turned = correction.corrected_from_nominal() * before.nominal_from_corrected();
        let ids: Vec<KeyframeId> = self.keyframes().map(|keyframe| keyframe.id).collect();
        for id in ids {
            self.edit_keyframe(id, |keyframe| {
                adapt(keyframe, &correction);
                for vanishing in &mut keyframe.vanishing {
                    vanishing.direction = (turned * vanishing.direction).normalize();
                }
            });
        }
    }
}

/// Has a key frame's rays be those of the corrected camera.
pub(super) fn adapt(keyframe: &mut Keyframe, correction: &PinholeCorrection) {
    if !keyframe.features.has_correction(correction) {
        keyframe.features = Arc::new(keyframe.features.with_correction(correction));
    }
}
