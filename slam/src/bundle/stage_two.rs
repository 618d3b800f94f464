//! The second stage of bundle adjustment: what global primitives say is added to what points and lines said.
//! [paper, "Robust Factor Graph Optimization"; ALGORITHMS 6, 8.3]

use super::adjustment::Adjustment;
use super::factors::{DirectionPriorFactor, StructuralConsistencyFactor, VanishingReprojectionFactor};
use crate::config::PrimitiveConfig;
use crate::map::{GlobalPrimitive, KeyframeId, Map, PrimitiveId};
use crate::mapping::primitives::{DirectionEstimate, estimate_direction};
use geometry::nalgebra::Matrix3;
use geometry::{Direction, OrthonormalLine, Pose};
use optim::{Kernel, VariableId};
use std::collections::{BTreeMap, BTreeSet};

/// What came of the second stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum StageTwo {
    /// No primitive is in sight.
    #[default]
    NothingToAdd,
    /// The result includes the primitives.
    Added,
    /// The primitives would have turned the key frame more than its own uncertainty allows: they were left out.
    Refused,
}

/// A segment's factor with its variables.
type VanishingSighting = ((VariableId<Pose>, VariableId<Direction>), VanishingReprojectionFactor);

/// A primitive as a variable of the problem.
pub(super) struct PrimitiveVariable {
    pub id: PrimitiveId,
    pub variable: VariableId<Direction>,
}

impl Adjustment {
    /// Goes on from the present state with the primitives that the free key frames show. If that turns `centre` by
    /// more than its uncertainty allows, everything is put back, and `centre` shows none of its primitives any more.
    pub fn add_primitives(
        &mut self,
        map: &mut Map,
        config: &PrimitiveConfig,
        centre: KeyframeId,
    ) -> StageTwo {
        let in_sight = self.primitives_in_sight(map);
        if in_sight.is_empty() {
            return StageTwo::NothingToAdd;
        }
        let before = self.attitude(centre);
        let state = self.state();
        self.add_primitive_factors(map, &in_sight, config);
        self.solve(config.stage_two_iterations, || false);
        let Some((pose, covariance)) = before else { return StageTwo::Added };
        let Some(after) = self.pose(centre) else { return StageTwo::Added };
        let turn = (after.rotation * pose.rotation.inverse()).scaled_axis();
        let n_sigmas = covariance
            .try_inverse()
            .map_or(0.0, |information| turn.dot(&(information * turn)).max(0.0).sqrt());
        if n_sigmas <= config.max_turn_sigmas {
            return StageTwo::Added;
        }
        self.restore(state);
        let shown: Vec<PrimitiveId> = map
            .keyframe(centre)
            .into_iter()
            .flat_map(|keyframe| &keyframe.vanishing)
            .filter_map(|vanishing| vanishing.primitive)
            .collect();
        shown.into_iter().for_each(|primitive| map.remove_primitive_observation(primitive, centre));
        StageTwo::Refused
    }

    /// Pose and covariance of the attitude of a free key frame at the present state.
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

    fn add_primitive_factors(&mut self, map: &Map, in_sight: &[PrimitiveId], config: &PrimitiveConfig) {
        let (mut priors, mut sightings) = (Vec::new(), Vec::new());
        let mut variables: BTreeMap<PrimitiveId, VariableId<Direction>> = BTreeMap::new();
        for primitive in in_sight.iter().filter_map(|id| map.primitive(*id)) {
            let variable = self.problem.add_variable(primitive.direction);
            variables.insert(primitive.id, variable);
            self.primitives.push(PrimitiveVariable { id: primitive.id, variable });
            priors.extend(self.outside_prior(map, primitive).map(|prior| ((variable,), prior)));
            self.collect_sightings(map, primitive, variable, config, &mut sightings);
        }
        let line_factors: Vec<_> = self
            .lines
            .iter()
            .filter_map(|(id, _, line)| {
                let primitive = variables.get(&map.line(*id)?.primitive?)?;
                let inverse_sigma = 1.0 / config.line_sigma_deg.to_radians();
                Some(((*primitive, *line), StructuralConsistencyFactor { inverse_sigma }))
            })
            .collect::<Vec<((VariableId<Direction>, VariableId<OrthonormalLine>), _)>>();
        self.problem.add_factors(Kernel::None, priors);
        // Wrong associations would tie places together that have nothing to do with one another.
        self.problem.add_factors(Kernel::cauchy_95(), sightings);
        self.problem.add_factors(Kernel::cauchy_95(), line_factors);
    }

    /// What key frames outside the problem say of a primitive.
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
        sightings: &mut Vec<VanishingSighting>,
    ) {
        for seen in &primitive.observations {
            let (Some(pose), Some(keyframe)) = (self.poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
            else {
                continue;
            };
            let Some(vanishing) = keyframe.vanishing.get(seen.vanishing_idx as usize) else { continue };
            for segment in vanishing.segments.iter().map(|idx| &keyframe.features.lines[*idx as usize]) {
                let factor = VanishingReprojectionFactor {
                    pinhole: keyframe.features.pinhole,
                    start_px: segment.start,
                    end_px: segment.end,
                    inverse_sigma: 1.0 / (segment.sigma_px * config.segment_sigma_factor),
                };
                sightings.push(((*pose, variable), factor));
            }
        }
    }
}
