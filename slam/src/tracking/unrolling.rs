//! Rolling shutter while tracking: a frame's features as the camera of its middle row sees them, by the
//! motion predicted for it first, and by its own once it has a pose. [method: Rolling shutter]

use super::Tracker;
use super::following::{InLocalMap, LastFrame, PoseStart};
use super::frame::TrackedFrame;
use super::pose::place_frame;
use crate::features::View;
use crate::map::Map;
use crate::rolling_shutter::{RollingShutter, Velocity};
use geometry::nalgebra::Vector2;
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
        let depths = last.frame.inverse_depths(map)?;
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
            let Some(depths) = found.frame.inverse_depths(map) else { return };
            let inverse_depth = |feature_idx: Option<usize>, place: &Vector2<f64>| {
                let matched = feature_idx.and_then(|idx| found.frame.inverse_depth_of(idx, map));
                matched.unwrap_or_else(|| depths.at(place))
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
