//! Primitives, vanishing points and their segments against the true directions.

use crate::recording::Recording;
use geometry::Direction;
use geometry::nalgebra::Vector3;
use slam::Map;
use slam::map::{Keyframe, VanishingObservation};
use std::collections::BTreeMap;
use testkit::laboratory::summary;

/// How the primitives and the vanishing points of the keyframes lie to the true directions.
pub fn print_primitives(map: &Map, recording: &Recording) {
    let truths = recording.world().vanishing_directions();
    let nearest = |direction: &Vector3<f64>| {
        let angle = |truth: &Direction| {
            truth.as_vector().cross(direction).norm().atan2(truth.as_vector().dot(direction).abs())
        };
        let angles = truths.iter().enumerate().map(|(idx, truth)| (angle(truth).to_degrees(), idx));
        angles.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NAN, 0))
    };
    let truth = |keyframe: &Keyframe| recording.camera_from_world(keyframe.sequence as usize).rotation;
    for primitive in map.primitives() {
        // Per sighting: the primitive in the true world by the attitude the keyframe has and should have.
        let errors: Vec<(f64, usize)> = primitive
            .observations
            .iter()
            .filter_map(|seen| map.keyframe(seen.keyframe))
            .map(|keyframe| {
                let world_from_map = truth(keyframe).inverse() * keyframe.camera_from_world.rotation;
                nearest(&(world_from_map * primitive.direction.as_vector()))
            })
            .collect();
        let (first, last) = (primitive.observations.first(), primitive.observations.last());
        let n_segments: usize = primitive
            .observations
            .iter()
            .filter_map(|seen| {
                Some(map.keyframe(seen.keyframe)?.vanishing[seen.vanishing_idx as usize].segments.len())
            })
            .sum();
        println!(
            "primitive {}: {} keyframes {:?}-{:?}, {n_segments} segments, {} lines, true direction {:?}, off by {}",
            primitive.id,
            primitive.observations.len(),
            first.map(|seen| seen.keyframe.get()),
            last.map(|seen| seen.keyframe.get()),
            map.lines_of_primitive(primitive.id).len(),
            errors.first().map(|error| error.1),
            summary(&mut errors.iter().map(|error| error.0).collect::<Vec<_>>()),
        );
    }
    let (mut errors, mut n_wrong) = (Vec::new(), 0);
    for keyframe in map.keyframes() {
        let in_world = |vanishing: &VanishingObservation| truth(keyframe).inverse() * vanishing.direction;
        for vanishing in keyframe.vanishing.iter().filter(|vanishing| vanishing.primitive.is_some()) {
            match nearest(&in_world(vanishing)).0 {
                error if error < 5.0 => errors.push(error),
                _ => n_wrong += 1,
            }
        }
    }
    println!(
        "vanishing points: {} of a true direction, off by {} deg; {n_wrong} of none",
        errors.len(),
        summary(&mut errors)
    );
}

/// How far the segments of primitives point past their true vanishing points, in their standard deviations,
/// which is 1 in the median absolute deviation if those are right.
pub fn print_segments(map: &Map, recording: &Recording) {
    let truths = recording.world().vanishing_directions();
    let mut by_truth: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for keyframe in map.keyframes() {
        let pose = recording.camera_from_world(keyframe.sequence as usize);
        for vanishing in keyframe.vanishing.iter().filter(|vanishing| vanishing.primitive.is_some()) {
            let angle =
                |truth: &Direction| (pose.rotation * truth.as_vector()).cross(&vanishing.direction).norm();
            let nearest = truths.iter().enumerate().min_by(|a, b| angle(a.1).total_cmp(&angle(b.1)));
            let Some((idx, truth)) = nearest.filter(|(_, truth)| angle(truth) < 0.1) else { continue };
            for segment in vanishing.segments.iter().map(|idx| &keyframe.features.lines[*idx as usize]) {
                let middle = (segment.start + segment.end) / 2.0;
                let middle = Vector3::new(middle.x, middle.y, 1.0);
                let end = Vector3::new(segment.end.x, segment.end.y, 1.0);
                let line =
                    middle.cross(&(keyframe.features.pinhole.matrix() * (pose.rotation * truth.as_vector())));
                let distance = line.dot(&end) / line.xy().norm();
                by_truth.entry(idx).or_default().push(distance.abs() / segment.sigma_px);
            }
        }
    }
    for (idx, mut sigmas) in by_truth {
        let n = sigmas.len();
        sigmas.sort_by(f64::total_cmp);
        let at = |share: f64| sigmas[(n as f64 * share) as usize];
        println!(
            "segments of direction {idx}: {n}, off by {:.2} sigma (median / 0.6745), p90 {:.2}, p97 {:.2}",
            at(0.5) / 0.6745,
            at(0.9),
            at(0.97)
        );
    }
}
