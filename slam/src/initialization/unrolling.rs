//! Rolling shutter at the beginning: how the camera moved while each of the two views was read follows from
//! where the views beside them were taken, seen from the first points. [method: Rolling shutter]

use super::{InitialPair, third_view};
use crate::config::InitializationConfig;
use crate::features::View;
use crate::rolling_shutter::{InverseDepths, RollingShutter, Velocity};
use geometry::Pose;
use geometry::nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A view beside one of a pair that is placed by fewer points tells nothing of how the camera moved.
const MIN_AGREEING: usize = 30;

/// A view of the pair with its keypoints of the points.
struct Side<'a> {
    view: &'a View,
    camera_from_first: Pose,
    points: Vec<(usize, Vector3<f64>)>,
}

/// Both views as cameras of their middle rows see them. `None` if it cannot be told how the camera moved.
pub(super) fn unroll_pair(
    shutter: &RollingShutter,
    pair: &InitialPair,
    views: &[View],
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> Option<[View; 2]> {
    let first = Side {
        view: &pair.first,
        camera_from_first: Pose::identity(),
        points: pair.points.iter().map(|(idx, _, position)| (*idx, *position)).collect(),
    };
    let second = Side {
        view: &pair.second,
        camera_from_first: pair.second_from_first,
        points: pair.points.iter().map(|(_, idx, position)| (*idx, *position)).collect(),
    };
    let mean =
        RollingShutter::velocity(&pair.second_from_first, pair.second.timestamp_ns - pair.first.timestamp_ns);
    let mut unrolled = [&first, &second].into_iter().map(|side| {
        let velocity = velocity_of(side, views, config, rng).or(mean)?;
        unroll(shutter, side, &velocity)
    });
    Some([unrolled.next()??, unrolled.next()??])
}

fn unroll(shutter: &RollingShutter, side: &Side, velocity: &Velocity) -> Option<View> {
    let features = &side.view.features;
    let seen: BTreeMap<usize, f64> = side
        .points
        .iter()
        .map(|(idx, position)| (*idx, 1.0 / side.camera_from_first.transform(position).z))
        .filter(|(_, inverse_depth)| *inverse_depth > 0.0)
        .collect();
    let places = seen.iter().map(|(idx, inverse_depth)| (features.undistorted[*idx], *inverse_depth));
    let depths = InverseDepths::new(features.bounds, places)?;
    let inverse_depth = |idx: Option<usize>, place: &_| {
        idx.and_then(|idx| seen.get(&idx).copied()).unwrap_or_else(|| depths.at(place))
    };
    let features = shutter.settle(&shutter.unroll(features, velocity, inverse_depth))?;
    Some(View { features: Arc::new(features), ..side.view.clone() })
}

/// From the view that was taken next to this one in time.
fn velocity_of(
    side: &Side,
    views: &[View],
    config: &InitializationConfig,
    rng: &mut ChaCha8Rng,
) -> Option<Velocity> {
    let interval_ns = |view: &View| view.timestamp_ns - side.view.timestamp_ns;
    let beside = views.iter().filter(|view| view.sequence != side.view.sequence);
    let beside = beside.min_by_key(|view| interval_ns(view).abs())?;
    let placed = third_view::place(side.view, side.points.iter().copied(), beside, config, rng).0?;
    if placed.n_inliers < MIN_AGREEING {
        return None;
    }
    let motion = placed.model * side.camera_from_first.inverse();
    RollingShutter::velocity(&motion, interval_ns(beside))
}
