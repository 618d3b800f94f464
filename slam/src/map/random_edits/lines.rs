//! Edits of lines.

use super::*;
use geometry::Line3;

#[derive(Clone, Debug)]
pub(super) enum LineEdit {
    Add { ends: [Vector3<f64>; 2], created_by: Index, seen: Vec<(Index, u32)> },
    Observe(Index, Index, u32),
    Unobserve(Index, Index),
    Remove(Index),
    Fuse(Index, Index),
    Move(Index, [Vector3<f64>; 2]),
    Assign(Index, Option<Index>),
    Refresh(Index),
    Count(Index, u32),
}

pub(super) fn edits() -> impl Strategy<Value = LineEdit> {
    // A few segments more than there are.
    let segment = || 0..N_SEGMENTS as u32 + 2;
    prop_oneof![
        6 => ([vector(), vector()], index(), vec((index(), segment()), 1..8))
            .prop_map(|(ends, created_by, seen)| LineEdit::Add { ends, created_by, seen }),
        3 => (index(), index(), segment())
            .prop_map(|(line, keyframe, feature_idx)| LineEdit::Observe(line, keyframe, feature_idx)),
        1 => (index(), index()).prop_map(|(line, keyframe)| LineEdit::Unobserve(line, keyframe)),
        1 => index().prop_map(LineEdit::Remove),
        2 => (index(), index()).prop_map(|(surviving, absorbed)| LineEdit::Fuse(surviving, absorbed)),
        1 => (index(), [vector(), vector()]).prop_map(|(line, ends)| LineEdit::Move(line, ends)),
        3 => (index(), proptest::option::of(index()))
            .prop_map(|(line, primitive)| LineEdit::Assign(line, primitive)),
        1 => index().prop_map(LineEdit::Refresh),
        1 => (index(), 0..3_u32).prop_map(|(line, n)| LineEdit::Count(line, n)),
    ]
}

impl LineEdit {
    pub(super) fn apply(&self, map: &mut Map) {
        match self {
            Self::Add { ends, created_by, seen } => {
                let created_by = keyframe_id(map, *created_by);
                let submap = map.keyframe(created_by).map_or(SubmapId(0), |keyframe| keyframe.submap);
                let seen = visibility(map, submap, seen);
                if let Some(place) = place(ends) {
                    map.add_line(&place, created_by, &seen);
                }
            }
            Self::Observe(line, keyframe, feature_idx) => {
                let line = line_id(map, *line);
                let submap = map.line(line).map_or(SubmapId(0), |line| line.submap);
                for seen in visibility(map, submap, &[(*keyframe, *feature_idx)]) {
                    map.add_line_observation(line, seen);
                }
            }
            Self::Unobserve(line, keyframe) => {
                map.remove_line_observation(line_id(map, *line), keyframe_id(map, *keyframe));
            }
            Self::Remove(line) => map.remove_line(line_id(map, *line)),
            Self::Fuse(surviving, absorbed) => {
                let (surviving, absorbed) = (line_id(map, *surviving), line_id(map, *absorbed));
                if map
                    .line(surviving)
                    .zip(map.line(absorbed))
                    .is_none_or(|(surviving, absorbed)| surviving.submap == absorbed.submap)
                {
                    map.fuse_lines(surviving, absorbed);
                }
            }
            Self::Move(line, ends) => {
                if let Some(place) = place(ends) {
                    map.set_line_place(line_id(map, *line), &place);
                }
            }
            Self::Assign(line, primitive) => assign(map, line_id(map, *line), *primitive),
            Self::Refresh(line) => map.refresh_line(line_id(map, *line)),
            Self::Count(line, n) => map.count_line_visibility(line_id(map, *line), *n, 1),
        }
    }
}

fn assign(map: &mut Map, line: LineId, primitive: Option<Index>) {
    let primitive = primitive.map(|index| primitive_id(map, index));
    let submap = primitive.and_then(|id| map.primitive(id)).map(|primitive| primitive.submap);
    if map.line(line).zip(submap).is_none_or(|(line, submap)| line.submap == submap) {
        map.set_line_primitive(line, primitive);
    }
}

/// `None` if there is no line through the ends. Ends that are not finite come with a line that is.
fn place(ends: &[Vector3<f64>; 2]) -> Option<LinePlace> {
    let line = Line3::from_points(&ends[0], &ends[1])
        .or_else(|| Line3::from_points(&Vector3::zeros(), &Vector3::x()))?;
    Some(LinePlace { line, endpoints: *ends })
}
