//! The segments detected in the image at hand, and which of them are taken.

use super::{LineTrackerConfig, LineTrackingStatistics};
use crate::lines::clip::Frame;
use crate::lines::{LineDescriber, Segment};
use crate::{Descriptor, GrayImage};

/// Detected segments in the order given, with the descriptors of those that were asked for.
#[derive(Clone, Debug, Default)]
pub(super) struct Detections {
    segments: Vec<Segment>,
    descriptors: Vec<Option<Descriptor>>,
    taken: Vec<bool>,
}

/// Detections that no line has taken.
pub(super) struct Remaining {
    /// Where they stand among all.
    pub indices: Vec<usize>,
    pub segments: Vec<Segment>,
}

impl Detections {
    /// Those of `detected` that are finite and long enough within the image; the longest, if there are too
    /// many.
    pub fn accept(
        mut detected: Vec<Segment>,
        frame: Frame,
        config: &LineTrackerConfig,
        statistics: &mut LineTrackingStatistics,
    ) -> Self {
        let n_given = detected.len();
        detected.retain(|segment| segment.is_finite() && segment.length().is_finite());
        let n_finite = detected.len();
        let mut detected: Vec<Segment> = detected.iter().filter_map(|segment| frame.clip(segment)).collect();
        detected.retain(|segment| segment.length() >= config.min_length_px);
        statistics.n_not_finite = n_given - n_finite;
        statistics.n_too_short = n_finite - detected.len();
        statistics.n_beyond_limit = detected.len().saturating_sub(config.max_detections);
        if statistics.n_beyond_limit > 0 {
            detected.sort_by(|a, b| b.length().total_cmp(&a.length()));
            detected.truncate(config.max_detections);
        }
        // Nobody knows an edge better than this, and a score must not become infinite.
        detected.iter_mut().for_each(|segment| segment.sigma_px = segment.sigma_px.max(MIN_SIGMA_PX));
        let n = detected.len();
        Self { segments: detected, descriptors: vec![None; n], taken: vec![false; n] }
    }

    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Describes one by the image in half its resolution, unless that was done already.
    pub fn describe(
        &mut self,
        index: usize,
        describer: &mut LineDescriber,
        halved: &GrayImage,
    ) -> Descriptor {
        *self.descriptors[index]
            .get_or_insert_with(|| describer.describe_halved(halved, &self.segments[index]))
    }

    /// What one looks like, if it was described.
    pub fn descriptor(&self, index: usize) -> Option<Descriptor> {
        self.descriptors[index]
    }

    /// Takes one for a line.
    pub fn take(&mut self, index: usize) -> (Segment, Option<Descriptor>) {
        self.taken[index] = true;
        (self.segments[index], self.descriptors[index])
    }

    pub fn remaining(&self) -> Remaining {
        let indices: Vec<usize> = (0..self.segments.len()).filter(|index| !self.taken[*index]).collect();
        Remaining { segments: indices.iter().map(|index| self.segments[*index]).collect(), indices }
    }
}

/// Least standard deviation of a segment across itself, pixels.
const MIN_SIGMA_PX: f32 = 0.05;
