//! Packed values: little-endian, each beginning with a byte that tells its format version.

mod features;
mod motion;
mod observations;
mod reader;
mod vanishing;

pub(crate) use features::{
    FeatureSettings, MeasuredCounts, check_features, decode_features, encode_features, measured, positions,
};
pub(crate) use motion::{decode_motion, encode_motion};
pub(crate) use observations::{decode_observations, encode_observations};
pub(crate) use vanishing::{decode_covariance, decode_vanishing, encode_covariance, encode_vanishing};

use vision::Descriptor;

/// Bytes of a packed descriptor.
pub(crate) const DESCRIPTOR_BYTES: usize = 32;

/// Why a packed value cannot be read, in a plain phrase.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BlobError(pub String);

/// The four words of a descriptor, little-endian.
pub(crate) fn encode_descriptor(descriptor: &Descriptor) -> [u8; DESCRIPTOR_BYTES] {
    let mut bytes = [0; DESCRIPTOR_BYTES];
    for (chunk, word) in bytes.chunks_exact_mut(8).zip(descriptor.0) {
        chunk.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Reverses [`encode_descriptor`].
pub(crate) fn decode_descriptor(bytes: &[u8]) -> Result<Descriptor, BlobError> {
    let bytes: &[u8; DESCRIPTOR_BYTES] = bytes.try_into().map_err(|_| {
        BlobError(format!("a descriptor has {} bytes instead of {DESCRIPTOR_BYTES}", bytes.len()))
    })?;
    let (words, _) = bytes.as_chunks::<8>();
    Ok(Descriptor(std::array::from_fn(|word_idx| u64::from_le_bytes(words[word_idx]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_descriptor_comes_back() {
        let descriptor = Descriptor([1, u64::MAX, 0x0123_4567_89ab_cdef, 7 << 60]);
        assert_eq!(decode_descriptor(&encode_descriptor(&descriptor)), Ok(descriptor));
        assert!(decode_descriptor(&[0; 31]).is_err());
    }
}
