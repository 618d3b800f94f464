//! Line tracking, from image to image: flow predicts the lines of the last image, detections confirm or
//! replace the predictions, and pieces of one edge become one line [after the optical flow-based line fusion
//! of Jiang et al. and Lim et al., "Avoiding degeneracy for monocular visual SLAM with point and line
//! features", ICRA 2021].

mod config;
mod detections;
mod statistics;
#[cfg(test)]
mod tests;

use nalgebra::Vector2;

use super::clip::Frame;
use super::flow::{FlowPyramid, LineFlow, MotionPrior};
use super::matching::{DescribedLines, match_lines_lazily};
use super::merging::{belong_together, merge_collinear, merge_pair};
use super::sampling::Sampler;
use super::support::EdgeProbe;
use super::{LineDescriber, Segment};
use crate::{Descriptor, GrayImage};
pub use config::{LineTrackerConfig, LineTrackerConfigError};
use detections::Detections;
use statistics::LossReason;
pub use statistics::{LineTrackingStatistics, LostLines};

/// Where a line's segment comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineOrigin {
    /// It was detected in this image.
    Detected,
    /// Flow moved it here; at least its extent is no measurement.
    Flowed,
    /// It was put together from detections, or from detections and what flow predicted.
    Merged,
}

/// A line of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedLine {
    /// Where it is: the part inside the image.
    pub segment: Segment,
    /// What it looks like there.
    pub descriptor: Descriptor,
    /// Which line it is. The same in every frame, and never given to another line.
    pub track: u64,
    /// In how many frames in a row it has been seen, this one included.
    pub age: u32,
    /// Where `segment` comes from.
    pub origin: LineOrigin,
}

/// The lines of one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackedLines {
    /// In the order of their tracks.
    pub lines: Vec<TrackedLine>,
    /// What became of the lines of the last image and of the detections.
    pub statistics: LineTrackingStatistics,
}

/// A line reaches beyond the image by at most this share of its larger side: nobody can say anything about
/// more.
const MAX_BEYOND_SHARE: f32 = 0.5;
/// An end this near to the image's edge, pixels, was cut off there, if the line is known to go on.
const CUT_OFF_PX: f32 = 5.0;
/// Hamming distance at which descriptors of unrelated segments lie on average in drawn scenes, bits: the
/// score there is nil.
const UNRELATED_DISTANCE: f32 = 83.0;

/// Follows lines from image to image. Buffers are kept.
#[derive(Clone, Debug)]
pub struct LineTracker {
    config: LineTrackerConfig,
    describer: LineDescriber,
    flow: LineFlow,
    /// The last image and the one at hand.
    last: FlowPyramid,
    next: FlowPyramid,
    tracks: Vec<Track>,
    next_track: u64,
}

/// A line as it was in the last image.
#[derive(Clone, Copy, Debug)]
struct Track {
    id: u64,
    age: u32,
    n_flow_only: u32,
    /// The part in the image.
    segment: Segment,
    /// With ends beyond the image, where they are known to lie there.
    extent: Segment,
    descriptor: Descriptor,
}

/// Where flow puts a line.
#[derive(Clone, Copy, Debug)]
struct Prediction {
    /// The part in the image that shows an edge.
    segment: Segment,
    /// With ends beyond the image.
    extent: Segment,
}

/// How the line of a track was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    ByFlow,
    ByDescriptor,
    FlowOnly,
}

/// A line of the image at hand before pieces are merged.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    track_idx: usize,
    found: Found,
    segment: Segment,
    extent: Segment,
    origin: LineOrigin,
    /// `None` if the segment was changed since.
    descriptor: Option<Descriptor>,
}

