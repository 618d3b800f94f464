//! Directions competing for segments: giving, fitting, merging, and throwing out what may be chance.

use nalgebra::Vector3;

use super::config::VanishingConfig;
use super::plane::SegmentPlane;
use super::refine::{Fit, fit, may_be_same, sin_between};
use super::significance::probability_of_at_least;

/// Candidates whose directions differ by no more than this many standard deviations may be one, however far
/// they are apart: the lines of one strip of the image hardly tell where along it they meet.
const MERGE_SIGMAS: f64 = 3.0;
/// The part of both candidates' segments that must accept their common direction for them to be one.
const MERGE_SHARE: f64 = 0.8;
/// A segment that supports no candidate.
const NOBODY: usize = usize::MAX;

/// A direction and the segments that support it.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    direction: Vector3<f64>,
    /// Positions in the segments looked at, ascending.
    pub members: Vec<u32>,
    /// The direction fitted to the members. None before the first fit, and then if that failed.
    pub fit: Option<Fit>,
    /// See [`VanishingConfig::max_log10_false_alarms`].
    pub log10_false_alarms: f64,
}

impl Candidate {
    pub fn new(direction: Vector3<f64>, members: Vec<u32>) -> Self {
        Self { direction, members, fit: None, log10_false_alarms: 0.0 }
    }
}

/// All candidates of an image.
pub(super) struct Candidates<'a> {
    config: &'a VanishingConfig,
    planes: &'a [SegmentPlane],
    known: &'a [(u32, Vector3<f64>)],
    list: Vec<Candidate>,
    /// For each segment, the candidate it supports.
    assignment: Vec<usize>,
}

impl<'a> Candidates<'a> {
    pub fn new(
        config: &'a VanishingConfig,
        planes: &'a [SegmentPlane],
        known: &'a [(u32, Vector3<f64>)],
    ) -> Self {
        Self { config, planes, known, list: Vec::new(), assignment: vec![NOBODY; planes.len()] }
    }

    pub fn push(&mut self, candidate: Candidate) {
        self.list.push(candidate);
    }

    pub fn into_list(self) -> Vec<Candidate> {
        self.list
    }

    /// The square of the number of standard deviations of the residual a segment may be off.
    ///
    /// The endpoints deviate from the line through the middle by half the difference of their noise, which
    /// has `1 / sqrt 2` of their standard deviation.
    pub fn gate2(&self) -> f64 {
        2.0 * self.config.max_deviation * self.config.max_deviation
    }

    /// Fits and assigns in turn until settled, then drops what may be chance. By number of members at the
    /// end.
    pub fn settle(&mut self) {
        self.fit_and_merge();
        for _ in 0..self.config.n_rounds {
            self.assign();
            self.fit_and_merge();
        }
        // What goes leaves its segments to others, which become more certain by it and cannot drop out.
        self.drop_insignificant();
        self.assign();
        self.fit_and_merge();
        self.drop_insignificant();
    }

    /// Gives each segment to the candidate it deviates from least, measured by its noise; the first of
    /// several.
    fn assign(&mut self) {
        let gate2 = self.gate2();
        for (plane, assigned) in self.planes.iter().zip(&mut self.assignment) {
            let mut least = f64::INFINITY;
            *assigned = NOBODY;
            for (idx, candidate) in self.list.iter().enumerate() {
                let direction = &candidate.direction;
                if plane.excess(direction, gate2) > 0.0 {
                    continue;
                }
                let deviation2 = plane.residual(direction).powi(2) / plane.variance(direction);
                if deviation2 < least {
                    (least, *assigned) = (deviation2, idx);
                }
            }
        }
        self.gather();
    }

    /// As [`assign`](Self::assign), when directions may be wrong by the gate of predictions: by angle.
    pub fn assign_widely(&mut self) {
        let (n_sigma, sin_gate) = (self.gate2().sqrt(), self.config.prediction_gate_deg.to_radians().sin());
        for (plane, assigned) in self.planes.iter().zip(&mut self.assignment) {
            let mut least = f64::INFINITY;
            *assigned = NOBODY;
            for (idx, candidate) in self.list.iter().enumerate() {
                let residual = plane.residual(&candidate.direction).abs();
                let limit = sin_gate + n_sigma * plane.variance(&candidate.direction).sqrt();
                if residual <= limit && residual < least {
                    (least, *assigned) = (residual, idx);
                }
            }
        }
        self.gather();
    }

    fn gather(&mut self) {
        for candidate in &mut self.list {
            candidate.members.clear();
        }
        for (segment, &assigned) in (0..).zip(&self.assignment) {
            if let Some(candidate) = self.list.get_mut(assigned) {
                candidate.members.push(segment);
            }
        }
    }

