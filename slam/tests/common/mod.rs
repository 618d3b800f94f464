//! Rendered sequences through the engine, and its map held against the truth.

use geometry::Similarity;
use geometry::nalgebra::Vector3;
use slam::map::SubmapId;
use slam::{FeatureSwitches, Frame, FrameReport, Map, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
use std::collections::BTreeMap;
use std::sync::Arc;
use synthetic::{Sequence, World};
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

/// The submap with the most key frames.
pub fn largest_submap(map: &Map) -> Option<SubmapId> {
    let mut sizes: BTreeMap<SubmapId, usize> = BTreeMap::new();
    map.keyframes().for_each(|keyframe| *sizes.entry(keyframe.submap).or_default() += 1);
    sizes.into_iter().max_by_key(|(_, size)| *size).map(|(submap, _)| submap)
}

/// Takes the map's largest submap to the true world: a similarity over the key frames' positions. `None` if there are too
/// few of them or they lie on a straight line.
pub fn truth_from_map(map: &Map, sequence: &Sequence) -> Option<Similarity> {
    let submap = largest_submap(map)?;
    let keyframes = || map.keyframes().filter(|keyframe| keyframe.submap == submap);
    let estimate: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| keyframe.camera_from_world.centre()).collect();
    let truth: Vec<Vector3<f64>> =
        keyframes().map(|keyframe| sequence.camera_from_world(keyframe.sequence as usize).centre()).collect();
    Similarity::from_correspondences(&estimate, &truth, true)
}

/// How far a line is from an edge of the world.
#[derive(Clone, Copy, Debug)]
pub struct LineError {
    pub angle_deg: f64,
    /// Of the line's middle from the edge, which is where it ends, world units.
    pub distance: f64,
}

/// The error of a line, given by its ends in the true world, against the nearest edge that runs within 10 degrees of it;
/// `None` if there is no such edge.
pub fn line_error(ends: &[Vector3<f64>; 2], world: &World) -> Option<LineError> {
    const MAX_ANGLE_DEG: f64 = 10.0;
    let direction = (ends[1] - ends[0]).normalize();
    let middle = (ends[0] + ends[1]) / 2.0;
    let errors = world.segments().iter().map(|edge| {
        let vector = edge.end - edge.start;
        let along = vector.normalize();
        let angle_deg = along.cross(&direction).norm().atan2(along.dot(&direction).abs()).to_degrees();
        let nearest = edge.start + along * (middle - edge.start).dot(&along).clamp(0.0, vector.norm());
        LineError { angle_deg, distance: (middle - nearest).norm() }
    });
    errors.filter(|error| error.angle_deg < MAX_ANGLE_DEG).min_by(|a, b| a.distance.total_cmp(&b.distance))
}
