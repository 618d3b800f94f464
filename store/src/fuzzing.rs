//! The readers of what the database holds packed, for the fuzz target (`store/fuzz`).

use crate::blob::{
    FeatureSettings, check_features, decode_covariance, decode_features, decode_observations,
    decode_vanishing, encode_covariance, encode_features, encode_observations, encode_vanishing, positions,
};
use crate::session::decode_camera;
use geometry::{Camera, CameraModel, CameraParameters};

/// Segments of the keyframe whose vanishing points are read.
const N_SEGMENTS: usize = 64;

/// Reads a packed value of one of the kinds. What can be read is written and read again: it must stay the
/// same.
pub fn read(kind: u8, bytes: &[u8]) {
    match kind % 5 {
        0 => features(bytes),
        1 => {
            if let Ok(observations) = decode_observations(bytes) {
                assert!(observations.is_sorted_by(|a, b| a.keyframe < b.keyframe));
                let again = decode_observations(&encode_observations(&observations));
                assert_eq!(again.as_ref(), Ok(&observations));
            }
        }
        2 => {
            if let Ok(vanishing) = decode_vanishing(bytes, N_SEGMENTS) {
                let packed = encode_vanishing(&vanishing);
                let again = decode_vanishing(&packed, N_SEGMENTS).map(|again| encode_vanishing(&again));
                assert_eq!(again, Ok(packed));
            }
        }
        3 => {
            if let Ok(covariance) = decode_covariance(bytes) {
                assert_eq!(encode_covariance(&covariance).as_slice(), bytes);
            }
        }
        _ => {
            // What it holds is checked by `Camera::new`, whoever needs a camera.
            if let Ok(Ok(camera)) = std::str::from_utf8(bytes).map(decode_camera) {
                let _ = Camera::new(camera);
            }
        }
    }
}

/// A camera with a lens, so that keypoints are undistorted.
fn camera() -> Option<Camera> {
    let (fx, fy, cx, cy) = (458.654, 457.296, 367.215, 248.375);
    let distortion = vec![-0.28, 0.07, 0.0002, 0.00002];
    let model = CameraModel::Radtan;
    Camera::new(CameraParameters { model, width: 752, height: 480, fx, fy, cx, cy, distortion }).ok()
}

fn features(bytes: &[u8]) {
    let Some(camera) = camera() else { return };
    let counts = check_features(bytes);
    assert_eq!(
        positions(bytes).map(|positions| positions.len()),
        counts.clone().map(|counts| counts.n_keypoints)
    );
    let settings = |pyramid| FeatureSettings { pinhole: camera.pinhole(), pyramid };
    let any = slam::features::PyramidGeometry { n_levels: 8, scale_factor: 1.2 };
    let found = decode_features(bytes, &camera, &settings(any));
    // Most inputs are of other settings: those they say are expected next.
    let found = match found {
        Ok(Err(other)) => decode_features(bytes, &camera, &settings(other.pyramid)),
        found => found,
    };
    if let Ok(Ok(features)) = found {
        assert!(counts.is_ok());
        assert!(check_features(&encode_features(&features)).is_ok());
    }
}
