//! Taking the contents of another map into this one, under numbers that are free here.

use super::{
    FramePose, FrameRecord, Keyframe, KeyframeId, LineId, Map, MapError, Observation, PointId, PrimitiveId,
    PrimitiveObservation, RemovedKeyframe, SubmapId,
};
use std::sync::Arc;

/// What numbers of the other map became.
#[derive(Clone, Debug)]
pub(crate) struct Imported {
    offsets: Offsets,
    /// The other map's keyframes, by their numbers there.
    keyframes: Vec<KeyframeId>,
}

#[derive(Clone, Copy, Debug)]
struct Offsets {
    keyframe: u64,
    point: u64,
    line: u64,
    primitive: u64,
    submap: u32,
    track: u64,
}

impl Imported {
    /// Keyframes by their numbers there and here.
    pub fn keyframes(&self) -> Vec<(KeyframeId, KeyframeId)> {
        self.keyframes.iter().filter_map(|id| Some((*id, self.offsets.keyframe(*id)?))).collect()
    }

    /// A frame's record with the numbers of here.
    pub fn frame(&self, frame: FrameRecord) -> Option<FrameRecord> {
        let pose = match frame.pose {
            None => None,
            Some(pose) => Some(FramePose {
                submap: self.offsets.submap(pose.submap),
                reference: self.offsets.keyframe(pose.reference)?,
                ..pose
            }),
        };
        Some(FrameRecord { pose, ..frame })
    }
}

impl Offsets {
    fn keyframe(&self, id: KeyframeId) -> Option<KeyframeId> {
        KeyframeId::new(id.get().checked_add(self.keyframe)?)
    }

    fn point(&self, id: PointId) -> Option<PointId> {
        PointId::new(id.get().checked_add(self.point)?)
    }

    fn line(&self, id: LineId) -> Option<LineId> {
        LineId::new(id.get().checked_add(self.line)?)
    }

    fn primitive(&self, id: PrimitiveId) -> Option<PrimitiveId> {
        PrimitiveId::new(id.get().checked_add(self.primitive)?)
    }

    fn submap(&self, id: SubmapId) -> SubmapId {
        SubmapId(id.0.saturating_add(self.submap))
    }

    fn observations(&self, seen: &[Observation]) -> Option<Vec<Observation>> {
        seen.iter()
            .map(|seen| Some(Observation { keyframe: self.keyframe(seen.keyframe)?, ..*seen }))
            .collect()
    }
}

impl Map {
    /// Takes in everything of another map of the same camera, as submaps of its own; `adapt` changes what
    /// has to be of each keyframe.
    ///
    /// # Errors
    /// If numbers grow out of range, what `adapt` says, or the result is inconsistent.
    pub(crate) fn import(
        &mut self,
        from: Map,
        adapt: impl Fn(&mut Keyframe) -> Result<(), MapError>,
    ) -> Result<Imported, MapError> {
        let offsets = self.offsets_for();
        let mut from = from;
        // Its keyframes become ones of the camera as this map knows it.
        from.set_correction(self.correction);
        let imported =
            Imported { offsets, keyframes: from.keyframes().map(|keyframe| keyframe.id).collect() };
        let too_many = || MapError("its numbers would grow out of range".to_owned());
        for keyframe in from.keyframes() {
            let mut keyframe = renumbered(keyframe, &offsets).ok_or_else(too_many)?;
            adapt(&mut keyframe)?;
            self.changes.keyframes.insert(keyframe.id);
            self.next_keyframe_idx = self.next_keyframe_idx.max(keyframe.id.index() + 1);
            self.keyframes.insert(keyframe.id.index(), keyframe);
        }
        self.import_landmarks(&from, &offsets).ok_or_else(too_many)?;
        let gone = from.removed_keyframes.values().map(|gone| {
            let (id, anchor) = (offsets.keyframe(gone.id)?, offsets.keyframe(gone.anchor)?);
            Some(RemovedKeyframe { id, anchor, ..*gone })
        });
        for gone in gone.collect::<Option<Vec<_>>>().ok_or_else(too_many)? {
            self.changes.removed_keyframes.insert(gone.id);
            self.next_keyframe_idx = self.next_keyframe_idx.max(gone.id.index() + 1);
            Arc::make_mut(&mut self.removed_keyframes).insert(gone.id, gone);
        }
        self.check()?;
        for (_, id) in imported.keyframes() {
            self.refresh_covisibility(id, crate::config::MappingConfig::default().min_covisible_points);
        }
        Ok(imported)
    }

