//! Rolling shutter while tracking: a frame's features as the camera of its middle row sees them, by the
//! motion predicted for it first, and by its own once it has a pose. [method: Rolling shutter]

use super::Tracker;
use super::following::{InLocalMap, LastFrame, PoseStart};
use super::frame::TrackedFrame;
use super::pose::place_frame;
use crate::features::View;
use crate::map::Map;
use crate::rolling_shutter::{InverseDepths, RollingShutter, Velocity};
use geometry::nalgebra::{Vector2, Vector3};
use std::sync::Arc;

/// How often the motion and the pose that depend on each other are found anew: each time the change is the
/// share of the readout in the frame interval of the one before.
const N_ROUNDS: usize = 2;

impl Tracker {
    /// The view as it would be if the camera moved on as before.
    pub(super) fn unroll_expected(&self, view: &View, map: &Map) -> Option<View> {
        let (shutter, last) = (self.rolling_shutter.as_ref()?, self.last.as_ref()?);
        let (motion, interval_ns) = last.motion.as_ref()?;
        let velocity = RollingShutter::velocity(motion, *interval_ns)?;
        let depths = inverse_depths(&last.frame, map)?;
        let features = shutter.unroll(&view.features, &velocity, |_, place| depths.at(place));
        Some(View { features: Arc::new(features), ..view.clone() })
    }

    /// Places a frame anew with its features unrolled by its own motion.
    pub(super) fn unroll_found(&self, rolled: &View, found: &mut InLocalMap, map: &Map) {
        let (Some(shutter), Some(last)) = (&self.rolling_shutter, &self.last) else { return };
        if found.start == PoseStart::Relocalized {
            return;
        }
        for _ in 0..N_ROUNDS {
            let Some(velocity) = last.velocity_at(&found.frame) else { return };
            let Some(depths) = inverse_depths(&found.frame, map) else { return };
            let inverse_depth = |feature_idx: Option<usize>, place: &Vector2<f64>| {
                let matched = feature_idx.and_then(|idx| found.frame.points[idx]);
                matched
                    .and_then(|id| inverse_depth_of(&found.frame, map.point(id)?.position))
                    .unwrap_or_else(|| depths.at(place))
            };
            let features = shutter.unroll(&rolled.features, &velocity, inverse_depth);
            found.frame.features = Arc::new(features);
            found.placement = place_frame(&mut found.frame, map, &self.config.primitives);
        }
    }
}

impl LastFrame {
    /// How the camera moves at the frame after this one: as between the two, and accelerated as it was
    /// before.
    fn velocity_at(&self, frame: &TrackedFrame) -> Option<Velocity> {
        let interval_ns = frame.timestamp_ns - self.frame.timestamp_ns;
        let motion = frame.camera_from_world * self.frame.camera_from_world.inverse();
        let between = RollingShutter::velocity(&motion, interval_ns)?;
        let before = self.motion.as_ref().and_then(|(motion, interval_ns)| {
            Some((RollingShutter::velocity(motion, *interval_ns)?, *interval_ns))
        });
        let Some((before, interval_before_ns)) = before else { return Some(between) };
        let share = interval_ns as f64 / (interval_ns + interval_before_ns) as f64;
        Some(between + (between - before) * share)
    }
}

/// Those of the landmarks that the frame sees. `None` if it sees none.
fn inverse_depths(frame: &TrackedFrame, map: &Map) -> Option<InverseDepths> {
    let seen = frame.landmark_positions(map).into_iter().filter(|position| position.z > 0.0);
    let places = seen.map(|position| (frame.features.pinhole.project(&position), 1.0 / position.z));
    InverseDepths::new(frame.features.bounds, places)
}

/// `None` for what is not in front of the camera.
fn inverse_depth_of(frame: &TrackedFrame, position: Vector3<f64>) -> Option<f64> {
    let depth = frame.camera_from_world.transform(&position).z;
    (depth > 0.0).then(|| 1.0 / depth)
}
