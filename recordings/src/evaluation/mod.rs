//! How far an estimated trajectory is from the true one.
//!
//! One camera cannot see scale, so the estimate is first brought onto the truth by the similarity that makes
//! the squared distances of the positions least [Umeyama 1991; Sturm et al. 2012]. The figures are those of
//! `evo_ape tum TRUTH ESTIMATE -as` and `evo_rpe tum TRUTH ESTIMATE -as`.

mod alignment;
mod association;
mod hints;
mod offset;
mod pose_errors;
mod report;
mod segments;

pub use alignment::Alignment;
pub use association::{Match, associate};
pub use hints::hints;
pub use offset::{TimeOffset, find_offset};
pub use pose_errors::{PoseError, pose_errors};
pub use report::{Evaluation, EvaluationError, EvaluationOptions, evaluate};
pub use segments::SegmentErrors;
