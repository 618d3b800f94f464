//! What became of the lines of the last frame and of the detections of this one.

use crate::lines::FlowFailure;

/// Counts of one frame. The lines that come out are `n_by_flow + n_by_descriptor + n_by_merging +
/// n_flow_only + n_new`; those of the last frame are the same without `n_new`, and those lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineTrackingStatistics {
    /// Segments given.
    pub n_detected: usize,
    /// Of those, dropped for holding something that is not finite.
    pub n_not_finite: usize,
    /// Of those, dropped as too short.
    pub n_too_short: usize,
    /// Of those, not looked at because there were too many longer ones.
    pub n_beyond_limit: usize,
    /// Lines flow found, and a detection confirmed.
    pub n_by_flow: usize,
    /// Of those, lines for which the prediction scored better than the detection.
    pub n_prediction_better: usize,
    /// Lines flow lost, but a detection that looks the same was found for.
    pub n_by_descriptor: usize,
    /// Lines flow found of which only pieces were detected.
    pub n_by_merging: usize,
    /// Lines flow found that were not detected.
    pub n_flow_only: usize,
    /// Lines begun in this frame.
    pub n_new: usize,
    /// Of all lines that come out, those put together from several pieces.
    pub n_merged: usize,
    /// Detections that could have begun a line if there were not too many already.
    pub n_new_beyond_limit: usize,
    /// Lines that ended, by reason.
    pub lost: LostLines,
}

/// Lines that ended, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LostLines {
    /// They left the image, all but too short a piece.
    pub left_image: usize,
    /// Flow found no line most places agree on, and nothing detected looks the same.
    pub flow_inconsistent: usize,
    /// Flow put them where the image shows no edge.
    pub without_edge: usize,
    /// Flow put them where it looks different.
    pub looks_different: usize,
    /// They were not detected for too many frames.
    pub undetected_too_long: usize,
    /// They turned out to be one with a line tracked longer.
    pub merged_into_another: usize,
    /// The image had another size.
    pub image_changed: usize,
}

impl LostLines {
    /// All of them.
    pub fn total(&self) -> usize {
        self.left_image
            + self.flow_inconsistent
            + self.without_edge
            + self.looks_different
            + self.undetected_too_long
            + self.merged_into_another
            + self.image_changed
    }

    pub(super) fn count(&mut self, reason: LossReason) {
        let counter = match reason {
            LossReason::LeftImage => &mut self.left_image,
            LossReason::FlowInconsistent => &mut self.flow_inconsistent,
            LossReason::WithoutEdge => &mut self.without_edge,
            LossReason::LooksDifferent => &mut self.looks_different,
            LossReason::UndetectedTooLong => &mut self.undetected_too_long,
            LossReason::MergedIntoAnother => &mut self.merged_into_another,
        };
        *counter += 1;
    }
}

/// Why one line ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LossReason {
    LeftImage,
    FlowInconsistent,
    WithoutEdge,
    LooksDifferent,
    UndetectedTooLong,
    MergedIntoAnother,
}

impl From<FlowFailure> for LossReason {
    fn from(failure: FlowFailure) -> Self {
        match failure {
            FlowFailure::OutsideImage { .. } => Self::LeftImage,
            FlowFailure::NotASegment | FlowFailure::Inconsistent { .. } => Self::FlowInconsistent,
        }
    }
}