    /// Fits each candidate to its members, drops those that are too few or leave it undetermined, and merges
    /// those that are one. Leaves them by number of members.
    fn fit_and_merge(&mut self) {
        let planes = self.planes;
        for candidate in &mut self.list {
            candidate.fit = fit(members_of(planes, &candidate.members), &candidate.direction);
            if let Some(fit) = &candidate.fit {
                candidate.direction = fit.direction;
            }
        }
        let max_sigma = self.config.max_sigma_deg.to_radians();
        let mut list = std::mem::take(&mut self.list);
        list.retain(|candidate| {
            candidate.members.len() >= self.min_segments(&candidate.direction)
                && candidate.fit.is_some_and(|fit| fit.worst_sigma() <= max_sigma)
        });
        list.sort_by_key(|candidate| std::cmp::Reverse(candidate.members.len()));
        for candidate in list {
            let into = self
                .list
                .iter()
                .enumerate()
                .find_map(|(idx, larger)| Some((idx, self.merged(larger, &candidate)?)));
            match into {
                Some((idx, merged)) => self.list[idx] = merged,
                None => self.list.push(candidate),
            }
        }
    }

    /// Both in one, if they are.
    fn merged(&self, larger: &Candidate, smaller: &Candidate) -> Option<Candidate> {
        let (larger_fit, smaller_fit) = (larger.fit?, smaller.fit?);
        let is_near =
            sin_between(&larger.direction, &smaller.direction) < self.config.merge_deg.to_radians().sin();
        if !is_near && !may_be_same(&larger_fit, &smaller_fit, MERGE_SIGMAS) {
            return None;
        }
        let mut members: Vec<u32> = larger.members.iter().chain(&smaller.members).copied().collect();
        members.sort_unstable();
        let Some(common) = fit(members_of(self.planes, &members), &larger.direction) else {
            return is_near.then(|| larger.clone());
        };
        let gate2 = self.gate2();
        let n_accepting = members_of(self.planes, &members)
            .filter(|plane| plane.excess(&common.direction, gate2) <= 0.0)
            .count();
        let holds = n_accepting as f64 >= MERGE_SHARE * members.len() as f64;
        let merged = || Candidate {
            direction: common.direction,
            members,
            fit: Some(common),
            log10_false_alarms: larger.log10_false_alarms,
        };
        if holds { Some(merged()) } else { is_near.then(|| larger.clone()) }
    }

    fn is_known(&self, direction: &Vector3<f64>) -> bool {
        let gate = self.config.prediction_gate_deg.to_radians().sin();
        self.known.iter().any(|(_, known)| sin_between(known, direction) <= gate)
    }

    fn min_segments(&self, direction: &Vector3<f64>) -> usize {
        if self.is_known(direction) { self.config.min_segments_known } else { self.config.min_segments }
    }

    /// Drops candidates that as many segments without any order could show. In order of size, each being
    /// tried on the segments that the larger ones do not explain.
    fn drop_insignificant(&mut self) {
        let mut explained = vec![false; self.planes.len()];
        let mut list = std::mem::take(&mut self.list);
        let mut buffer = Vec::new();
        list.retain_mut(|candidate| {
            candidate.log10_false_alarms = self.log10_false_alarms(candidate, &explained, &mut buffer);
            let is_significant = candidate.log10_false_alarms < self.config.max_log10_false_alarms;
            if is_significant {
                for &member in &candidate.members {
                    explained[member as usize] = true;
                }
            }
            is_significant
        });
        self.list = list;
    }

    /// A plane turned at random meets a direction to within the sine `s` with probability `s`. Two segments
    /// make a direction, any others accept it by chance; there are as many directions as pairs, or where it
    /// is known beforehand, as pairs that make one near it.
    fn log10_false_alarms(&self, candidate: &Candidate, explained: &[bool], buffer: &mut Vec<f64>) -> f64 {
        let n_sigma = self.gate2().sqrt();
        let free = || self.planes.iter().zip(explained).filter(|(_, explained)| !**explained);
        let n_free = free().count() as f64;
        let probability = probability_of_at_least(
            candidate.members.len().saturating_sub(2),
            free().map(|(plane, _)| (n_sigma * plane.variance(&candidate.direction).sqrt()).min(1.0)),
            buffer,
        );
        let n_pairs = n_free * (n_free - 1.0) / 2.0;
        let n_tests = if self.is_known(&candidate.direction) {
            let share_near_one = 1.0 - self.config.prediction_gate_deg.to_radians().cos();
            (n_pairs * share_near_one * self.known.len() as f64).clamp(1.0, n_pairs.max(1.0))
        } else {
            n_pairs.max(1.0)
        };
        // Certainty beyond what a number can hold is certainty enough.
        n_tests.log10() + probability.max(f64::MIN_POSITIVE).log10()
    }
}

fn members_of<'a>(
    planes: &'a [SegmentPlane],
    members: &'a [u32],
) -> impl Iterator<Item = &'a SegmentPlane> + Clone {
    members.iter().map(|&member| &planes[member as usize])
}
