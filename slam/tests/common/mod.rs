//! Rendered sequences through the engine, and lines held against the edges of their world.

use geometry::nalgebra::Vector3;
use slam::{FeatureSwitches, Frame, FrameReport, NoClock, Pipeline, ResumeState, SlamConfig, Threading};
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