impl LineTracker {
    /// A tracker that has seen no image.
    pub fn new(config: LineTrackerConfig) -> Result<Self, LineTrackerConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            describer: LineDescriber::new(),
            flow: LineFlow::new(config.flow),
            last: FlowPyramid::default(),
            next: FlowPyramid::default(),
            tracks: Vec::new(),
            next_track: 0,
        })
    }

    /// The configuration in force.
    pub fn config(&self) -> &LineTrackerConfig {
        &self.config
    }

    /// Forgets all lines and the last image. Track numbers go on.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.last = FlowPyramid::default();
    }

    /// Finds the lines of `image`, given the segments detected in it and, if something is known of the
    /// camera's motion, where pixels of the last image are expected.
    pub fn track(
        &mut self,
        image: &GrayImage,
        detected: Vec<Segment>,
        prior: Option<&MotionPrior>,
    ) -> TrackedLines {
        let mut statistics = LineTrackingStatistics { n_detected: detected.len(), ..Default::default() };
        let last_image = self.last.image();
        if (last_image.width(), last_image.height()) != (image.width(), image.height()) {
            statistics.lost.image_changed = self.tracks.len();
            self.tracks.clear();
        }
        self.next.build(image);
        let mut detections = Detections::accept(detected, self.frame(), &self.config, &mut statistics);

        let predictions: Vec<_> = (0..self.tracks.len()).map(|track| self.predict(track, prior)).collect();
        let mut candidates = self.confirm(&predictions, &mut detections, &mut statistics);
        self.find_by_descriptor(&predictions, &mut detections, prior, &mut candidates, &mut statistics);
        // Whichever has been tracked longest survives a merger.
        candidates.sort_unstable_by_key(|candidate| self.tracks[candidate.track_idx].id);
        let tracks = self.merge_and_begin(candidates, &detections, &mut statistics);

        let lines = tracks.iter().map(|(track, origin)| self.report(track, *origin)).collect();
        self.tracks = tracks.into_iter().map(|(track, _)| track).collect();
        std::mem::swap(&mut self.last, &mut self.next);
        TrackedLines { lines, statistics }
    }

    fn frame(&self) -> Frame {
        Frame::of_image(self.next.image().width(), self.next.image().height())
    }

    fn probe(&self) -> EdgeProbe<'_> {
        EdgeProbe::new(Sampler::new(self.next.image()), &self.config.support)
    }

    /// Where flow puts a line, as far as the image shows an edge there.
    fn predict(&mut self, track: usize, prior: Option<&MotionPrior>) -> Result<Prediction, LossReason> {
        let flowed = self.flow.follow(&self.last, &self.next, &self.tracks[track].extent, prior)?;
        let visible = self.frame().clip(&flowed.segment).ok_or(LossReason::LeftImage)?;
        if visible.length() < self.config.min_length_px {
            return Err(LossReason::LeftImage);
        }
        let supported = self.probe().supported_part(&visible, &self.config.support);
        let segment = supported.filter(|segment| segment.length() >= self.config.min_length_px);
        let segment = segment.ok_or(LossReason::WithoutEdge)?;
        Ok(Prediction { segment, extent: self.extended(&segment, &flowed.segment) })
    }

    /// `segment` with those of its ends moved beyond the image that were cut off by its edge, as `known`
    /// says.
    fn extended(&self, segment: &Segment, known: &Segment) -> Segment {
        let frame = self.frame();
        let beyond_px = MAX_BEYOND_SHARE * self.next.image().width().max(self.next.image().height()) as f32;
        let (inner, outer) = (frame.grown(-CUT_OFF_PX), frame.grown(beyond_px));
        let direction = segment.direction();
        let end = |own: Vector2<f32>, known: Vector2<f32>| {
            let dropped = segment.start + direction * direction.dot(&(known - segment.start));
            let goes_on = !inner.contains(&own) && !frame.contains(&dropped) && !frame.contains(&known);
            if goes_on { dropped } else { own }
        };
        let extent =
            Segment { start: end(segment.start, known.start), end: end(segment.end, known.end), ..*segment };
        // An end may only move outwards.
        let grows = extent.length() >= segment.length() && extent.direction().dot(&direction) > 0.0;
        outer.clip(&extent).filter(|_| grows).unwrap_or(*segment)
    }

    /// Lines that flow found: with the detection that confirms them, or as they are.
    fn confirm(
        &mut self,
        predictions: &[Result<Prediction, LossReason>],
        detections: &mut Detections,
        statistics: &mut LineTrackingStatistics,
    ) -> Vec<Candidate> {
        let found: Vec<(usize, Prediction)> =
            predictions.iter().enumerate().filter_map(|(track, p)| Some((track, p.ok()?))).collect();
        let segments: Vec<Segment> = found.iter().map(|(_, prediction)| prediction.segment).collect();
        let descriptors: Vec<Descriptor> =
            found.iter().map(|(track, _)| self.tracks[*track].descriptor).collect();
        let predicted = DescribedLines { segments: &segments, descriptors: &descriptors };
        let mut detection_of = vec![None; found.len()];
        let detected = detections.segments().to_vec();
        let (describer, halved) = (&mut self.describer, self.next.halved());
        let describe = |index| detections.describe(index, describer, halved);
        for confirmed in match_lines_lazily(predicted, &detected, describe, &self.config.predicted_match) {
            detection_of[confirmed.first_idx as usize] =
                Some((confirmed.second_idx as usize, confirmed.distance));
        }
        let mut candidates = Vec::with_capacity(found.len());
        for ((track_idx, prediction), detection) in found.into_iter().zip(detection_of) {
            let flowed = Candidate {
                track_idx,
                found: Found::FlowOnly,
                segment: prediction.segment,
                extent: prediction.extent,
                origin: LineOrigin::Flowed,
                descriptor: None,
            };
            match detection {
                Some((detection, detected_distance)) => {
                    let (detected, detected_descriptor) = detections.take(detection);
                    candidates.push(Candidate {
                        found: Found::ByFlow,
                        ..self.choose(flowed, &detected, detected_descriptor, detected_distance)
                    });
                }
                None => match self.describe_flowed(flowed) {
                    (flowed, distance) if distance <= self.config.max_flow_distance => {
                        candidates.push(flowed);
                    }
                    _ => statistics.lost.count(LossReason::LooksDifferent),
                },
            }
        }
        candidates
    }

    /// A predicted line with its descriptor, and how far that is from what the line looked like, bits.
    fn describe_flowed(&mut self, flowed: Candidate) -> (Candidate, u32) {
        let descriptor = self.describer.describe_halved(self.next.halved(), &flowed.segment);
        let distance = descriptor.distance(&self.tracks[flowed.track_idx].descriptor);
        (Candidate { descriptor: Some(descriptor), ..flowed }, distance)
    }

    /// Of a predicted line and its detection: both merged if the detection is but a piece, else the better
    /// one.
    fn choose(
        &mut self,
        flowed: Candidate,
        detected: &Segment,
        detected_descriptor: Option<Descriptor>,
        detected_distance: u32,
    ) -> Candidate {
        if belong_together(&flowed.segment, detected, &self.probe(), &self.config.merging) {
            let merged = merge_pair(&flowed.segment, detected);
            if merged.length() > (1.0 + self.config.merge_if_longer_by) * detected.length() {
                return Candidate {
                    segment: merged,
                    extent: self.extended(&merged, &flowed.extent),
                    origin: LineOrigin::Merged,
                    descriptor: None,
                    ..flowed
                };
            }
        }
        // What a segment says of a line grows with its length and falls with its noise.
        let score = |segment: &Segment, sigma_factor: f32, distance: u32| {
            let alike = (1.0 - distance as f32 / UNRELATED_DISTANCE).max(0.0);
            alike * segment.length() / (sigma_factor * segment.sigma_px)
        };
        let detected_score = score(detected, 1.0, detected_distance);
        let flowed_factor = self.config.flow_sigma_factor;
        // Describing takes time: most predictions would lose even if they looked exactly like the line.
        if score(&flowed.segment, flowed_factor, 0) > detected_score {
            let (flowed, distance) = self.describe_flowed(flowed);
            if score(&flowed.segment, flowed_factor, distance) > detected_score {
                return flowed;
            }
        }
        Candidate {
            segment: *detected,
            extent: self.extended(detected, &flowed.extent),
            origin: LineOrigin::Detected,
            descriptor: detected_descriptor,
            ..flowed
        }
    }

    /// Lines that flow did not find: detections near by that look the same. Those without one are lost.
    fn find_by_descriptor(
        &mut self,
        predictions: &[Result<Prediction, LossReason>],
        detections: &mut Detections,
        prior: Option<&MotionPrior>,
        candidates: &mut Vec<Candidate>,
        statistics: &mut LineTrackingStatistics,
    ) {
        let missed: Vec<(usize, LossReason)> =
            predictions.iter().enumerate().filter_map(|(track, p)| Some((track, p.err()?))).collect();
        let segments: Vec<Segment> =
            missed.iter().map(|(track, _)| expected_segment(&self.tracks[*track].segment, prior)).collect();
        let descriptors: Vec<Descriptor> =
            missed.iter().map(|(track, _)| self.tracks[*track].descriptor).collect();
        let missed_lines = DescribedLines { segments: &segments, descriptors: &descriptors };
        let remaining = detections.remaining();
        let (describer, halved) = (&mut self.describer, self.next.halved());
        let describe = |index: usize| detections.describe(remaining.indices[index], describer, halved);
        let config = &self.config.unpredicted_match;
        let matches = match_lines_lazily(missed_lines, &remaining.segments, describe, config);
        let mut detection_of = vec![None; missed.len()];
        for found in matches {
            detection_of[found.first_idx as usize] = Some(remaining.indices[found.second_idx as usize]);
        }
        for ((track_idx, reason), detection) in missed.into_iter().zip(detection_of) {
            let Some(detection) = detection else {
                statistics.lost.count(reason);
                continue;
            };
            let (segment, descriptor) = detections.take(detection);
            candidates.push(Candidate {
                track_idx,
                found: Found::ByDescriptor,
                segment,
                extent: segment,
                origin: LineOrigin::Detected,
                descriptor,
            });
        }
    }

    /// Merges pieces of one line and begins new lines with what is left.
    fn merge_and_begin(
        &mut self,
        candidates: Vec<Candidate>,
        detections: &Detections,
        statistics: &mut LineTrackingStatistics,
    ) -> Vec<(Track, LineOrigin)> {
        let remaining = detections.remaining();
        let mut pieces: Vec<Segment> = candidates.iter().map(|candidate| candidate.segment).collect();
        pieces.extend_from_slice(&remaining.segments);
        let merged = merge_collinear(self.next.image(), &pieces, &self.config.merging);
        let mut members = vec![Vec::new(); merged.segments.len()];
        for (piece, &line) in merged.merged_idx.iter().enumerate() {
            members[line as usize].push(piece);
        }
        let mut tracks = Vec::with_capacity(candidates.len());
        let mut new = Vec::new();
        for (segment, members) in merged.segments.iter().zip(&members) {
            let n_tracked = members.iter().filter(|member| **member < candidates.len()).count();
            // Fitting may move an end a little beyond the image; pieces lie inside, so something is left.
            let segment = self.frame().clip(segment).unwrap_or(pieces[members[0]]);
            if n_tracked > 0 {
                tracks.extend(self.go_on(&segment, members, n_tracked, &candidates, statistics));
            } else {
                new.push(match members[..] {
                    [lone] => {
                        let detection = remaining.indices[lone - candidates.len()];
                        (segment, LineOrigin::Detected, detections.descriptor(detection))
                    }
                    _ => (segment, LineOrigin::Merged, None),
                });
            }
        }
        self.begin(new, &mut tracks, statistics);
        tracks
    }

    /// The line that `members`, at least one of which is a candidate, make together.
    fn go_on(
        &mut self,
        merged: &Segment,
        members: &[usize],
        n_tracked: usize,
        candidates: &[Candidate],
        statistics: &mut LineTrackingStatistics,
    ) -> Option<(Track, LineOrigin)> {
        let oldest = &candidates[members[0]];
        for _ in 1..n_tracked {
            statistics.lost.count(LossReason::MergedIntoAnother);
        }
        let is_detected = members.len() > n_tracked
            || members[..n_tracked].iter().any(|member| candidates[*member].found != Found::FlowOnly);
        let track = &self.tracks[oldest.track_idx];
        let n_flow_only = if is_detected { 0 } else { track.n_flow_only + 1 };
        if n_flow_only > self.config.max_flow_only_frames {
            statistics.lost.count(LossReason::UndetectedTooLong);
            return None;
        }
        let (segment, extent, origin, descriptor) = if members.len() == 1 {
            (oldest.segment, oldest.extent, oldest.origin, oldest.descriptor)
        } else {
            let origin = if is_detected { LineOrigin::Merged } else { LineOrigin::Flowed };
            (*merged, self.extended(merged, &oldest.extent), origin, None)
        };
        match oldest.found {
            Found::ByFlow => statistics.n_by_flow += 1,
            Found::ByDescriptor => statistics.n_by_descriptor += 1,
            Found::FlowOnly if is_detected => statistics.n_by_merging += 1,
            Found::FlowOnly => statistics.n_flow_only += 1,
        }
        statistics.n_prediction_better +=
            usize::from(oldest.found == Found::ByFlow && origin == LineOrigin::Flowed);
        statistics.n_merged += usize::from(origin == LineOrigin::Merged);
        let (id, age) = (track.id, track.age.saturating_add(1));
        let descriptor = self.described(&segment, descriptor);
        Some((Track { id, age, n_flow_only, segment, extent, descriptor }, origin))
    }

    /// Begins lines, the longest first, while there is room.
    fn begin(
        &mut self,
        mut new: Vec<(Segment, LineOrigin, Option<Descriptor>)>,
        tracks: &mut Vec<(Track, LineOrigin)>,
        statistics: &mut LineTrackingStatistics,
    ) {
        new.retain(|(segment, ..)| segment.length() >= self.config.min_new_length_px);
        new.sort_by(|a, b| b.0.length().total_cmp(&a.0.length()));
        let room = self.config.max_lines.saturating_sub(tracks.len());
        statistics.n_new_beyond_limit = new.len().saturating_sub(room);
        new.truncate(room);
        for (segment, origin, known) in new {
            statistics.n_new += 1;
            statistics.n_merged += usize::from(origin == LineOrigin::Merged);
            let descriptor = self.described(&segment, known);
            let track =
                Track { id: self.next_track, age: 1, n_flow_only: 0, segment, extent: segment, descriptor };
            self.next_track += 1;
            tracks.push((track, origin));
        }
    }

    fn described(&mut self, segment: &Segment, known: Option<Descriptor>) -> Descriptor {
        known.unwrap_or_else(|| self.describer.describe_halved(self.next.halved(), segment))
    }

    /// A line as the caller sees it.
    fn report(&self, track: &Track, origin: LineOrigin) -> TrackedLine {
        let factor = if origin == LineOrigin::Flowed { self.config.flow_sigma_factor } else { 1.0 };
        TrackedLine {
            segment: Segment { sigma_px: track.segment.sigma_px * factor, ..track.segment },
            descriptor: track.descriptor,
            track: track.id,
            age: track.age,
            origin,
        }
    }
}

/// Where the prior puts a segment; where it was, if the prior has nothing to say.
fn expected_segment(segment: &Segment, prior: Option<&MotionPrior>) -> Segment {
    let Some(prior) = prior else { return *segment };
    let expected = Segment { start: prior(segment.start), end: prior(segment.end), ..*segment };
    if expected.is_finite() { expected } else { *segment }
}
