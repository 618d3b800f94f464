//! Single frames looked for in a finished map, as a client's `Localize` does.

use crate::recording::Recording;
use geometry::Similarity;
use slam::{Frame, Map, Pipeline, ResumeState, SlamConfig, Threading};
use std::error::Error;
use std::sync::Arc;
use testkit::laboratory::{WallClock, summary};
use vision::GrayImage;

/// Every this many frames one is looked for.
const INTERVAL: usize = 10;

/// Looks for frames whose contrast is this many times that of the recording, and prints how many are found
/// and how far they are from the truth.
pub fn print_relocalized(
    map: &Map,
    recording: &Recording,
    config: &SlamConfig,
    contrast: f64,
) -> Result<(), Box<dyn Error>> {
    let (mut centers, mut truths) = (Vec::new(), Vec::new());
    for keyframe in map.keyframes() {
        centers.push(keyframe.camera_from_world.center());
        truths.push(recording.camera_from_world(keyframe.sequence as usize).center());
    }
    let truth_from_map =
        Similarity::from_correspondences(&centers, &truths, true).ok_or("the map is too small")?;
    let config = SlamConfig { threading: Threading::Inline, ..config.clone() };
    let (mut n_tried, mut errors, mut times_ms) = (0, Vec::new(), Vec::new());
    for index in (0..recording.len()).step_by(INTERVAL) {
        let image = recording.image(index)?;
        let image = GrayImage::from_fn(image.width(), image.height(), |x, y| {
            let gray = f64::from(image.get(x, y).unwrap_or(0));
            (128.0 + contrast * (gray - 128.0)).round() as u8
        });
        let state = ResumeState { map: map.to_parts(), last_frame: None, mask: None };
        let clock = Arc::new(WallClock::start());
        let mut pipeline = Pipeline::resume(config.clone(), recording.camera().clone(), clock, state)?;
        pipeline.set_mapping(false);
        let timestamp_ns = recording.timestamp_ns(index);
        let report = pipeline.process_frame(Frame { sequence: 0, timestamp_ns, image })?;
        n_tried += 1;
        times_ms.push(report.wall_ns as f64 * 1e-6);
        if let Some(world_from_camera) = report.world_from_camera {
            let center = truth_from_map.transform(&world_from_camera.translation);
            errors.push((center - recording.camera_from_world(index).center()).norm());
        }
    }
    println!(
        "relocalised {} of {n_tried} frames at contrast {contrast}: off by {}, ms {}",
        errors.len(),
        summary(&mut errors),
        summary(&mut times_ms)
    );
    Ok(())
}
