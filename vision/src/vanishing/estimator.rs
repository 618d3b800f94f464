//! Finding vanishing points and following them.

use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::candidates::{Candidate, Candidates};
use super::config::{VanishingConfig, VanishingConfigError};
use super::linkage::Linkage;
use super::plane::{SegmentPlane, unit};
use super::refine::{sin_between, with_fixed_sign};
use super::sampling::sample_pairs;

/// The common direction of some parallel lines of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct VanishingPoint {
    /// Unit vector in the camera frame. It equals its negative: the last component that is not zero is
    /// positive.
    pub direction: Vector3<f64>,
    /// Covariance of the direction, radians²: symmetric, of rank 2, zero along the direction. For any two
    /// tangents `B` (3 x 2), `B^T C B` is that of their coordinates.
    pub covariance: Matrix3<f64>,
    /// The segments that support it, ascending indices into the segments given. A segment supports one
    /// vanishing point at most.
    pub segments: Vec<u32>,
    /// The index of the known or predicted direction it comes from: the one nearest to it, within
    /// [`VanishingConfig::prediction_gate_deg`].
    pub prediction: Option<u32>,
    /// Logarithm to base 10 of how many vanishing points as good as this would be expected by chance: the
    /// lower, the more certain.
    pub log10_false_alarms: f64,
}

/// The vanishing points of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct VanishingPoints {
    /// By number of supporting segments, most first.
    pub points: Vec<VanishingPoint>,
    /// The share of the long segments ([`VanishingConfig::long_segment_deg`]) that support one of the points;
    /// 1 if there are none. When it falls under 0.6 after [`VanishingEstimator::refit`], there is something
    /// new to find with [`VanishingEstimator::cluster`], or nothing but clutter.
    pub explained: f64,
}

/// Finds vanishing points. Keeps buffers, but nothing that matters, from one call to the next: results depend
/// on the seed and the arguments alone.
#[derive(Clone, Debug)]
pub struct VanishingEstimator {
    config: VanishingConfig,
    seed: u64,
    /// Indices of the segments looked at, ascending.
    selected: Vec<u32>,
    /// Their planes.
    planes: Vec<SegmentPlane>,
    hypotheses: Vec<Vector3<f64>>,
    cumulative: Vec<f64>,
    linkage: Linkage,
}

