//! Who sees a landmark.
//!
//! Version 1: `u8` version, then for each sighting in the order of the keyframes' ids two LEB128 numbers,
//! the keyframe's id less the one before (from 0) and the index of the feature:
//! a keypoint for points, a segment for lines, a vanishing point for primitives. Some three bytes a sighting.

use super::BlobError;
use super::reader::{Reader, push_varint};
use slam::map::{KeyframeId, Observation};

const VERSION: u8 = 1;

/// Packs sightings, which must be in the order of the keyframes' ids.
pub(crate) fn encode_observations(observations: &[Observation]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 + 4 * observations.len());
    bytes.push(VERSION);
    let mut previous = 0;
    for seen in observations {
        let id = seen.keyframe.get();
        push_varint(&mut bytes, id.wrapping_sub(previous));
        push_varint(&mut bytes, u64::from(seen.feature_idx));
        previous = id;
    }
    bytes
}

/// Reverses [`encode_observations`]; keyframes come in rising order, each once.
pub(crate) fn decode_observations(bytes: &[u8]) -> Result<Vec<Observation>, BlobError> {
    let mut reader = Reader(bytes);
    let version = reader.u8()?;
    if version != VERSION {
        return Err(BlobError(format!("observations have the unknown format {version}")));
    }
    let mut observations = Vec::with_capacity(reader.0.len() / 2);
    let mut previous = 0u64;
    while !reader.0.is_empty() {
        let step = reader.varint()?;
        let id = previous.checked_add(step).filter(|_| step > 0).and_then(KeyframeId::new);
        let keyframe = id.ok_or_else(|| BlobError("observations are out of order".into()))?;
        let feature_idx = u32::try_from(reader.varint()?)
            .map_err(|_| BlobError("the index of a feature is too large".into()))?;
        observations.push(Observation { keyframe, feature_idx });
        previous = keyframe.get();
    }
    Ok(observations)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(keyframe: u64, feature_idx: u32) -> Observation {
        Observation { keyframe: KeyframeId::new(keyframe).unwrap(), feature_idx }
    }

    #[test]
    fn observations_come_back_in_few_bytes() {
        let observations = [seen(7, 900), seen(8, 3), seen(500, u32::MAX), seen(u64::MAX, 0)];
        let bytes = encode_observations(&observations);
        assert_eq!(decode_observations(&bytes).unwrap(), observations);
        let usual: Vec<_> = (100..110).map(|id| seen(id, 731)).collect();
        assert_eq!(encode_observations(&usual).len(), 1 + 3 * 10);
    }

    #[test]
    fn damaged_observations_are_refused() {
        let bytes = encode_observations(&[seen(7, 900), seen(8, 3)]);
        assert!(decode_observations(&bytes[..bytes.len() - 1]).is_err(), "cut short");
        assert!(decode_observations(&[]).is_err(), "no version");
        assert!(decode_observations(&[2, 1, 1]).is_err(), "unknown version");
        assert!(decode_observations(&[1, 5, 0, 0, 1]).is_err(), "the same keyframe twice");
    }
}
