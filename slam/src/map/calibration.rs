//! The camera of a map, as far as the session knows it better than its calibration.

use super::{Keyframe, KeyframeId, Map};
use geometry::CameraCorrection;
use std::sync::Arc;

impl Map {
    /// Takes over how the camera differs from its calibration. The rays of all keyframes change, and with them the directions of their vanishing points. Poses and landmarks are left
    /// as they are. A correction that leaves no camera is refused.
    pub(crate) fn set_correction(&mut self, correction: CameraCorrection) {
        if !correction.leaves_a_camera() {
            return;
        }
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

/// Has a keyframe's rays be those of the corrected camera.
pub(super) fn adapt(keyframe: &mut Keyframe, correction: &CameraCorrection) {
    if !keyframe.features.has_correction(correction) {
        keyframe.features = Arc::new(keyframe.features.with_correction(correction));
    }
}
