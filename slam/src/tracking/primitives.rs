//! Rotation constraints: which segments of a view belong to a global primitive, by their tracks. They hold
//! the attitude where landmarks are few or all in one spot. [method: Low texture; Vanishing-point error]

use super::frame::TrackedFrame;
use super::lines::newest_keyframes;
use crate::map::{Map, PrimitiveId};
use std::collections::{BTreeMap, BTreeSet};

/// Which track of segments runs along which primitive.
#[derive(Clone, Debug, Default)]
pub(super) struct PrimitiveTracks {
    primitives: BTreeMap<u64, PrimitiveId>,
}

impl PrimitiveTracks {
    /// Takes over what mapping found out about the tracks of the newest keyframes.
    pub fn update(&mut self, map: &Map) {
        for keyframe in newest_keyframes(map) {
            for vanishing in &keyframe.vanishing {
                let tracks =
                    vanishing.segments.iter().map(|idx| keyframe.features.lines[*idx as usize].track);
                match vanishing.primitive {
                    Some(id) => self.primitives.extend(tracks.map(|track| (track, id))),
                    None => tracks.for_each(|track| _ = self.primitives.remove(&track)),
                }
            }
        }
    }

    /// Forgets the tracks that have ended.
    pub fn remember(&mut self, frame: &TrackedFrame) {
        let live: BTreeSet<u64> = frame.features.lines.iter().map(|segment| segment.track).collect();
        self.primitives.retain(|track, _| live.contains(track));
    }

    /// Notes for each segment of a frame the primitive it runs along, if that is known and in the frame's
    /// submap.
    pub fn associate(&self, frame: &mut TrackedFrame, map: &Map) {
        let known = |track: u64| {
            let primitive = map.primitive(*self.primitives.get(&track)?)?;
            (primitive.submap == frame.submap).then_some(primitive.id)
        };
        frame.primitives = frame.features.lines.iter().map(|segment| known(segment.track)).collect();
    }
}
