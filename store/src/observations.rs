//! Both sides of the observations: landmarks and primitives know who sees them, and keyframes are told at
//! load.

use crate::StoreError;
use slam::Keyframe;
use slam::map::{KeyframeId, MapParts};
use std::fmt::Display;

/// Tells the keyframes, which are in the order of their ids, what they see.
pub(crate) fn enter_observations(mut parts: MapParts) -> Result<MapParts, StoreError> {
    let keyframes = &mut parts.keyframes;
    for point in &parts.points {
        for seen in &point.observations {
            let slot = find(keyframes, seen.keyframe)
                .and_then(|keyframe| keyframe.points.get_mut(seen.feature_idx as usize));
            enter(slot, point.id, ["point", "keypoint"], seen.keyframe, seen.feature_idx)?;
        }
    }
    for line in &parts.lines {
        for seen in &line.observations {
            let slot = find(keyframes, seen.keyframe)
                .and_then(|keyframe| keyframe.lines.get_mut(seen.feature_idx as usize));
            enter(slot, line.id, ["line", "segment"], seen.keyframe, seen.feature_idx)?;
        }
    }
    for primitive in &parts.primitives {
        for seen in &primitive.observations {
            let slot = find(keyframes, seen.keyframe)
                .and_then(|keyframe| keyframe.vanishing.get_mut(seen.vanishing_idx as usize))
                .map(|vanishing| &mut vanishing.primitive);
            enter(slot, primitive.id, ["primitive", "vanishing point"], seen.keyframe, seen.vanishing_idx)?;
        }
    }
    Ok(parts)
}

fn find(keyframes: &mut [Keyframe], id: KeyframeId) -> Option<&mut Keyframe> {
    let position = keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok()?;
    Some(&mut keyframes[position])
}

/// Enters an id where it is seen; `words` name the thing and what sees it.
fn enter<Id: Copy + Display>(
    slot: Option<&mut Option<Id>>,
    id: Id,
    words: [&str; 2],
    keyframe: KeyframeId,
    feature_idx: u32,
) -> Result<(), StoreError> {
    let [thing, feature] = words;
    match slot {
        Some(slot @ None) => {
            *slot = Some(id);
            Ok(())
        }
        Some(Some(other)) => Err(StoreError::Corrupt(format!(
            "{thing}s {other} and {id} claim the same {feature} of keyframe {keyframe}"
        ))),
        None => Err(StoreError::Corrupt(format!(
            "{thing} {id} claims {feature} {feature_idx} of keyframe {keyframe}, which is not there"
        ))),
    }
}
