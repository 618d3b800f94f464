//! Noise of a primitive's segments: how far the edges of one direction are from parallel.
//!
//! Rendered edges miss their vanishing point by a quarter of what their segments' deviations allow, those of
//! buildings and furniture by up to four times as much. Trusted alike, the latter bend the map to suit
//! themselves.

use super::factors::VanishingReprojectionFactor;
use crate::config::PrimitiveConfig;
use crate::map::{GlobalPrimitive, Map, PrimitiveObservation};
use optim::Factor;

/// The median of the absolute value of a normal distribution, in standard deviations.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// What the standard deviations of a primitive's segments count for, as a multiple of what they are as
/// segments: more where the segments that show it scatter more.
pub(crate) fn segment_sigma_factor(map: &Map, primitive: &GlobalPrimitive, config: &PrimitiveConfig) -> f64 {
    let newest = primitive.observations.iter().rev().take(config.max_keyframes_of_scatter);
    let mut misses: Vec<f64> = newest.flat_map(|seen| misses(map, primitive, seen)).collect();
    if misses.is_empty() {
        return config.segment_sigma_factor;
    }
    let middle = misses.len() / 2;
    let scatter = *misses.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN_OF_NORMAL;
    config.segment_sigma_factor.max(config.scatter_sigma_factor * scatter)
}

/// By how many standard deviations each segment of a sighting misses the primitive's vanishing point.
fn misses(map: &Map, primitive: &GlobalPrimitive, seen: &PrimitiveObservation) -> Vec<f64> {
    let Some(keyframe) = map.keyframe(seen.keyframe) else { return Vec::new() };
    let Some(vanishing) = keyframe.vanishing.get(seen.vanishing_idx as usize) else { return Vec::new() };
    let miss = |idx: &u32| {
        let segment = keyframe.features.lines.get(*idx as usize)?;
        let factor = VanishingReprojectionFactor::of(keyframe.features.pinhole, segment, 1.0);
        Some(factor.residual((&keyframe.camera_from_world, &primitive.direction))?.x.abs())
    };
    vanishing.segments.iter().filter_map(miss).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{FrameFeatures, LineFeature};
    use crate::map::{Keyframe, KeyframeId, SubmapId, VanishingObservation};
    use crate::test_fixtures::{camera, pyramid};
    use geometry::nalgebra::{Matrix3, Vector2, Vector3};
    use geometry::{Direction, Pose};
    use std::sync::Arc;
    use vision::Descriptor;

    const N_SEGMENTS: u32 = 20;
    const SIGMA_PX: f64 = 0.4;

    /// Segments across the image whose ends are `off_sigmas` beside where lines along x would have them.
    fn features(off_sigmas: f64) -> FrameFeatures {
        let mut features = FrameFeatures::from_parts(Vec::new(), Vec::new(), &camera(), pyramid()).unwrap();
        let off = Vector2::new(0.0, off_sigmas * SIGMA_PX);
        let segment = |idx: u32| {
            let [start, end] = [100.0, 300.0].map(|x| Vector2::new(x, 20.0 * f64::from(idx)));
            let (descriptor, track) = (Descriptor::default(), u64::from(idx));
            LineFeature { start: start - off, end: end + off, sigma_px: SIGMA_PX, descriptor, track }
        };
        features.lines = (0..N_SEGMENTS).map(segment).collect();
        features
    }

    /// The factor of a primitive along x that keyframes show one after the other, each with ends as far off
    /// as is said.
    fn factor(off_sigmas: &[f64], config: &PrimitiveConfig) -> f64 {
        let mut map = Map::default();
        let (along, covariance) = (Vector3::x(), Matrix3::identity() * 1e-4);
        let vanishing = VanishingObservation {
            direction: along,
            covariance,
            segments: (0..N_SEGMENTS).collect(),
            primitive: None,
        };
        let id = |idx: usize| KeyframeId::new(idx as u64 + 1).unwrap();
        let direction = Direction::new(along).unwrap();
        let primitive = map.add_primitive(SubmapId(0), direction, covariance, id(0)).unwrap();
        for (idx, off_sigmas) in off_sigmas.iter().enumerate() {
            let parent = idx.checked_sub(1).map(id);
            let features = Arc::new(features(*off_sigmas));
            let pose = Pose::identity();
            map.add_keyframe(Keyframe::from_parts(id(idx), SubmapId(0), 0, 0, pose, features, parent));
            map.set_vanishing(id(idx), vec![vanishing.clone()]);
            map.add_primitive_observation(
                primitive,
                PrimitiveObservation { keyframe: id(idx), vanishing_idx: 0 },
            );
        }
        segment_sigma_factor(&map, map.primitive(primitive).unwrap(), config)
    }

    #[test]
    fn segments_count_for_less_the_more_they_scatter() {
        let config = PrimitiveConfig::default();
        assert_eq!(factor(&[], &config), config.segment_sigma_factor, "nothing is known yet");
        assert_eq!(factor(&[0.0, 0.0], &config), config.segment_sigma_factor, "better than is measured");
        // Off by two deviations is what the median is of a scatter of 2 / 0.6745.
        let expected = config.scatter_sigma_factor * 2.0 / MEDIAN_OF_NORMAL;
        let scattered = factor(&[2.0, 2.0], &config);
        assert!((scattered - expected).abs() < 0.01 * expected, "{scattered} {expected}");
    }

    #[test]
    fn the_newest_key_frames_tell_the_scatter_and_outliers_do_not() {
        let config = PrimitiveConfig { max_keyframes_of_scatter: 3, ..PrimitiveConfig::default() };
        assert_eq!(factor(&[9.0, 9.0, 0.0, 0.0, 9.0], &config), config.segment_sigma_factor);
        assert!(factor(&[0.0, 0.0, 9.0, 9.0, 0.0], &config) > 10.0 * config.segment_sigma_factor);
    }
}
