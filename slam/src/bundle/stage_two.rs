//! The second stage of bundle adjustment: what global primitives say is added to what points and lines said.
//! [method: Second stage]

use super::adjustment::Adjustment;
use super::factors::{DirectionPriorFactor, StructuralConsistencyFactor, VanishingReprojectionFactor};
use super::primitive_terms::{PrimitiveTerms, VanishingSighting};
use super::scatter::segment_sigma_factor;
use crate::config::PrimitiveConfig;
use crate::landmarks::{DirectionEstimate, estimate_direction};
use crate::map::{GlobalPrimitive, KeyframeId, LineId, Map, PrimitiveId};
use geometry::nalgebra::{Matrix2, Matrix3};
use geometry::{Direction, OrthonormalLine, Pose};
use optim::{Kernel, SolverOptions, VariableId};
use std::collections::{BTreeMap, BTreeSet};

/// What came of the second stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum StageTwo {
    /// No primitive is in sight.
    #[default]
    NothingToAdd,
    /// The result includes the primitives.
    Added,
    /// The primitives would have turned the keyframe more than its own uncertainty allows: they were left
    /// out.
    Refused,
}

/// Standard deviation of a direction that nothing else holds, radians: keeps the system regular while the
/// primitives' terms are asleep, and says nothing beside them.
const ASLEEP_SIGMA_RAD: f64 = 1.0;
/// The second stage ends when an iteration lowers the cost by less than this share: a tenth of a standard
/// deviation in the usual window. It starts from a minimum, and two iterations all but reach the next.
const MIN_RELATIVE_DECREASE: f64 = 1e-4;

impl Adjustment {
    /// Enters the primitives that the free keyframes show, for [`add_primitives`](Self::add_primitives)
    /// later.
    pub fn expect_primitives(&mut self, map: &Map, config: &PrimitiveConfig) {
        let in_sight = self.primitives_in_sight(map);
        if !in_sight.is_empty() {
            let terms = self.primitive_terms(map, &in_sight, config);
            self.wake(&terms, false);
            self.primitives = Some(terms);
        }
    }

    /// Goes on from the present state with what the primitives say. If that turns `center` by more than its
    /// uncertainty allows, everything is put back, and `center` shows none of its primitives any more.
    pub fn add_primitives(
        &mut self,
        map: &mut Map,
        config: &PrimitiveConfig,
        center: KeyframeId,
    ) -> StageTwo {
        let Some(terms) = self.primitives.take() else { return StageTwo::NothingToAdd };
        let outcome = self.second_stage(&terms, config, center);
        self.primitives = Some(terms);
        if outcome == StageTwo::Refused {
            let shown: Vec<PrimitiveId> = map
                .keyframe(center)
                .into_iter()
                .flat_map(|keyframe| &keyframe.vanishing)
                .filter_map(|vanishing| vanishing.primitive)
                .collect();
            shown.into_iter().for_each(|primitive| map.remove_primitive_observation(primitive, center));
        }
        outcome
    }

    /// As [`add_primitives`](Self::add_primitives) where every keyframe is free to move: all is put back if
    /// points and lines object more than they would to a turn of every keyframe by as much as is allowed of
    /// one.
    pub fn add_primitives_everywhere(
        &mut self,
        config: &PrimitiveConfig,
        max_iterations: usize,
        aborted: impl Fn() -> bool,
    ) -> StageTwo {
        let Some(terms) = self.primitives.take() else { return StageTwo::NothingToAdd };
        let before = self.state();
        let options = SolverOptions { max_iterations, ..SolverOptions::default() };
        let rise = self.solve_with_primitives(&terms, &options, aborted);
        let is_refused = rise > self.free.len() as f64 * config.max_turn_sigmas.powi(2);
        if is_refused {
            self.restore(before);
            self.wake(&terms, false);
        }
        self.primitives = Some(terms);
        if is_refused { StageTwo::Refused } else { StageTwo::Added }
    }

    fn second_stage(
        &mut self,
        terms: &PrimitiveTerms,
        config: &PrimitiveConfig,
        center: KeyframeId,
    ) -> StageTwo {
        let before = self.state();
        let options = SolverOptions {
            max_iterations: config.stage_two_iterations,
            min_relative_decrease: MIN_RELATIVE_DECREASE,
            ..SolverOptions::default()
        };
        // Of all ways to turn a keyframe by n sigmas, the one that suits points and lines best raises their
        // χ² by n²: a smaller rise needs no covariance to be let pass.
        let rise = self.solve_with_primitives(terms, &options, || false);
        if rise <= config.max_turn_sigmas.powi(2) {
            return StageTwo::Added;
        }
        let (after, turned) = (self.state(), self.pose(center));
        self.restore(before);
        self.wake(terms, false);
        let n_sigmas = turned.and_then(|turned| self.sigmas_of_turn(center, &turned));
        if n_sigmas.is_some_and(|n_sigmas| n_sigmas > config.max_turn_sigmas) {
            return StageTwo::Refused;
        }
        self.restore(after);
        StageTwo::Added
    }

