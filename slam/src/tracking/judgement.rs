//! Pose quality: whether landmarks determine a pose, and whether enough of them agree.

use super::pose::Placement;
use crate::config::TrackingConfig;
use crate::report::{LostReason, PoseUncertainty, TrackingOutcome};

/// Whether enough landmarks agree with a pose, and whether they determine it. [method: Judging a pose]
///
/// Few landmarks are enough in a place that has few, but where `n_expected` could have been found and hardly
/// any was, the few agree by chance.
pub(super) fn judge(
    placement: &Placement,
    n_expected: usize,
    was_lost: bool,
    config: &TrackingConfig,
) -> TrackingOutcome {
    let Placement { inliers, uncertainty, .. } = *placement;
    let n_inliers = inliers.total();
    let within = |factor: f64| is_within(&uncertainty, factor, config);
    let n_required_of = |share: f64, least: usize, plenty: usize| {
        ((share * n_expected as f64).ceil() as usize).clamp(least, plenty)
    };
    let n_required_good = n_required_of(config.min_found_share, config.min_inliers, config.plentiful_inliers);
    let n_required_weak = n_required_of(
        0.5 * config.min_found_share,
        config.min_weak_inliers,
        config.plentiful_inliers.div_ceil(2),
    );
    // A camera that was lost may be anywhere: a weak pose is no evidence that it was found.
    let n_required_weak = if was_lost { n_required_good } else { n_required_weak };
    if n_inliers < n_required_weak {
        let n_required = n_required_weak;
        TrackingOutcome::Lost(LostReason::TooFewInliers { n_inliers, n_required })
    } else if !within(config.weak_sigma_factor) {
        TrackingOutcome::Lost(LostReason::Undetermined { uncertainty })
    } else if n_inliers < n_required_good || !within(1.0) {
        TrackingOutcome::Weak { n_inliers, n_required: n_required_good, uncertainty }
    } else {
        TrackingOutcome::Tracked
    }
}

/// Whether a pose is known well enough for a keyframe: a little less well than a good one.
pub(crate) fn is_certain_enough(outcome: &TrackingOutcome, config: &TrackingConfig) -> bool {
    match outcome {
        TrackingOutcome::Tracked => true,
        TrackingOutcome::Weak { uncertainty, .. } => {
            is_within(uncertainty, config.keyframe_sigma_factor, config)
        }
        TrackingOutcome::CalibrationContradicted => true,
        TrackingOutcome::Initialising(_) | TrackingOutcome::Lost(_) => false,
    }
}

/// Whether a pose is at most `factor` times as uncertain as a good one may be.
fn is_within(uncertainty: &PoseUncertainty, factor: f64, config: &TrackingConfig) -> bool {
    uncertainty.rotation_rad <= factor * config.max_rotation_sigma_deg.to_radians()
        && uncertainty.position_share <= factor * config.max_position_sigma_share
}
