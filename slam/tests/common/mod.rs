//! Rendered sequences through the engine, and its map held against the truth.

use geometry::Similarity;
use geometry::nalgebra::Vector3;
use slam::map::KeyframeId;
use slam::{FeatureSwitches, Frame, FrameReport, Map, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::sync::Arc;
use synthetic::Sequence;
use vision::GrayImage;

pub fn pipeline(sequence: &Sequence, features: FeatureSwitches, state: ResumeState) -> Pipeline {
    let config = SlamConfig { threading: Threading::Inline, seed: 3, features, ..SlamConfig::default() };
    Pipeline::resume(config, sequence.camera().clone(), Arc::new(NoClock), state).unwrap()
}

/// Renders frames and feeds them, each with its index as its number; every map on the way is checked.
pub fn run(
    pipeline: &mut Pipeline,
    sequence: &Sequence,
    frames: impl Iterator<Item = usize>,
) -> Vec<FrameReport> {
    let reports = frames
        .map(|index| {
            let rendered = sequence.frame(index).image;
            let image =
                GrayImage::from_raw(rendered.width(), rendered.height(), rendered.into_pixels()).unwrap();
            let timestamp_ns = index as i64 * 33_333_333;
            let report =
                pipeline.process_frame(Frame { sequence: index as u64, timestamp_ns, image }).unwrap();
            pipeline.take_updates().iter().for_each(|update| update.map.check().unwrap());
            report
        })
        .collect();
    pipeline.finish();
    reports
}

/// Takes the map to the true world: a similarity over the key frames' positions, with the mean of their attitudes.
pub fn truth_from_map(map: &Map, sequence: &Sequence) -> Similarity {
    let index: BTreeMap<KeyframeId, usize> =
        map.keyframes().map(|keyframe| (keyframe.id, keyframe.sequence as usize)).collect();
    let estimate: Vec<Vector3<f64>> =
        map.keyframes().map(|keyframe| keyframe.camera_from_world.centre()).collect();
    let truth: Vec<Vector3<f64>> =
        index.values().map(|index| sequence.camera_from_world(*index).centre()).collect();
    Similarity::from_correspondences(&estimate, &truth, true).unwrap()
}
