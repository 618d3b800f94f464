//! The optimization problem of a part of the map, with the names of its variables.

use super::anchored_line::AnchoredLine;
use super::factors::{LineReprojectionFactor, PointReprojectionFactor};
use super::primitive_terms::PrimitiveTerms;
use crate::landmarks::{TrackView, directed, seen_part};
use crate::map::{KeyframeId, LineId, LinePlace, Map, Observation, PointId, PrimitiveId};
use geometry::nalgebra::Vector3;
use geometry::{Direction, Line3, OrthonormalLine, Pose};
use optim::{GroupId, Kernel, Manifold, Problem, SolverOptions, VariableId, chi2_95};
use std::collections::{BTreeMap, BTreeSet};

/// Which keyframes and landmarks move, and which keyframes hold them in place.
pub(crate) struct Scope {
    pub free: BTreeSet<KeyframeId>,
    pub fixed: BTreeSet<KeyframeId>,
    pub points: BTreeSet<PointId>,
    pub lines: BTreeSet<LineId>,
}

/// Poses, points and lines of a scope with every sighting among them as a factor.
pub(crate) struct Adjustment {
    pub(super) problem: Problem,
    pub(super) poses: BTreeMap<KeyframeId, VariableId<Pose>>,
    pub(super) free: BTreeSet<KeyframeId>,
    points: Vec<(PointId, VariableId<Vector3<f64>>)>,
    point_group: GroupId<PointReprojectionFactor>,
    /// Which sighting each factor stands for.
    point_sightings: Vec<(PointId, KeyframeId)>,
    pub(super) lines: Vec<(LineId, AnchoredLine, VariableId<OrthonormalLine>)>,
    line_group: GroupId<LineReprojectionFactor>,
    line_sightings: Vec<(LineId, KeyframeId)>,
    /// What primitives say; absent in the first stage alone.
    pub(super) primitives: Option<PrimitiveTerms>,
}

/// The values of all variables at some moment.
pub(super) struct State {
    poses: Vec<(VariableId<Pose>, Pose)>,
    points: Vec<(VariableId<Vector3<f64>>, Vector3<f64>)>,
    lines: Vec<(VariableId<OrthonormalLine>, OrthonormalLine)>,
    primitives: Vec<(VariableId<Direction>, Direction)>,
}

impl Adjustment {
    pub fn of(map: &Map, scope: &Scope) -> Self {
        let mut problem = Problem::new();
        let mut poses = BTreeMap::new();
        for id in scope.free.iter().chain(&scope.fixed) {
            let Some(keyframe) = map.keyframe(*id) else { continue };
            let variable = problem.add_variable(keyframe.camera_from_world);
            problem.set_fixed(variable, scope.fixed.contains(id));
            poses.insert(*id, variable);
        }
        let (mut points, mut point_factors, mut point_sightings) = (Vec::new(), Vec::new(), Vec::new());
        for point in scope.points.iter().filter_map(|id| map.point(*id)) {
            let variable = problem.add_landmark(point.position);
            points.push((point.id, variable));
            for seen in &point.observations {
                let Some((pose, factor)) = point_factor(map, &poses, seen) else { continue };
                point_factors.push(((pose, variable), factor));
                point_sightings.push((point.id, seen.keyframe));
            }
        }
        let (mut lines, mut line_factors, mut line_sightings) = (Vec::new(), Vec::new(), Vec::new());
        for line in scope.lines.iter().filter_map(|id| map.line(*id)) {
            let Some(anchored) = AnchoredLine::of(line) else { continue };
            let variable = problem.add_landmark(anchored.line);
            lines.push((line.id, anchored, variable));
            for seen in &line.observations {
                let (Some(pose), Some(keyframe)) = (poses.get(&seen.keyframe), map.keyframe(seen.keyframe))
                else {
                    continue;
                };
                let segment = &keyframe.features.lines[seen.feature_idx as usize];
                line_factors.push(((*pose, variable), anchored.factor(keyframe.features.pinhole, segment)));
                line_sightings.push((line.id, seen.keyframe));
            }
        }
        let point_group = problem.add_factors(Kernel::huber_95(2), point_factors);
        // Wrong associations of lines are frequent and must not pull for ever.
        let line_group = problem.add_factors(Kernel::cauchy_95(), line_factors);
        let free = scope.free.clone();
        Self {
            problem,
            poses,
            free,
            points,
            point_group,
            point_sightings,
            lines,
            line_group,
            line_sightings,
            primitives: None,
        }
    }

