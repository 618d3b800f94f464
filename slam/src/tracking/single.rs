//! Single images, that nothing came before: the whole map is searched.

use super::frame::{Inliers, TrackedFrame};
use super::relocalization::Relocalizer;
use super::{Tracked, Tracker};
use crate::features::View;
use crate::map::{KeyframeId, Map};
use crate::report::{LostReason, TrackingOutcome};
use geometry::nalgebra::{Matrix6, Vector3};

/// What came of a single image.
pub(crate) struct Located {
    pub outcome: TrackingOutcome,
    /// The frame, where it has a pose.
    pub frame: Option<TrackedFrame>,
    inliers: Inliers,
    n_candidates: usize,
    /// Of the pose, in its tangent: turn, then shift.
    pub covariance: Option<Matrix6<f64>>,
}

impl Located {
    /// Landmarks that agree with the pose.
    pub fn n_inliers(&self) -> usize {
        self.inliers.total()
    }

    /// Whether the pose is good.
    pub fn is_tracked(&self) -> bool {
        matches!(self.outcome, TrackingOutcome::Tracked)
    }

    /// As tracking would tell it.
    pub fn into_tracked(self) -> Tracked {
        let Self { outcome, frame, inliers, n_candidates, .. } = self;
        let relocalized = frame.is_some();
        Tracked { outcome, frame, inliers, relocalized, n_candidates: Some(n_candidates) }
    }
}

impl Tracker {
    /// Looks for a single image in the map, or near a place of it (a position and a distance), whatever was
    /// looked for before.
    pub fn locate(&mut self, view: &View, map: &Map, near: Option<(Vector3<f64>, f64)>) -> Located {
        self.begin_anew(near);
        let (n_keypoints, n_segments) = (view.features.len(), view.features.lines.len());
        let n_required = self.config.tracking.min_weak_inliers;
        let found = if n_keypoints + n_segments < n_required {
            Err(LostReason::TooFewFeatures { n_keypoints, n_segments, n_required })
        } else {
            let found = self.search(view, map, None);
            found.ok_or_else(|| LostReason::NotRelocalized { n_candidates: self.n_places_tried() })
        };
        let n_candidates = self.n_places_tried();
        self.begin_anew(None);
        match found {
            Ok((found, outcome)) => Located {
                outcome,
                inliers: found.placement.inliers,
                n_candidates,
                covariance: found.placement.information.try_inverse(),
                frame: Some(found.frame),
            },
            Err(reason) => Located {
                outcome: TrackingOutcome::Lost(reason),
                frame: None,
                inliers: Inliers::default(),
                n_candidates,
                covariance: None,
            },
        }
    }

    /// The keyframes that look most like a single image, best first.
    pub fn places_like(
        &mut self,
        view: &View,
        map: &Map,
        near: Option<(Vector3<f64>, f64)>,
    ) -> Vec<KeyframeId> {
        self.begin_anew(near);
        self.relocalizer.as_mut().map_or(Vec::new(), |relocalizer| relocalizer.candidates(view, map, None))
    }

    /// Places that were tried for the last image.
    pub fn n_places_tried(&self) -> usize {
        self.relocalizer.as_ref().map_or(0, Relocalizer::n_candidates)
    }

    fn begin_anew(&mut self, near: Option<(Vector3<f64>, f64)>) {
        (self.last, self.n_since_relocalization) = (None, None);
        self.last_seen.clear();
        self.take_visibility_counts();
        if let Some(relocalizer) = &mut self.relocalizer {
            relocalizer.begin_anew(near);
        }
    }
}
