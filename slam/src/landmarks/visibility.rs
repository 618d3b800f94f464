//! How often landmarks were found where they should be visible: what map point culling decides by.

use crate::map::{LineId, PointId};
use std::collections::BTreeMap;

/// How often each landmark should have been found and was, since the last keyframe.
#[derive(Debug, Default)]
pub(crate) struct VisibilityCounts {
    counts: BTreeMap<PointId, (u32, u32)>,
    line_counts: BTreeMap<LineId, (u32, u32)>,
}

/// The landmarks that a frame should see under a pose that may yet be refused.
#[derive(Debug)]
pub(crate) struct VisibleLandmarks {
    pub points: Vec<PointId>,
    pub lines: Vec<LineId>,
}

impl VisibilityCounts {
    pub fn visible(&mut self, id: PointId) {
        self.counts.entry(id).or_default().0 += 1;
    }

    pub fn found(&mut self, id: PointId) {
        self.counts.entry(id).or_default().1 += 1;
    }

    pub fn line_visible(&mut self, id: LineId) {
        self.line_counts.entry(id).or_default().0 += 1;
    }

    pub fn line_found(&mut self, id: LineId) {
        self.line_counts.entry(id).or_default().1 += 1;
    }

    /// Line, frames that should have seen it, frames that did.
    pub fn lines(&self) -> impl Iterator<Item = (LineId, u32, u32)> + '_ {
        self.line_counts.iter().map(|(id, (visible, found))| (*id, *visible, *found))
    }

    /// Point, frames that should have seen it, frames that did.
    pub fn iter(&self) -> impl Iterator<Item = (PointId, u32, u32)> + '_ {
        self.counts.iter().map(|(id, (visible, found))| (*id, *visible, *found))
    }
}
