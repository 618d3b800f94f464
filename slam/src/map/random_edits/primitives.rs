//! Edits of global primitives and of the vanishing points that show them.

use super::*;
use geometry::Direction;
use geometry::nalgebra::Matrix3;

#[derive(Clone, Debug)]
pub(super) enum PrimitiveEdit {
    SetVanishing { keyframe: Index, directions: Vec<Vector3<f64>> },
    Add { created_by: Index, direction: Vector3<f64>, variance: f64 },
    Observe(Index, Index, u32),
    Unobserve(Index, Index),
    Remove(Index),
    Fuse(Index, Index),
    Turn(Index, Vector3<f64>, f64),
}

pub(super) fn edits() -> impl Strategy<Value = PrimitiveEdit> {
    prop_oneof![
        3 => (index(), vec(vector(), 0..4))
            .prop_map(|(keyframe, directions)| PrimitiveEdit::SetVanishing { keyframe, directions }),
        3 => (index(), vector(), number()).prop_map(|(created_by, direction, variance)| {
            PrimitiveEdit::Add { created_by, direction, variance }
        }),
        4 => (index(), index(), 0..4_u32)
            .prop_map(|(primitive, keyframe, idx)| PrimitiveEdit::Observe(primitive, keyframe, idx)),
        1 => (index(), index())
            .prop_map(|(primitive, keyframe)| PrimitiveEdit::Unobserve(primitive, keyframe)),
        1 => index().prop_map(PrimitiveEdit::Remove),
        1 => (index(), index()).prop_map(|(surviving, absorbed)| PrimitiveEdit::Fuse(surviving, absorbed)),
        1 => (index(), vector(), number())
            .prop_map(|(primitive, direction, variance)| PrimitiveEdit::Turn(primitive, direction, variance)),
    ]
}

impl PrimitiveEdit {
    pub(super) fn apply(&self, map: &mut Map) {
        match self {
            Self::SetVanishing { keyframe, directions } => {
                let vanishing = directions.iter().filter_map(vanishing).collect();
                map.set_vanishing(keyframe_id(map, *keyframe), vanishing);
            }
            Self::Add { created_by, direction, variance } => {
                let created_by = keyframe_id(map, *created_by);
                let submap = map.keyframe(created_by).map_or(SubmapId(0), |keyframe| keyframe.submap);
                if let Some(direction) = Direction::new(*direction) {
                    map.add_primitive(
                        submap,
                        direction,
                        Matrix3::from_diagonal_element(*variance),
                        created_by,
                    );
                }
            }
            Self::Observe(primitive, keyframe, vanishing_idx) => {
                let (primitive, keyframe) = (primitive_id(map, *primitive), keyframe_id(map, *keyframe));
                let is_apart = map
                    .primitive(primitive)
                    .zip(map.keyframe(keyframe))
                    .is_some_and(|(primitive, keyframe)| primitive.submap != keyframe.submap);
                if !is_apart {
                    let seen = PrimitiveObservation { keyframe, vanishing_idx: *vanishing_idx };
                    map.add_primitive_observation(primitive, seen);
                }
            }
            Self::Unobserve(primitive, keyframe) => {
                map.remove_primitive_observation(primitive_id(map, *primitive), keyframe_id(map, *keyframe));
            }
            Self::Remove(primitive) => map.remove_primitive(primitive_id(map, *primitive)),
            Self::Fuse(surviving, absorbed) => {
                let (surviving, absorbed) = (primitive_id(map, *surviving), primitive_id(map, *absorbed));
                let both = map.primitive(surviving).zip(map.primitive(absorbed));
                if both.is_none_or(|(surviving, absorbed)| surviving.submap == absorbed.submap) {
                    map.fuse_primitives(surviving, absorbed);
                }
            }
            Self::Turn(primitive, direction, variance) => {
                if let Some(direction) = Direction::new(*direction) {
                    let covariance = Matrix3::from_diagonal_element(*variance);
                    map.set_primitive_direction(primitive_id(map, *primitive), direction, covariance);
                }
            }
        }
    }
}

/// As detection gives them: unit and finite, supported by segments that exist.
fn vanishing(direction: &Vector3<f64>) -> Option<VanishingObservation> {
    let direction = Direction::new(*direction)?;
    Some(VanishingObservation {
        direction: *direction.as_vector(),
        covariance: Matrix3::from_diagonal_element(1e-4),
        segments: (0..N_SEGMENTS as u32).collect(),
        primitive: None,
    })
}
