//! What bundle adjustment, loop closing and mapping share about landmarks: the views of a line, its seen
//! extent, the fused direction of a global primitive, visibility counts, and corrections.

mod corrections;
mod direction;
mod extent;
mod track_view;
mod visibility;

pub(crate) use corrections::{Anchoring, Corrections, apply_corrections};
pub(crate) use direction::{DirectionEstimate, estimate_direction, in_world, sigma_rad};
pub(crate) use extent::seen_part;
pub(crate) use track_view::{TrackView, directed};
pub(crate) use visibility::{VisibilityCounts, VisibleLandmarks};