impl VanishingEstimator {
    /// An estimator whose random choices follow from `seed`.
    pub fn new(config: VanishingConfig, seed: u64) -> Result<Self, VanishingConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            seed,
            selected: Vec::new(),
            planes: Vec::new(),
            hypotheses: Vec::new(),
            cumulative: Vec::new(),
            linkage: Linkage::default(),
        })
    }

    /// How it looks for them.
    pub fn config(&self) -> &VanishingConfig {
        &self.config
    }

    /// Finds the vanishing points of an image, by J-Linkage.
    ///
    /// `known` directions, in the camera frame, are tried besides those the segments propose, and need fewer
    /// segments to be believed: the last frame's vanishing points and the world's directions, turned by the
    /// predicted rotation. They keep the clusters stable over time. Of any length and sign; those that are
    /// zero or not finite are passed over.
    pub fn cluster(&mut self, segments: &[SegmentPlane], known: &[Vector3<f64>]) -> VanishingPoints {
        self.select(segments);
        let known = self.usable(known);
        self.hypotheses.clear();
        self.hypotheses.extend(known.iter().map(|(_, direction)| direction));
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let (planes, n_wanted) = (&self.planes, self.config.n_hypotheses);
        sample_pairs(planes, n_wanted, &mut rng, &mut self.cumulative, &mut self.hypotheses);

        let mut candidates = Candidates::new(&self.config, planes, &known);
        let min_size = self.config.min_segments_known;
        for cluster in self.linkage.link(planes, &self.hypotheses, candidates.gate2(), min_size) {
            candidates.push(Candidate::new(cluster.direction, cluster.members));
        }
        candidates.settle();
        self.report(segments, candidates.into_list(), &known)
    }

    /// Follows vanishing points from frame to frame: takes the segments near each of the `predicted`
    /// directions and fits to them. Finds nothing new, but takes a small part of the time.
    ///
    /// Directions as in [`cluster`](Self::cluster). Every point returned comes from one of them.
    pub fn refit(&mut self, segments: &[SegmentPlane], predicted: &[Vector3<f64>]) -> VanishingPoints {
        self.select(segments);
        let predicted = self.usable(predicted);
        let mut candidates = Candidates::new(&self.config, &self.planes, &predicted);
        for (_, direction) in &predicted {
            candidates.push(Candidate::new(*direction, Vec::new()));
        }
        candidates.assign_widely();
        candidates.settle();
        let mut found = self.report(segments, candidates.into_list(), &predicted);
        found.points.retain(|point| point.prediction.is_some());
        found.explained = self.share_explained(segments, &found.points);
        found
    }

    /// The longest segments, in the order given.
    fn select(&mut self, segments: &[SegmentPlane]) {
        self.selected.clear();
        self.selected.extend(0..segments.len() as u32);
        let limit = self.config.max_segments;
        if segments.len() > limit {
            self.selected.select_nth_unstable_by(limit, |&a, &b| {
                let (length_a, length_b) =
                    (segments[a as usize].length_rad(), segments[b as usize].length_rad());
                length_b.total_cmp(&length_a).then(a.cmp(&b))
            });
            self.selected.truncate(limit);
            self.selected.sort_unstable();
        }
        self.planes.clear();
        self.planes.extend(self.selected.iter().map(|&idx| segments[idx as usize]));
    }

    /// The known directions that are some, with their indices, as unit vectors. No more than hypotheses
    /// wanted.
    fn usable(&self, known: &[Vector3<f64>]) -> Vec<(u32, Vector3<f64>)> {
        let with_index = (0..).zip(known).filter_map(|(idx, direction)| Some((idx, unit(direction)?)));
        with_index.take(self.config.n_hypotheses).collect()
    }

    fn report(
        &self,
        segments: &[SegmentPlane],
        candidates: Vec<Candidate>,
        known: &[(u32, Vector3<f64>)],
    ) -> VanishingPoints {
        let point = |candidate: Candidate| {
            let fit = candidate.fit?;
            Some(VanishingPoint {
                direction: with_fixed_sign(&fit.direction),
                covariance: fit.covariance,
                segments: candidate.members.iter().map(|&member| self.selected[member as usize]).collect(),
                prediction: None,
                log10_false_alarms: candidate.log10_false_alarms,
            })
        };
        let mut points: Vec<_> = candidates.into_iter().filter_map(point).collect();
        self.match_to_known(&mut points, known);
        let explained = self.share_explained(segments, &points);
        VanishingPoints { points, explained }
    }

    /// Tells each point the known direction it comes from: one to one, the nearest pair first.
    fn match_to_known(&self, points: &mut [VanishingPoint], known: &[(u32, Vector3<f64>)]) {
        let gate = self.config.prediction_gate_deg.to_radians().sin();
        let mut pairs: Vec<(f64, usize, u32)> = Vec::new();
        for (point_idx, point) in points.iter().enumerate() {
            for (known_idx, direction) in known {
                let sin = sin_between(&point.direction, direction);
                if sin <= gate {
                    pairs.push((sin, point_idx, *known_idx));
                }
            }
        }
        pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        for (_, point_idx, known_idx) in pairs {
            let is_taken = points.iter().any(|point| point.prediction == Some(known_idx));
            let prediction = &mut points[point_idx].prediction;
            if prediction.is_none() && !is_taken {
                *prediction = Some(known_idx);
            }
        }
    }

    fn share_explained(&self, segments: &[SegmentPlane], points: &[VanishingPoint]) -> f64 {
        let limit = self.config.long_segment_deg.to_radians();
        let is_long = |&&idx: &&u32| segments[idx as usize].length_rad() >= limit;
        let n_long = self.selected.iter().filter(is_long).count();
        let n_explained = points.iter().flat_map(|point| &point.segments).filter(is_long).count();
        if n_long == 0 { 1.0 } else { n_explained as f64 / n_long as f64 }
    }
}
