//! Edits of a whole submap, or of all there is.

use super::*;
use geometry::Similarity;
use geometry::nalgebra::UnitQuaternion;

#[derive(Clone, Debug)]
pub(super) enum WholeEdit {
    /// As a loop does: some of the keyframes of a submap, then its landmarks.
    Correct {
        submap: u32,
        every: usize,
        rotation: Vector3<f64>,
        translation: Vector3<f64>,
        log_scale: f64,
    },
    /// Two submaps turn out to show one place.
    Merge {
        gone: u32,
        kept: u32,
        root: Index,
        parent: Index,
    },
    Discard {
        submap: u32,
    },
    Recalibrate {
        focal: f64,
        center_x: f64,
        center_y: f64,
        k1: f64,
    },
}

pub(super) fn edits() -> impl Strategy<Value = WholeEdit> {
    let submap = || 0..N_SUBMAPS;
    prop_oneof![
        (submap(), 1..4_usize, vector(), vector(), number()).prop_map(
            |(submap, every, rotation, translation, number)| WholeEdit::Correct {
                submap,
                every,
                rotation,
                translation,
                log_scale: 0.05 * number,
            }
        ),
        (submap(), submap(), index(), index()).prop_map(|(gone, kept, root, parent)| WholeEdit::Merge {
            gone,
            kept,
            root,
            parent
        }),
        submap().prop_map(|submap| WholeEdit::Discard { submap }),
        [number(), number(), number(), number()].prop_map(|[focal, center_x, center_y, k1]| {
            WholeEdit::Recalibrate {
                focal: 0.2 * focal,
                center_x: 0.1 * center_x,
                center_y: 0.1 * center_y,
                k1: 0.05 * k1,
            }
        }),
    ]
}

impl WholeEdit {
    pub(super) fn apply(&self, map: &mut Map) {
        match self {
            Self::Correct { submap, every, rotation, translation, log_scale } => {
                let rotation = UnitQuaternion::from_scaled_axis(*rotation);
                let correction = Similarity::new(rotation, *translation, log_scale.exp());
                correct(map, SubmapId(*submap), *every, &correction);
            }
            Self::Merge { gone, kept, root, parent } => {
                merge(map, SubmapId(*gone), SubmapId(*kept), *root, *parent);
            }
            Self::Discard { submap } => map.remove_submap(SubmapId(*submap)),
            Self::Recalibrate { focal, center_x, center_y, k1 } => map.set_correction(CameraCorrection {
                focal: *focal,
                center_x: *center_x,
                center_y: *center_y,
                k1: *k1,
                k2: k1 * k1,
            }),
        }
    }
}

fn correct(map: &mut Map, submap: SubmapId, every: usize, correction: &Similarity) {
    let keyframes: Vec<KeyframeId> =
        map.keyframes_of(submap).step_by(every).map(|keyframe| keyframe.id).collect();
    keyframes.into_iter().for_each(|id| map.move_keyframe(id, correction));
    let points: Vec<PointId> =
        map.points().filter(|point| point.submap == submap).map(|point| point.id).collect();
    points.into_iter().for_each(|id| map.move_point(id, correction));
    let lines: Vec<LineId> = map.lines().filter(|line| line.submap == submap).map(|line| line.id).collect();
    lines.into_iter().for_each(|id| map.move_line(id, correction));
    let primitives: Vec<PrimitiveId> = map
        .primitives()
        .filter(|primitive| primitive.submap == submap)
        .map(|primitive| primitive.id)
        .collect();
    primitives.into_iter().for_each(|id| map.realign_primitive(id, correction));
}

fn merge(map: &mut Map, gone: SubmapId, kept: SubmapId, root: Index, parent: Index) {
    let of = |submap| map.keyframes_of(submap).map(|keyframe| keyframe.id).collect::<Vec<_>>();
    let (roots, parents) = (of(gone), of(kept));
    if gone == kept || roots.is_empty() || parents.is_empty() {
        return;
    }
    map.rename_submap(gone, kept);
    map.hang_tree(*root.get(&roots), *parent.get(&parents));
}