    /// Iterates until it converges, `max_iterations` are done, or `aborted` says so.
    pub fn solve(&mut self, max_iterations: usize, aborted: impl Fn() -> bool) {
        self.problem.solve(&SolverOptions { max_iterations, ..SolverOptions::default() }, aborted);
    }

    /// The robust cost of the sightings of points and lines at the present state.
    pub(super) fn cost_of_sightings(&self) -> f64 {
        self.problem.cost_of(self.point_group).robust + self.problem.cost_of(self.line_group).robust
    }

    /// Half the squared errors of all sightings of points and lines at the present state, those that were
    /// left out as well; each counts no more than one that just agrees, so that what is wrong anyway does not
    /// tell.
    pub(super) fn cost_of_all_sightings(&self) -> f64 {
        let capped = |chi2: Option<f64>| 0.5 * chi2.map_or(chi2_95(2), |chi2| chi2.min(chi2_95(2)));
        let points = 0..self.point_sightings.len();
        let lines = 0..self.line_sightings.len();
        points.map(|idx| capped(self.problem.chi2(self.point_group, idx))).sum::<f64>()
            + lines.map(|idx| capped(self.problem.chi2(self.line_group, idx))).sum::<f64>()
    }

    /// The present pose of a keyframe of the scope.
    pub(super) fn pose(&self, id: KeyframeId) -> Option<Pose> {
        self.poses.get(&id).map(|variable| *self.problem.value(*variable))
    }

    /// Keeps the present values, to go back to them.
    pub(super) fn state(&self) -> State {
        let primitives = self.primitives.iter().flat_map(|terms| &terms.variables);
        State {
            poses: self.poses.values().map(|variable| self.with_value(*variable)).collect(),
            points: self.points.iter().map(|(_, variable)| self.with_value(*variable)).collect(),
            lines: self.lines.iter().map(|(_, _, variable)| self.with_value(*variable)).collect(),
            primitives: primitives.map(|(_, variable)| self.with_value(*variable)).collect(),
        }
    }

    fn with_value<T: Manifold>(&self, variable: VariableId<T>) -> (VariableId<T>, T) {
        (variable, self.problem.value(variable).clone())
    }

    /// Goes back to kept values.
    pub(super) fn restore(&mut self, state: State) {
        state.poses.into_iter().for_each(|(variable, value)| self.problem.set_value(variable, value));
        state.points.into_iter().for_each(|(variable, value)| self.problem.set_value(variable, value));
        state.lines.into_iter().for_each(|(variable, value)| self.problem.set_value(variable, value));
        state.primitives.into_iter().for_each(|(variable, value)| self.problem.set_value(variable, value));
    }

    /// Leaves sightings out of what follows that disagree at present, and takes others in again.
    pub fn judge_sightings(&mut self) {
        self.problem.enable_inliers(self.point_group, chi2_95(2));
        self.problem.enable_inliers(self.line_group, chi2_95(2));
    }

