//! Recognized places against the truth.

use crate::recording::Recording;
use geometry::nalgebra::Vector3;
use slam::{FrameReport, Map, MapEvent};

/// How far apart the two views of a recognized place really are.
pub fn truth_of(event: &MapEvent, map: &Map, recording: &Recording) -> String {
    let Some((keyframe, matched)) = event.keyframes() else { return String::new() };
    let pose = |id| Some(recording.camera_from_world(map.keyframe(id)?.sequence as usize));
    let Some((a, b)) = pose(keyframe).zip(pose(matched)) else { return "culled since".to_owned() };
    let angle_deg = a.rotation.angle_to(&b.rotation).to_degrees();
    format!("truly {:.2} and {angle_deg:.1} deg apart", (a.center() - b.center()).norm())
}

/// How far the camera truly is from the keyframe that it was found beside.
pub fn truth_of_place(report: &FrameReport, map: &Map, recording: &Recording, index: usize) -> String {
    let Some(world_from_camera) = report.world_from_camera else { return String::new() };
    let distance = |center: Vector3<f64>| (center - world_from_camera.translation).norm();
    let beside = map
        .keyframes_of(report.submap)
        .map(|keyframe| (distance(keyframe.camera_from_world.center()), keyframe.sequence as usize))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, beside)) = beside else { return String::new() };
    let truth = |index: usize| recording.camera_from_world(index).center();
    let n_inliers = report.n_inlier_points + report.n_inlier_lines;
    format!(
        "by {n_inliers} landmarks beside frame {beside}, truly {:.2} apart",
        (truth(index) - truth(beside)).norm()
    )
}
