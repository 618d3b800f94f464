//! The camera of a map, as far as the session knows it better than its calibration.

use super::{Keyframe, KeyframeId, Map, Readout, VanishingObservation};
use crate::features::FrameFeatures;
use geometry::CameraCorrection;
use std::sync::Arc;
use vision::vanishing::{SegmentPlane, fit_direction};

impl Map {
    /// Takes over how the map's own camera differs from its calibration. The rays of all keyframes of that
    /// calibration change, and with them the directions of their vanishing points. Poses and landmarks are
    /// left as they are. A correction that leaves no camera is refused.
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
        let refined = self.keyframes().filter(|keyframe| keyframe.camera.is_refined);
        let ids: Vec<KeyframeId> = refined.map(|keyframe| keyframe.id).collect();
        for id in ids {
            self.edit_keyframe(id, |keyframe| {
                adapt(keyframe, &correction);
                for vanishing in &mut keyframe.vanishing {
                    vanishing.direction = (turned * vanishing.direction).normalize();
                    if before.bends() || correction.bends() {
                        fit_again(vanishing, &keyframe.features);
                    }
                }
            });
        }
    }
}

impl Map {
    /// Takes note of whether the images contradict the calibration.
    pub(crate) fn set_contradicted(&mut self, is_contradicted: bool) {
        self.changes.correction |= self.is_contradicted != is_contradicted;
        self.is_contradicted = is_contradicted;
    }

    /// Takes note of how long the camera takes to read an image. Keyframes' features are left as they are.
    pub(crate) fn set_readout(&mut self, readout: Readout) {
        self.changes.correction |= self.readout != Some(readout);
        self.readout = Some(readout);
    }

    /// Puts a keyframe's features elsewhere; there are as many as before.
    pub(crate) fn move_features(&mut self, id: KeyframeId, features: FrameFeatures) {
        let is_of = |keyframe: &Keyframe| {
            keyframe.points.len() == features.len() && keyframe.lines.len() == features.lines.len()
        };
        if !self.keyframe(id).is_some_and(is_of) {
            return;
        }
        self.edit_keyframe(id, |keyframe| {
            for vanishing in &mut keyframe.vanishing {
                fit_again(vanishing, &features);
            }
            keyframe.features = Arc::new(features);
        });
        self.changes.moved_features.insert(id);
    }
}

/// Fits a vanishing point to its segments as they are now: straight lines that the lens bends lead elsewhere.
fn fit_again(vanishing: &mut VanishingObservation, features: &FrameFeatures) {
    let planes: Vec<SegmentPlane> =
        vanishing.segments.iter().filter_map(|idx| features.segment_plane(*idx as usize)).collect();
    if let Some((direction, covariance)) = fit_direction(&planes, &vanishing.direction) {
        (vanishing.direction, vanishing.covariance) = (direction, covariance);
    }
}

/// Has a keyframe's rays be those of the corrected camera.
pub(super) fn adapt(keyframe: &mut Keyframe, correction: &CameraCorrection) {
    if keyframe.camera.is_refined && !keyframe.features.has_correction(correction) {
        keyframe.features = Arc::new(keyframe.features.with_correction(correction));
    }
}