    /// What came of it. Observations that disagree with it are named.
    pub fn result(&self) -> Adjusted {
        let value = |id: &KeyframeId| Some((*id, self.pose(*id)?));
        let disagrees = |chi2: Option<f64>| chi2.is_none_or(|chi2| chi2 > chi2_95(2));
        let in_world = |(id, anchored, variable): &(LineId, AnchoredLine, VariableId<OrthonormalLine>)| {
            (*id, anchored.line_in_world(self.problem.value(*variable)))
        };
        let point_outliers = self.point_sightings.iter().enumerate();
        let line_outliers = self.line_sightings.iter().enumerate();
        let directions = self.primitives.iter().flat_map(|terms| &terms.variables);
        Adjusted {
            poses: self.free.iter().filter_map(value).collect(),
            points: self.points.iter().map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
            point_outliers: point_outliers
                .filter(|(factor_idx, _)| disagrees(self.problem.chi2(self.point_group, *factor_idx)))
                .map(|(_, sighting)| *sighting)
                .collect(),
            lines: self.lines.iter().map(in_world).collect(),
            line_outliers: line_outliers
                .filter(|(factor_idx, _)| disagrees(self.problem.chi2(self.line_group, *factor_idx)))
                .map(|(_, sighting)| *sighting)
                .collect(),
            directions: directions.map(|(id, variable)| (*id, *self.problem.value(*variable))).collect(),
        }
    }
}

/// What bundle adjustment found.
#[derive(Clone, Debug, Default)]
pub(crate) struct Adjusted {
    /// `camera_from_world` of the keyframes that were free to move.
    pub poses: BTreeMap<KeyframeId, Pose>,
    points: Vec<(PointId, Vector3<f64>)>,
    point_outliers: Vec<(PointId, KeyframeId)>,
    /// `None` for one that went to infinity.
    lines: Vec<(LineId, Option<Line3>)>,
    line_outliers: Vec<(LineId, KeyframeId)>,
    directions: Vec<(PrimitiveId, Direction)>,
}

impl Adjusted {
    /// Puts the result into the map; sightings that disagree with it are removed. What is no longer in the
    /// map is passed over.
    pub fn write_into(&self, map: &mut Map) {
        for (id, pose) in &self.poses {
            map.set_pose(*id, *pose);
        }
        for (id, position) in &self.points {
            map.set_position(*id, *position);
        }
        for (point, keyframe) in &self.point_outliers {
            map.remove_observation(*point, *keyframe);
        }
        for (id, _) in &self.points {
            map.refresh_point_geometry(*id);
        }
        for (line, keyframe) in &self.line_outliers {
            map.remove_line_observation(*line, *keyframe);
        }
        for (id, line) in &self.lines {
            write_line(map, *id, *line);
        }
        for (id, direction) in &self.directions {
            if let Some(covariance) = map.primitive(*id).map(|primitive| primitive.covariance) {
                map.set_primitive_direction(*id, *direction, covariance);
            }
        }
    }
}

fn point_factor(
    map: &Map,
    poses: &BTreeMap<KeyframeId, VariableId<Pose>>,
    seen: &Observation,
) -> Option<(VariableId<Pose>, PointReprojectionFactor)> {
    let (pose, keyframe) = (poses.get(&seen.keyframe)?, map.keyframe(seen.keyframe)?);
    let feature_idx = seen.feature_idx as usize;
    let factor = PointReprojectionFactor {
        pinhole: keyframe.features.pinhole,
        observed_px: keyframe.features.undistorted[feature_idx],
        inverse_sigma: 1.0 / keyframe.features.sigma_px(feature_idx),
    };
    Some((*pose, factor))
}

/// Moves a line and finds its ends again; one that no longer is where its segments are goes.
fn write_line(map: &mut Map, id: LineId, moved: Option<Line3>) {
    let Some(line) = map.line(id) else { return };
    let views: Vec<TrackView> =
        line.observations.iter().filter_map(|seen| TrackView::of(map, *seen)).collect();
    let place = moved.and_then(|line| {
        let endpoints = seen_part(&line, &views)?;
        Some(LinePlace { line: directed(&line, &endpoints)?, endpoints })
    });
    match place {
        Some(place) => map.set_line_place(id, &place),
        None => map.remove_line(id),
    }
}
