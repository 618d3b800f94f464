//! What the front end measured in a key frame.
//!
//! Version 1: `u8` version, `u32` number of keypoints `n`, the settings the features belong to (`f64` fx, fy, cx, cy
//! of the working camera, `u8` pyramid levels, `f64` scale factor), then one column after the other: `n` times `f32`
//! x, `f32` y, `f32` angle, `f32` response, `u8` octave, and 32 bytes of descriptor. 46 bytes and 49 a keypoint.

use super::reader::Reader;
use super::{BlobError, DESCRIPTOR_BYTES, decode_descriptor, encode_descriptor};
use geometry::{Camera, Pinhole};
use slam::features::{FrameFeatures, PyramidGeometry};
use vision::{Descriptor, Keypoint};

const VERSION: u8 = 1;
const HEADER_BYTES: usize = 1 + 4 + 4 * 8 + 1 + 8;
const KEYPOINT_BYTES: usize = 4 * 4 + 1 + DESCRIPTOR_BYTES;

/// What keypoints mean: the camera whose pixels they are in and the resolutions they were looked for in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FeatureSettings {
    /// The working camera without its distortion.
    pub pinhole: Pinhole,
    /// The resolutions.
    pub pyramid: PyramidGeometry,
}

/// Packs a key frame's features.
pub(crate) fn encode_features(features: &FrameFeatures) -> Vec<u8> {
    let n = features.keypoints.len();
    let mut bytes = Vec::with_capacity(HEADER_BYTES + n * KEYPOINT_BYTES);
    bytes.push(VERSION);
    bytes.extend((n as u32).to_le_bytes());
    let Pinhole { fx, fy, cx, cy } = features.pinhole;
    [fx, fy, cx, cy].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes.push(features.pyramid.n_levels);
    bytes.extend(features.pyramid.scale_factor.to_le_bytes());
    let columns: [fn(&Keypoint) -> f32; 4] = [|k| k.x, |k| k.y, |k| k.angle, |k| k.response];
    for column in columns {
        bytes.extend(features.keypoints.iter().flat_map(|keypoint| column(keypoint).to_le_bytes()));
    }
    bytes.extend(features.keypoints.iter().map(|keypoint| keypoint.octave));
    for descriptor in &features.descriptors {
        bytes.extend(encode_descriptor(descriptor));
    }
    bytes
}

/// Reverses [`encode_features`]; says which settings the features belong to if they are not those expected.
pub(crate) fn decode_features(
    bytes: &[u8],
    working_camera: &Camera,
    expected: &FeatureSettings,
) -> Result<Result<FrameFeatures, FeatureSettings>, BlobError> {
    let (settings, keypoints, descriptors) = parse(bytes)?;
    if settings != *expected {
        return Ok(Err(settings));
    }
    FrameFeatures::from_parts(keypoints, descriptors, working_camera, settings.pyramid)
        .map(Ok)
        .ok_or_else(|| BlobError("a keypoint lies where the lens model has no inverse".into()))
}

/// Whether packed features can be read; how many keypoints there are.
pub(crate) fn check_features(bytes: &[u8]) -> Result<usize, BlobError> {
    parse(bytes).map(|(_, keypoints, _)| keypoints.len())
}

fn parse(bytes: &[u8]) -> Result<(FeatureSettings, Vec<Keypoint>, Vec<Descriptor>), BlobError> {
    let mut reader = Reader(bytes);
    let (n, settings) = read_header(&mut reader)?;
    let mut column = || -> Result<_, BlobError> { Ok(reader.bytes(4 * n)?.as_chunks::<4>().0) };
    let (x, y, angle, response) = (column()?, column()?, column()?, column()?);
    let octaves = reader.bytes(n)?;
    let descriptors = reader.bytes(DESCRIPTOR_BYTES * n)?;
    reader.finish()?;

    let keypoint = |idx: usize| Keypoint {
        x: f32::from_le_bytes(x[idx]),
        y: f32::from_le_bytes(y[idx]),
        octave: octaves[idx],
        angle: f32::from_le_bytes(angle[idx]),
        response: f32::from_le_bytes(response[idx]),
    };
    let keypoints: Vec<Keypoint> = (0..n).map(keypoint).collect();
    if let Some(idx) = keypoints.iter().position(|keypoint| !is_sound(keypoint, settings.pyramid)) {
        return Err(BlobError(format!("keypoint {idx} is not finite or of an unknown level")));
    }
    let descriptors =
        descriptors.chunks_exact(DESCRIPTOR_BYTES).map(decode_descriptor).collect::<Result<Vec<_>, _>>()?;
    Ok((settings, keypoints, descriptors))
}

