//! Fusion of duplicate lines, and observations that were missed. [method: Line fusion]

use super::verification::{ViewCheck, judge};
use crate::config::{LineConfig, SlamConfig};
use crate::landmarks::TrackView;
use crate::map::{Keyframe, KeyframeId, LineId, LineLandmark, Map, Observation};
use crate::mapping::neighbors;
use crate::matching::{ExpectedLine, PredictedSegment, match_lines};
use std::collections::BTreeSet;

/// Looks for the neighbors' lines in the keyframe and for the keyframe's lines in its neighbors.
pub(super) fn fuse_with_neighbors(map: &mut Map, id: KeyframeId, config: &SlamConfig) {
    let targets = neighbors(map, id, config.lines.n_fusion_neighbors);
    let theirs: BTreeSet<LineId> = targets.iter().flat_map(|target| lines_of(map, *target)).collect();
    fuse_into(map, &theirs, id, &config.lines);
    let own: BTreeSet<LineId> = lines_of(map, id).into_iter().collect();
    for target in targets {
        fuse_into(map, &own, target, &config.lines);
    }
    for line in lines_of(map, id) {
        map.refresh_line(line);
    }
}

fn lines_of(map: &Map, id: KeyframeId) -> Vec<LineId> {
    map.keyframe(id).into_iter().flat_map(Keyframe::observed_lines).map(|(_, id)| id).collect()
}

/// Looks for lines in a keyframe: one already explained there is joined with what explains it if the two
/// agree in space; a segment that sees nothing yet sees it from now on.
fn fuse_into(map: &mut Map, lines: &BTreeSet<LineId>, target: KeyframeId, config: &LineConfig) {
    let Some(keyframe) = map.keyframe(target) else { return };
    let features = keyframe.features.clone();
    let expected: Vec<ExpectedLine<'_>> = lines
        .iter()
        .filter_map(|id| map.line(*id))
        .filter(|line| line.submap == keyframe.submap && line.observation_in(target).is_none())
        .filter_map(|line| {
            let segment = PredictedSegment::of(&line.endpoints, &keyframe.camera_from_world, &features)?;
            Some(ExpectedLine { line, segment })
        })
        .collect();
    let matches = match_lines(&expected, &features, |_| true, config);
    for (segment_idx, id) in matches {
        let seen = Observation { keyframe: target, feature_idx: segment_idx as u32 };
        let (Some(view), Some(line)) = (TrackView::of(map, seen), map.line(id)) else { continue };
        if judge(&line.endpoints, &view, config) != ViewCheck::Passed {
            continue;
        }
        match map.keyframe(target).and_then(|keyframe| keyframe.lines[segment_idx]) {
            None => {
                map.add_line_observation(id, seen);
            }
            Some(other) if other != id => {
                let Some(other_line) = map.line(other) else { continue };
                if are_same(map, line, other_line, config) {
                    let keeps_other = other_line.observations.len() > line.observations.len();
                    let (kept, gone) = if keeps_other { (other, id) } else { (id, other) };
                    map.fuse_lines(kept, gone);
                }
            }
            Some(_) => {}
        }
    }
}

/// Whether two lines are one edge: nearly parallel, and each agrees with what is seen of the other.
fn are_same(map: &Map, a: &LineLandmark, b: &LineLandmark, config: &LineConfig) -> bool {
    let cosine = a.line.direction().dot(b.line.direction());
    let gates = LineConfig { max_end_distance_px: config.fusion_distance_px, ..config.clone() };
    let fits = |line: &LineLandmark, other: &LineLandmark| {
        let views = other.observations.iter().filter_map(|seen| TrackView::of(map, *seen));
        views.filter(|view| judge(&line.endpoints, view, &gates) == ViewCheck::Passed).count() * 2
            > other.observations.len()
    };
    cosine >= config.fusion_angle_deg.to_radians().cos() && fits(a, b) && fits(b, a)
}
