//! Vanishing points of a keyframe.
//!
//! Version 1: `u8` version, then for each vanishing point `f64` x, y, z of its direction, nine `f64` of its
//! covariance row by row, the number of its segments and their indices as LEB128 numbers. Which primitives
//! they belong to is kept with the primitives.

use super::BlobError;
use super::reader::{Reader, push_varint};
use nalgebra::{Matrix3, Vector3};
use slam::map::VanishingObservation;

const VERSION: u8 = 1;

/// Packs vanishing points without their primitives.
pub(crate) fn encode_vanishing(vanishing: &[VanishingObservation]) -> Vec<u8> {
    let mut bytes = vec![VERSION];
    for seen in vanishing {
        seen.direction.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend(encode_covariance(&seen.covariance));
        push_varint(&mut bytes, seen.segments.len() as u64);
        seen.segments.iter().for_each(|segment| push_varint(&mut bytes, u64::from(*segment)));
    }
    bytes
}

/// Reverses [`encode_vanishing`]; each segment is one of `n_segments`.
pub(crate) fn decode_vanishing(
    bytes: &[u8],
    n_segments: usize,
) -> Result<Vec<VanishingObservation>, BlobError> {
    let mut reader = Reader(bytes);
    let version = reader.u8()?;
    if version != VERSION {
        return Err(BlobError(format!("vanishing points have the unknown format {version}")));
    }
    let mut vanishing = Vec::new();
    while !reader.0.is_empty() {
        let direction = Vector3::new(reader.f64()?, reader.f64()?, reader.f64()?);
        let covariance = decode_covariance(reader.bytes(COVARIANCE_BYTES)?)?;
        if !direction.iter().all(|value| value.is_finite()) {
            return Err(BlobError("a vanishing point is not finite".into()));
        }
        let n = reader.varint()?;
        if n > reader.0.len() as u64 {
            return Err(BlobError(format!("{n} segments do not fit into {} bytes", reader.0.len())));
        }
        let segment = |reader: &mut Reader| -> Result<u32, BlobError> {
            let index = reader.varint()?;
            u32::try_from(index)
                .ok()
                .filter(|index| (*index as usize) < n_segments)
                .ok_or_else(|| BlobError(format!("a vanishing point names segment {index} of {n_segments}")))
        };
        let segments = (0..n).map(|_| segment(&mut reader)).collect::<Result<_, _>>()?;
        vanishing.push(VanishingObservation { direction, covariance, segments, primitive: None });
    }
    Ok(vanishing)
}

/// Bytes of a packed covariance.
const COVARIANCE_BYTES: usize = 9 * 8;

/// The nine numbers of a matrix, row by row.
pub(crate) fn encode_covariance(covariance: &Matrix3<f64>) -> [u8; COVARIANCE_BYTES] {
    let mut bytes = [0; COVARIANCE_BYTES];
    for (idx, chunk) in bytes.chunks_exact_mut(8).enumerate() {
        chunk.copy_from_slice(&covariance[(idx / 3, idx % 3)].to_le_bytes());
    }
    bytes
}

/// Reverses [`encode_covariance`]; every number is finite.
pub(crate) fn decode_covariance(bytes: &[u8]) -> Result<Matrix3<f64>, BlobError> {
    let mut reader = Reader(bytes);
    let mut covariance = Matrix3::zeros();
    for idx in 0..9 {
        covariance[(idx / 3, idx % 3)] = reader.f64()?;
    }
    reader.finish()?;
    if covariance.iter().all(|value| value.is_finite()) {
        Ok(covariance)
    } else {
        Err(BlobError("a covariance is not finite".into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vanishing() -> Vec<VanishingObservation> {
        let seen = |x: f64, segments: Vec<u32>| VanishingObservation {
            direction: Vector3::new(x, 0.1 + 0.2, -1.0 / 3.0),
            covariance: Matrix3::from_fn(|row, column| 1e-5 * (row as f64 + 0.7 * column as f64)),
            segments,
            primitive: None,
        };
        vec![seen(1.0, vec![3, 0, 499]), seen(-0.0, vec![])]
    }

    #[test]
    fn vanishing_points_come_back_bit_for_bit() {
        let bytes = encode_vanishing(&vanishing());
        assert_eq!(decode_vanishing(&bytes, 500), Ok(vanishing()));
        assert_eq!(encode_vanishing(&decode_vanishing(&bytes, 500).unwrap()), bytes);
        assert_eq!(decode_vanishing(&encode_vanishing(&[]), 0), Ok(vec![]));
    }

    #[test]
    fn damaged_vanishing_points_are_refused() {
        let bytes = encode_vanishing(&vanishing());
        let whole: Vec<usize> = vec![1, 1 + 96 + 1 + 4];
        for length in 0..bytes.len() {
            assert_eq!(decode_vanishing(&bytes[..length], 500).is_ok(), whole.contains(&length), "{length}");
        }
        assert!(decode_vanishing(&bytes, 499).is_err(), "a segment that is not there");
        let mut infinite = bytes.clone();
        infinite[1..9].copy_from_slice(&f64::NEG_INFINITY.to_le_bytes());
        assert!(decode_vanishing(&infinite, 500).is_err());
        let mut many = bytes;
        many[97] = 120;
        assert!(decode_vanishing(&many, 500).is_err(), "more segments than bytes");
    }
}
