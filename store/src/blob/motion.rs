//! Readings of motion sensors.
//!
//! Version 1: `u8` version, then for each reading `i64` its time in nanoseconds, three `f32` angular velocity
//! and three `f32` acceleration.

use super::BlobError;
use super::reader::Reader;
use crate::motion::MotionReading;

const VERSION: u8 = 1;

/// Packs readings.
pub(crate) fn encode_motion(readings: &[MotionReading]) -> Vec<u8> {
    let mut bytes = vec![VERSION];
    for reading in readings {
        bytes.extend(reading.timestamp_ns.to_le_bytes());
        let values = reading.angular_velocity.iter().chain(&reading.acceleration);
        values.for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    bytes
}

/// Reverses [`encode_motion`].
pub(crate) fn decode_motion(bytes: &[u8]) -> Result<Vec<MotionReading>, BlobError> {
    let mut reader = Reader(bytes);
    let version = reader.u8()?;
    if version != VERSION {
        return Err(BlobError(format!("readings of motion sensors have the unknown format {version}")));
    }
    let mut readings = Vec::new();
    while !reader.0.is_empty() {
        let timestamp_ns = reader.u64()?.cast_signed();
        let mut triple =
            || -> Result<[f32; 3], BlobError> { Ok([reader.f32()?, reader.f32()?, reader.f32()?]) };
        let (angular_velocity, acceleration) = (triple()?, triple()?);
        readings.push(MotionReading { timestamp_ns, angular_velocity, acceleration });
    }
    Ok(readings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_come_back_and_what_is_cut_is_refused() {
        let reading = |timestamp_ns| MotionReading {
            timestamp_ns,
            angular_velocity: [0.1, -2.0, 3.5],
            acceleration: [0.0, 9.81, -1e-3],
        };
        let readings = vec![reading(i64::MIN), reading(-1), reading(1_700_000_000_000_000_123)];
        let bytes = encode_motion(&readings);
        assert_eq!(decode_motion(&bytes).unwrap(), readings);
        assert!(decode_motion(&bytes[..bytes.len() - 1]).is_err());
        assert!(decode_motion(&[]).is_err() && decode_motion(&[9]).is_err());
    }
}
