//! Local map: keyframes that share points with a frame, their neighbors, and the landmarks those see.

use super::frame::TrackedFrame;
use crate::config::{LineConfig, TrackingConfig};
use crate::map::{KeyframeId, LineId, Map, PointId, PointLandmark};
use crate::matching::{ExpectedLine, PredictedSegment, PredictedView, Window, find_in_window, match_lines};
use std::collections::BTreeSet;
use vision::matching::LOOSE_DISTANCE;

/// Neighbors taken in per keyframe that shares points with the frame.
const N_NEIGHBORS: usize = 10;

/// Scratch space of the local map, kept between frames so that a steady stream allocates little.
#[derive(Debug, Default)]
pub(crate) struct LocalMap {
    /// Points shared with the frame, per keyframe index.
    votes: Vec<u32>,
    keyframes: Vec<KeyframeId>,
    points: Vec<PointId>,
    lines: BTreeSet<LineId>,
    /// Per point index: the round in which it was last taken in.
    stamps: Vec<u32>,
    round: u32,
}

impl LocalMap {
    /// Collects what is near the frame. Returns the keyframe that shares the most points with it.
    pub fn collect(
        &mut self,
        map: &Map,
        frame: &TrackedFrame,
        config: &TrackingConfig,
    ) -> Option<KeyframeId> {
        self.votes.clear();
        self.votes.resize(map.last_ids().keyframe as usize, 0);
        for point in frame.points.iter().flatten().filter_map(|id| map.point(*id)) {
            for seen in &point.observations {
                self.votes[seen.keyframe.index()] += 1;
            }
        }
        let voted = self.votes.iter().enumerate().filter(|(_, n)| **n > 0);
        let mut ranked: Vec<(KeyframeId, u32)> =
            voted.map(|(idx, n)| (KeyframeId::from_index(idx), *n)).collect();
        ranked.sort_by_key(|(id, n)| (std::cmp::Reverse(*n), *id));
        let reference = ranked.first().map(|(id, _)| *id);

        self.keyframes.clear();
        self.keyframes.extend(ranked.iter().take(config.max_local_keyframes).map(|(id, _)| *id));
        let n_sharing = self.keyframes.len();
        for position in 0..n_sharing {
            let Some(keyframe) = map.keyframe(self.keyframes[position]) else { continue };
            let neighbors = keyframe.covisible().iter().take(N_NEIGHBORS).map(|(id, _)| *id);
            for neighbor in neighbors.chain(keyframe.parent) {
                if self.keyframes.len() >= config.max_local_keyframes {
                    break;
                }
                if !self.keyframes.contains(&neighbor) {
                    self.keyframes.push(neighbor);
                }
            }
        }
        self.collect_points(map);
        reference
    }

    fn collect_points(&mut self, map: &Map) {
        self.points.clear();
        self.lines.clear();
        self.round = self.round.wrapping_add(1);
        self.stamps.resize(map.last_ids().point as usize, self.round.wrapping_sub(1));
        for keyframe in self.keyframes.iter().filter_map(|id| map.keyframe(*id)) {
            for (_, id) in keyframe.observed_points() {
                let stamp = &mut self.stamps[id.index()];
                if *stamp != self.round {
                    *stamp = self.round;
                    self.points.push(id);
                }
            }
            self.lines.extend(keyframe.observed_lines().map(|(_, id)| id));
        }
    }

    /// Looks for the lines of the local map that the frame has not found yet. Returns which it should see in
    /// all.
    pub fn search_lines(&mut self, map: &Map, frame: &mut TrackedFrame, config: &LineConfig) -> Vec<LineId> {
        let mut visible: Vec<LineId> = frame.lines.iter().flatten().copied().collect();
        for id in &visible {
            self.lines.remove(id);
        }
        let expected: Vec<ExpectedLine<'_>> = self
            .lines
            .iter()
            .filter_map(|id| {
                let line = map.line(*id)?;
                let segment =
                    PredictedSegment::of(&line.endpoints, &frame.camera_from_world, &frame.features)?;
                Some(ExpectedLine { line, segment })
            })
            .collect();
        for (segment_idx, id) in
            match_lines(&expected, &frame.features, |idx| frame.lines[idx].is_none(), config)
        {
            frame.lines[segment_idx] = Some(id);
        }
        visible.extend(expected.iter().map(|expected| expected.line.id));
        visible
    }

    /// Looks for the points of the local map that the frame has not found yet. Returns which it should see in
    /// all.
    pub fn search(
        &mut self,
        map: &Map,
        frame: &mut TrackedFrame,
        radius_px: f64,
        config: &TrackingConfig,
    ) -> Vec<PointId> {
        // A round of its own marks what the frame has already.
        self.round = self.round.wrapping_add(1);
        let mut visible: Vec<PointId> = frame.points.iter().flatten().copied().collect();
        for id in &visible {
            if let Some(stamp) = self.stamps.get_mut(id.index()) {
                *stamp = self.round;
            }
        }
        let min_view_cosine = config.max_view_angle_deg.to_radians().cos();
        let center = frame.camera_from_world.center();
        let features = frame.features.clone();
        for id in self.points.iter().filter(|id| self.stamps[id.index()] != self.round) {
            let Some(point) = map.point(*id) else { continue };
            let view =
                PredictedView::of(point, &frame.camera_from_world, &center, &features, min_view_cosine);
            let Some(view) = view else { continue };
            visible.push(*id);
            let window = Window {
                pixel: view.pixel,
                radius_px: view.radius_px(radius_px, &features),
                octaves: view.octaves(),
                ratio: Some(config.match_ratio),
                max_distance: LOOSE_DISTANCE,
            };
            let found =
                find_in_window(&features, &point.descriptor, &window, |idx| frame.points[idx].is_some());
            if let Some(feature_idx) = found {
                frame.points[feature_idx] = Some(*id);
            }
        }
        visible
    }
}

/// Points of a keyframe that at least `min_observations` keyframes see.
pub(crate) fn n_established_points(map: &Map, id: KeyframeId, min_observations: usize) -> usize {
    let established = |point: &PointLandmark| point.observations.len() >= min_observations;
    map.keyframe(id).map_or(0, |keyframe| {
        keyframe.observed_points().filter(|(_, id)| map.point(*id).is_some_and(established)).count()
    })
}
