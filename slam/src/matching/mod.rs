//! Data association: landmarks found in a view by projection, by descriptor, and joined where they are the
//! same.

mod fusion;
mod lines;
mod search;

pub(crate) use fusion::fuse_into;
pub(crate) use lines::{ExpectedLine, PredictedSegment, match_lines, project_segment};
pub(crate) use search::{
    Expected, PredictedView, Window, find_in_window, match_keyframe, match_place, search_by_motion,
};
