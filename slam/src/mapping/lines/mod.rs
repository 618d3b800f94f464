//! Lines of the map: made of tracked segments, verified, joined and culled, keyframe by keyframe.
//! [method: Line landmarks]

mod fusion;
mod triangulation;
mod verification;

use verification::{ViewCheck, judge};

use crate::config::SlamConfig;
use crate::landmarks::TrackView;
use crate::map::{KeyframeId, LineId, Map, Observation, median_depth};
use crate::report::{LineJudgement, LineVerdict};
use std::collections::BTreeMap;

/// Observations that a line needs to survive its probation.
const MIN_OBSERVATIONS: usize = 3;
/// Views of a track that are looked at: the newest say the most, and pairs grow with the square.
const MAX_TRACK_VIEWS: usize = 20;
/// A track not seen for this many keyframes of its camera has ended.
const MAX_TRACK_AGE: u64 = 5;

/// Follows the tracks of segments through the keyframes and makes lines of them.
#[derive(Debug, Default)]
pub(super) struct LineMapper {
    /// Where each live track was seen, oldest first.
    tracks: BTreeMap<u64, Vec<Observation>>,
    /// Lines on probation.
    recent: Vec<LineId>,
    /// What became of the candidates since they were last taken.
    judgements: Vec<LineJudgement>,
}

impl LineMapper {
    /// Takes in the segments of a keyframe that is in the map: culls young lines, makes new ones, joins the
    /// same.
    pub fn extend(&mut self, map: &mut Map, id: KeyframeId, config: &SlamConfig) {
        self.cull_recent(map, id, config);
        self.follow_tracks(map, id);
        // Lines that are made do not change it.
        let depth = map.keyframe(id).and_then(|keyframe| median_depth(map, keyframe));
        for track in tracks_without_line(map, id) {
            self.extend_track(map, id, track, depth, config);
        }
        fusion::fuse_with_neighbors(map, id, config);
    }

    /// What became of the candidates since this was last called.
    pub fn take_judgements(&mut self) -> Vec<LineJudgement> {
        std::mem::take(&mut self.judgements)
    }

    /// Forgets what is no longer in the map.
    pub fn forget_missing(&mut self, map: &Map) {
        self.recent.retain(|id| map.line(*id).is_some());
        for views in self.tracks.values_mut() {
            views.retain(|seen| map.keyframe(seen.keyframe).is_some());
        }
    }

    fn follow_tracks(&mut self, map: &Map, id: KeyframeId) {
        let Some(keyframe) = map.keyframe(id) else { return };
        for (idx, segment) in keyframe.features.lines.iter().enumerate() {
            let views = self.tracks.entry(segment.track).or_default();
            views.push(Observation { keyframe: id, feature_idx: idx as u32 });
            if views.len() > MAX_TRACK_VIEWS {
                views.remove(0);
            }
        }
        self.tracks.retain(|_, views| {
            views.last().is_some_and(|seen| map.age(seen.keyframe, id, MAX_TRACK_AGE) <= MAX_TRACK_AGE)
        });
    }

    /// Lets a track's newest segment see the line the track saw before, or makes a line of the track.
    /// `median_depth` is that of the points the keyframe sees.
    fn extend_track(
        &mut self,
        map: &mut Map,
        id: KeyframeId,
        track: u64,
        median_depth: Option<f64>,
        config: &SlamConfig,
    ) {
        let (Some(keyframe), Some(views)) = (map.keyframe(id), self.tracks.get(&track)) else { return };
        let Some(newest) = views.last() else { return };
        let (sequence, submap) = (keyframe.sequence, keyframe.submap);
        let known = views.iter().rev().find_map(|seen| {
            map.keyframe(seen.keyframe).and_then(|seen_in| seen_in.lines[seen.feature_idx as usize])
        });
        if let Some(line_id) = known {
            let agrees = map.line(line_id).zip(TrackView::of(map, *newest)).is_some_and(|(line, view)| {
                judge(&line.endpoints, &view, &config.lines) == ViewCheck::Passed
            });
            if agrees {
                map.add_line_observation(line_id, *newest);
            }
            return;
        }
        let views: Vec<TrackView> = views
            .iter()
            .filter(|seen| map.keyframe(seen.keyframe).is_some_and(|keyframe| keyframe.submap == submap))
            .filter_map(|seen| TrackView::of(map, *seen))
            .collect();
        let Some(candidate) = triangulation::triangulate(&views, median_depth, &config.lines) else { return };
        let verdict = candidate.outcome.as_ref().err().copied().unwrap_or(LineVerdict::Made);
        let endpoints_in_camera =
            candidate.place.endpoints.map(|end| keyframe.camera_from_world.transform(&end));
        self.judgements.push(LineJudgement { sequence, submap, track, endpoints_in_camera, verdict });
        if let Ok(observations) = candidate.outcome {
            self.recent.extend(map.add_line(&candidate.place, id, &observations));
        }
    }

    /// Judges young lines: out if rarely found, or not seen by three keyframes soon enough.
    fn cull_recent(&mut self, map: &mut Map, newest: KeyframeId, config: &SlamConfig) {
        self.recent.retain(|id| {
            let Some(line) = map.line(*id) else { return false };
            let age = map.age(line.created_by, newest, config.lines.probation_keyframes);
            let unreliable = line.found_ratio() < config.lines.min_found_ratio;
            let unconfirmed =
                age >= config.lines.probation_keyframes && line.observations.len() < MIN_OBSERVATIONS;
            if unreliable || unconfirmed {
                map.remove_line(*id);
                return false;
            }
            age <= config.lines.probation_keyframes
        });
    }
}

/// The tracks of a keyframe's segments that see no line yet.
fn tracks_without_line(map: &Map, id: KeyframeId) -> Vec<u64> {
    let Some(keyframe) = map.keyframe(id) else { return Vec::new() };
    let segments = keyframe.features.lines.iter().zip(&keyframe.lines);
    segments.filter(|(_, line)| line.is_none()).map(|(segment, _)| segment.track).collect()
}