fn read_header(reader: &mut Reader) -> Result<(usize, FeatureSettings), BlobError> {
    let version = reader.u8()?;
    if version != VERSION {
        return Err(BlobError(format!("features have the unknown format {version}")));
    }
    let n = reader.u32()? as usize;
    let pinhole = Pinhole { fx: reader.f64()?, fy: reader.f64()?, cx: reader.f64()?, cy: reader.f64()? };
    let pyramid = PyramidGeometry { n_levels: reader.u8()?, scale_factor: reader.f64()? };
    // Checked before anything of that size is reserved.
    if reader.0.len() != n * KEYPOINT_BYTES {
        return Err(BlobError(format!("{n} keypoints do not fill {} bytes", reader.0.len())));
    }
    Ok((n, FeatureSettings { pinhole, pyramid }))
}

fn is_sound(keypoint: &Keypoint, pyramid: PyramidGeometry) -> bool {
    let numbers = [keypoint.x, keypoint.y, keypoint.angle, keypoint.response];
    numbers.iter().all(|value| value.is_finite()) && keypoint.octave < pyramid.n_levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{CameraModel, CameraParameters};

    fn camera() -> Camera {
        let distortion = vec![-0.28, 0.07, 0.0002, 0.00002];
        let (fx, fy, cx, cy) = (458.654, 457.296, 367.215, 248.375);
        Camera::new(CameraParameters {
            model: CameraModel::Radtan,
            width: 752,
            height: 480,
            fx,
            fy,
            cx,
            cy,
            distortion,
        })
        .unwrap()
    }

    fn features() -> (FrameFeatures, FeatureSettings) {
        let keypoints: Vec<Keypoint> = (0..50u8)
            .map(|i| Keypoint {
                x: 20.5 + f32::from(i) * 13.25,
                y: 30.125 + f32::from(i) * 7.0,
                octave: i % 8,
                angle: f32::from(i) * 0.1,
                response: f32::from(i),
            })
            .collect();
        let descriptors = (0..50).map(|i| Descriptor([i, !i, i << 32, 1 << i])).collect();
        let pyramid = PyramidGeometry { n_levels: 8, scale_factor: f64::from(1.2_f32) };
        let settings = FeatureSettings { pinhole: camera().pinhole(), pyramid };
        (FrameFeatures::from_parts(keypoints, descriptors, &camera(), pyramid).unwrap(), settings)
    }

    #[test]
    fn features_come_back_bit_for_bit() {
        let (features, settings) = features();
        let bytes = encode_features(&features);
        assert_eq!(bytes.len(), HEADER_BYTES + 50 * KEYPOINT_BYTES);
        assert_eq!(check_features(&bytes), Ok(50));
        let back = decode_features(&bytes, &camera(), &settings).unwrap().unwrap();
        assert_eq!(back.keypoints, features.keypoints);
        assert_eq!(back.descriptors, features.descriptors);
        assert_eq!(back.undistorted, features.undistorted);
        assert_eq!((back.pinhole, back.pyramid), (features.pinhole, features.pyramid));
    }

    #[test]
    fn features_of_other_settings_are_told_apart() {
        let (features, settings) = features();
        let bytes = encode_features(&features);
        let mut other = settings;
        other.pyramid.n_levels = 4;
        assert_eq!(decode_features(&bytes, &camera(), &other).unwrap().unwrap_err(), settings);
    }

    #[test]
    fn damaged_features_are_refused() {
        let (features, settings) = features();
        let bytes = encode_features(&features);
        let decode = |bytes: &[u8]| decode_features(bytes, &camera(), &settings).is_err();
        (0..bytes.len()).step_by(97).for_each(|length| assert!(decode(&bytes[..length]), "cut to {length}"));
        let mut huge = bytes.clone();
        huge[1..5].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(decode(&huge), "a length that is a lie");
        let mut infinite = bytes.clone();
        infinite[HEADER_BYTES..HEADER_BYTES + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert!(decode(&infinite), "a keypoint at infinity");
    }
}
