//! What the front end measured in a keyframe.
//!
//! Version 1: `u8` version, `u32` number of keypoints `n`, the settings the features belong to (`f64` fx, fy,
//! cx, cy of the working camera, `u8` pyramid levels, `f64` scale factor), then one column after the other:
//! `n` times `f32` x, `f32` y, `f32` angle, `f32` response, `u8` octave, and 32 bytes of descriptor. 46 bytes
//! and 49 a keypoint.
//!
//! Version 2: as version 1, with a `u32` number of segments after the settings, and after the descriptors the
//! segments one by one: `f64` x and y of the start, x and y of the end, standard deviation, `u64` track, and
//! 32 bytes of descriptor. 80 bytes a segment.

use super::reader::Reader;
use super::{BlobError, DESCRIPTOR_BYTES, decode_descriptor, encode_descriptor};
use geometry::{Camera, Pinhole};
use nalgebra::Vector2;
use slam::features::{FrameFeatures, LineFeature, PyramidGeometry};
use vision::{Descriptor, Keypoint};

const VERSION: u8 = 2;
/// The version before, without segments.
const VERSION_OF_POINTS: u8 = 1;
const KEYPOINT_BYTES: usize = 4 * 4 + 1 + DESCRIPTOR_BYTES;
const SEGMENT_BYTES: usize = 6 * 8 + DESCRIPTOR_BYTES;
#[cfg(test)]
const HEADER_BYTES: usize = 1 + 4 + 4 * 8 + 1 + 8 + 4;

/// What keypoints mean: the camera whose pixels they are in and the resolutions they were looked for in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FeatureSettings {
    /// The working camera without its distortion.
    pub pinhole: Pinhole,
    /// The resolutions.
    pub pyramid: PyramidGeometry,
}

/// How much was measured in a keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct MeasuredCounts {
    pub n_keypoints: usize,
    pub n_segments: usize,
}

/// Packs a keyframe's features.
pub(crate) fn encode_features(features: &FrameFeatures) -> Vec<u8> {
    let n = features.keypoints.len();
    let mut bytes =
        Vec::with_capacity(64 + n * KEYPOINT_BYTES + features.nominal_lines().len() * SEGMENT_BYTES);
    bytes.push(VERSION);
    bytes.extend((n as u32).to_le_bytes());
    let Pinhole { fx, fy, cx, cy } = features.nominal_pinhole;
    [fx, fy, cx, cy].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes.push(features.pyramid.n_levels);
    bytes.extend(features.pyramid.scale_factor.to_le_bytes());
    bytes.extend((features.nominal_lines().len() as u32).to_le_bytes());
    let columns: [fn(&Keypoint) -> f32; 4] = [|k| k.x, |k| k.y, |k| k.angle, |k| k.response];
    for column in columns {
        bytes.extend(features.keypoints.iter().flat_map(|keypoint| column(keypoint).to_le_bytes()));
    }
    bytes.extend(features.keypoints.iter().map(|keypoint| keypoint.octave));
    for descriptor in &features.descriptors {
        bytes.extend(encode_descriptor(descriptor));
    }
    features.nominal_lines().iter().for_each(|segment| push_segment(&mut bytes, segment));
    bytes
}

fn push_segment(bytes: &mut Vec<u8>, segment: &LineFeature) {
    let LineFeature { start, end, sigma_px, descriptor, track } = segment;
    [start.x, start.y, end.x, end.y, *sigma_px].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes.extend(track.to_le_bytes());
    bytes.extend(encode_descriptor(descriptor));
}

/// Reverses [`encode_features`]; says which settings the features belong to if they are not those expected.
pub(crate) fn decode_features(
    bytes: &[u8],
    working_camera: &Camera,
    expected: &FeatureSettings,
) -> Result<Result<FrameFeatures, FeatureSettings>, BlobError> {
    let Parsed { settings, keypoints, descriptors, segments } = parse(bytes)?;
    if settings != *expected {
        return Ok(Err(settings));
    }
    FrameFeatures::from_parts(keypoints, descriptors, working_camera, settings.pyramid)
        .map(|features| Ok(features.with_lines(segments)))
        .ok_or_else(|| BlobError("a keypoint lies where the lens model has no inverse".into()))
}

/// Whether packed features can be read; how many there are.
pub(crate) fn check_features(bytes: &[u8]) -> Result<MeasuredCounts, BlobError> {
    let parsed = parse(bytes)?;
    Ok(MeasuredCounts { n_keypoints: parsed.keypoints.len(), n_segments: parsed.segments.len() })
}

/// Where the packed keypoints are, pixels of the working image.
pub(crate) fn positions(bytes: &[u8]) -> Result<Vec<[f32; 2]>, BlobError> {
    Ok(parse(bytes)?.keypoints.iter().map(|keypoint| [keypoint.x, keypoint.y]).collect())
}