    /// Returns by how much that raises the χ² of points and lines.
    fn solve_with_primitives(
        &mut self,
        terms: &PrimitiveTerms,
        options: &SolverOptions,
        aborted: impl Fn() -> bool,
    ) -> f64 {
        let cost_before = self.cost_of_sightings();
        self.wake(terms, true);
        self.problem.solve(options, aborted);
        2.0 * (self.cost_of_sightings() - cost_before)
    }

    fn wake(&mut self, terms: &PrimitiveTerms, awake: bool) {
        self.problem.set_group_enabled(terms.priors, awake);
        self.problem.set_group_enabled(terms.observations, awake);
        self.problem.set_group_enabled(terms.parallels, awake);
    }

    /// By how many standard deviations of its attitude at the present state another pose of a keyframe is
    /// turned.
    fn sigmas_of_turn(&mut self, id: KeyframeId, turned: &Pose) -> Option<f64> {
        let (pose, covariance) = self.attitude(id)?;
        let turn = (turned.rotation * pose.rotation.inverse()).scaled_axis();
        Some(turn.dot(&(covariance.try_inverse()? * turn)).max(0.0).sqrt())
    }

    /// Pose and covariance of the attitude of a free keyframe at the present state.
    fn attitude(&mut self, id: KeyframeId) -> Option<(Pose, Matrix3<f64>)> {
        let pose = self.pose(id)?;
        let variable = self.free.contains(&id).then(|| self.poses.get(&id).copied())??;
        let covariance = self.problem.marginal_covariance(variable)?;
        Some((pose, Matrix3::from_fn(|row, column| covariance[(row, column)])))
    }

    fn primitives_in_sight(&self, map: &Map) -> Vec<PrimitiveId> {
        let shown: BTreeSet<PrimitiveId> = self
            .free
            .iter()
            .filter_map(|id| map.keyframe(*id))
            .flat_map(|keyframe| keyframe.vanishing.iter().filter_map(|vanishing| vanishing.primitive))
            .collect();
        shown.into_iter().collect()
    }

    fn primitive_terms(
        &mut self,
        map: &Map,
        in_sight: &[PrimitiveId],
        config: &PrimitiveConfig,
    ) -> PrimitiveTerms {
        let (mut asleep, mut priors, mut observations) = (Vec::new(), Vec::new(), Vec::new());
        let mut variables: BTreeMap<PrimitiveId, VariableId<Direction>> = BTreeMap::new();
        for primitive in in_sight.iter().filter_map(|id| map.primitive(*id)) {
            let variable = self.problem.add_variable(primitive.direction);
            variables.insert(primitive.id, variable);
            let square_root_information = Matrix2::identity() / ASLEEP_SIGMA_RAD;
            let known = primitive.direction;
            asleep.push(((variable,), DirectionPriorFactor { known, square_root_information }));
            priors.extend(self.outside_prior(map, primitive).map(|prior| ((variable,), prior)));
            self.collect_sightings(map, primitive, variable, config, &mut observations);
        }
        let inverse_sigma = 1.0 / config.line_sigma_deg.to_radians();
        let parallel = |id: &LineId, line: &VariableId<OrthonormalLine>| {
            let primitive = variables.get(&map.line(*id)?.primitive?)?;
            Some(((*primitive, *line), StructuralConsistencyFactor { inverse_sigma }))
        };
        let parallels: Vec<_> = self.lines.iter().filter_map(|(id, _, line)| parallel(id, line)).collect();
        self.problem.add_factors(Kernel::None, asleep);
        PrimitiveTerms {
            variables: variables.into_iter().collect(),
            priors: self.problem.add_factors(Kernel::None, priors),
            // Wrong associations would tie places together that have nothing to do with one another.
            observations: self.problem.add_factors(Kernel::cauchy_95(), observations),
            parallels: self.problem.add_factors(Kernel::cauchy_95(), parallels),
        }
    }

    /// What keyframes outside the problem say of a primitive. Those that hold the window in place are not
    /// among them: points and lines take their attitudes for exact, and a primitive that trusted them less
    /// would bend the window.
    fn outside_prior(&self, map: &Map, primitive: &GlobalPrimitive) -> Option<DirectionPriorFactor> {
        let outside = primitive.observations.iter().filter(|seen| !self.poses.contains_key(&seen.keyframe));
        let DirectionEstimate { direction, information } = estimate_direction(map, outside.copied())?;
        let square_root_information = information.cholesky()?.l().transpose();
        Some(DirectionPriorFactor { known: direction, square_root_information })
    }

    fn collect_sightings(
        &self,
        map: &Map,
        primitive: &GlobalPrimitive,
        variable: VariableId<Direction>,
        config: &PrimitiveConfig,
        observations: &mut Vec<VanishingSighting>,
    ) {
        let sigma_factor = segment_sigma_factor(map, primitive, config);
        for seen in &primitive.observations {
            let (Some(pose), Some(keyframe)) = (self.poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
            else {
                continue;
            };
            let Some(vanishing) = keyframe.vanishing.get(seen.vanishing_idx as usize) else { continue };
            for segment in vanishing.segments.iter().map(|idx| &keyframe.features.lines[*idx as usize]) {
                let pinhole = keyframe.features.pinhole;
                let factor = VanishingReprojectionFactor::of(pinhole, segment, sigma_factor);
                observations.push(((*pose, variable), factor));
            }
        }
    }
}
