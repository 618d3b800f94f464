//! The terms with which global primitives enter a bundle adjustment.

use super::factors::{DirectionPriorFactor, StructuralConsistencyFactor, VanishingReprojectionFactor};
use crate::map::PrimitiveId;
use geometry::{Direction, Pose};
use optim::{GroupId, VariableId};

/// A segment's factor with its variables.
pub(super) type VanishingSighting = ((VariableId<Pose>, VariableId<Direction>), VanishingReprojectionFactor);

/// What primitives say. It is in the problem from the start, so that the problem's structure is laid out
/// once, but left out until the second stage.
pub(super) struct PrimitiveTerms {
    pub variables: Vec<(PrimitiveId, VariableId<Direction>)>,
    pub priors: GroupId<DirectionPriorFactor>,
    pub observations: GroupId<VanishingReprojectionFactor>,
    pub parallels: GroupId<StructuralConsistencyFactor>,
}