/// Where the packed keypoints are, pixels of the working image, and the segments beside them.
pub(crate) fn measured(bytes: &[u8]) -> Result<(Vec<[f32; 2]>, Vec<LineFeature>), BlobError> {
    let Parsed { keypoints, segments, .. } = parse(bytes)?;
    Ok((keypoints.iter().map(|keypoint| [keypoint.x, keypoint.y]).collect(), segments))
}

struct Parsed {
    settings: FeatureSettings,
    keypoints: Vec<Keypoint>,
    descriptors: Vec<Descriptor>,
    segments: Vec<LineFeature>,
}

fn parse(bytes: &[u8]) -> Result<Parsed, BlobError> {
    let mut reader = Reader(bytes);
    let (MeasuredCounts { n_keypoints: n, n_segments }, settings) = read_header(&mut reader)?;
    let mut column = || -> Result<_, BlobError> { Ok(reader.bytes(4 * n)?.as_chunks::<4>().0) };
    let (x, y, angle, response) = (column()?, column()?, column()?, column()?);
    let octaves = reader.bytes(n)?;
    let descriptors = reader.bytes(DESCRIPTOR_BYTES * n)?;
    let segments = (0..n_segments).map(|_| read_segment(&mut reader)).collect::<Result<Vec<_>, _>>()?;
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
    Ok(Parsed { settings, keypoints, descriptors, segments })
}

fn read_segment(reader: &mut Reader) -> Result<LineFeature, BlobError> {
    let start = Vector2::new(reader.f64()?, reader.f64()?);
    let end = Vector2::new(reader.f64()?, reader.f64()?);
    let (sigma_px, track) = (reader.f64()?, reader.u64()?);
    let descriptor = decode_descriptor(reader.bytes(DESCRIPTOR_BYTES)?)?;
    if !start.iter().chain(&end).chain([&sigma_px]).all(|value| value.is_finite()) {
        return Err(BlobError("a segment is not finite".into()));
    }
    Ok(LineFeature { start, end, sigma_px, descriptor, track })
}

fn read_header(reader: &mut Reader) -> Result<(MeasuredCounts, FeatureSettings), BlobError> {
    let version = reader.u8()?;
    if version != VERSION && version != VERSION_OF_POINTS {
        return Err(BlobError(format!("features have the unknown format {version}")));
    }
    let n = reader.u32()? as usize;
    let pinhole = Pinhole { fx: reader.f64()?, fy: reader.f64()?, cx: reader.f64()?, cy: reader.f64()? };
    let pyramid = PyramidGeometry { n_levels: reader.u8()?, scale_factor: reader.f64()? };
    let n_segments = if version == VERSION_OF_POINTS { 0 } else { reader.u32()? as usize };
    // Checked before anything of that size is reserved.
    let n_left = reader.0.len();
    if n_left != n * KEYPOINT_BYTES + n_segments * SEGMENT_BYTES {
        return Err(BlobError(format!("{n} keypoints and {n_segments} segments do not fill {n_left} bytes")));
    }
    Ok((MeasuredCounts { n_keypoints: n, n_segments }, FeatureSettings { pinhole, pyramid }))
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
        let segments = (0..7u32).map(|i| LineFeature {
            start: Vector2::new(f64::from(i) / 3.0, -0.0),
            end: Vector2::new(700.5, f64::from(i).sqrt()),
            sigma_px: 0.1 + 0.2 * f64::from(i),
            descriptor: Descriptor([u64::from(i); 4]),
            track: u64::MAX - u64::from(i),
        });
        let features = FrameFeatures::from_parts(keypoints, descriptors, &camera(), pyramid).unwrap();
        (features.with_lines(segments.collect()), settings)
    }

    #[test]
    fn features_come_back_bit_for_bit() {
        let (features, settings) = features();
        let bytes = encode_features(&features);
        assert_eq!(bytes.len(), HEADER_BYTES + 50 * KEYPOINT_BYTES + 7 * SEGMENT_BYTES);
        assert_eq!(check_features(&bytes), Ok(MeasuredCounts { n_keypoints: 50, n_segments: 7 }));
        let back = decode_features(&bytes, &camera(), &settings).unwrap().unwrap();
        assert_eq!(back.keypoints, features.keypoints);
        assert_eq!(back.descriptors, features.descriptors);
        assert_eq!(back.undistorted, features.undistorted);
        assert_eq!(back.lines, features.lines);
        assert_eq!((back.pinhole, back.pyramid), (features.pinhole, features.pyramid));
    }

    #[test]
    fn features_of_the_first_version_are_points_alone() {
        let (features, settings) = features();
        let mut bytes = encode_features(&features);
        bytes[0] = VERSION_OF_POINTS;
        bytes.drain(HEADER_BYTES - 4..HEADER_BYTES);
        bytes.truncate(bytes.len() - 7 * SEGMENT_BYTES);
        let back = decode_features(&bytes, &camera(), &settings).unwrap().unwrap();
        assert_eq!((back.keypoints, back.lines), (features.keypoints, vec![]));
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
        let mut infinite = bytes.clone();
        let last_segment = bytes.len() - SEGMENT_BYTES;
        infinite[last_segment..last_segment + 8].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(decode(&infinite), "a segment at infinity");
    }
}