    fn import_landmarks(&mut self, from: &Map, offsets: &Offsets) -> Option<()> {
        for point in from.points() {
            let mut point = point.clone();
            point.id = offsets.point(point.id)?;
            point.submap = offsets.submap(point.submap);
            point.created_by = offsets.keyframe(point.created_by)?;
            point.observations = offsets.observations(&point.observations)?;
            self.changes.points.insert(point.id);
            self.next_point_idx = self.next_point_idx.max(point.id.index() + 1);
            self.points.insert(point.id.index(), point);
        }
        for line in from.lines() {
            let mut line = line.clone();
            line.id = offsets.line(line.id)?;
            line.submap = offsets.submap(line.submap);
            line.created_by = offsets.keyframe(line.created_by)?;
            line.observations = offsets.observations(&line.observations)?;
            line.primitive = match line.primitive {
                None => None,
                Some(id) => Some(offsets.primitive(id)?),
            };
            self.changes.lines.insert(line.id);
            self.next_line_idx = self.next_line_idx.max(line.id.index() + 1);
            self.lines.insert(line.id.index(), line);
        }
        for primitive in from.primitives() {
            let mut primitive = primitive.clone();
            primitive.id = offsets.primitive(primitive.id)?;
            primitive.submap = offsets.submap(primitive.submap);
            primitive.created_by = offsets.keyframe(primitive.created_by)?;
            for seen in &mut primitive.observations {
                *seen = PrimitiveObservation { keyframe: offsets.keyframe(seen.keyframe)?, ..*seen };
            }
            self.changes.primitives.insert(primitive.id);
            self.next_primitive_idx = self.next_primitive_idx.max(primitive.id.index() + 1);
            self.primitives.insert(primitive.id.index(), primitive);
        }
        Some(())
    }

    fn offsets_for(&self) -> Offsets {
        let last = self.last_ids();
        let segments = self.keyframes().flat_map(|keyframe| &keyframe.features.lines);
        Offsets {
            keyframe: last.keyframe,
            point: last.point,
            line: last.line,
            primitive: last.primitive,
            submap: self.submaps().last().map_or(0, |submap| submap.0.saturating_add(1)),
            track: segments.map(|segment| segment.track.saturating_add(1)).max().unwrap_or(0),
        }
    }
}

fn renumbered(keyframe: &Keyframe, offsets: &Offsets) -> Option<Keyframe> {
    let mut keyframe = keyframe.clone();
    keyframe.id = offsets.keyframe(keyframe.id)?;
    keyframe.submap = offsets.submap(keyframe.submap);
    keyframe.parent = match keyframe.parent {
        None => None,
        Some(parent) => Some(offsets.keyframe(parent)?),
    };
    keyframe.covisible.clear();
    for point in keyframe.points.iter_mut().flatten() {
        *point = offsets.point(*point)?;
    }
    for line in keyframe.lines.iter_mut().flatten() {
        *line = offsets.line(*line)?;
    }
    for primitive in keyframe.vanishing.iter_mut().filter_map(|vanishing| vanishing.primitive.as_mut()) {
        *primitive = offsets.primitive(*primitive)?;
    }
    // Numbers of tracks of two runs have nothing to do with one another.
    let mut lines = keyframe.features.nominal_lines().to_vec();
    lines.iter_mut().for_each(|line| line.track = line.track.saturating_add(offsets.track));
    keyframe.features = Arc::new((*keyframe.features).clone().with_lines(lines));
    Some(keyframe)
}
