//! Whether sightings move through the images as they truly should.
//!
//! What hands the scale of a map on are landmarks that move through the image as the camera does.
//! Observations that run ahead of that motion, or lag behind it, by a thousandth make every step too long or
//! too short by as much.

use crate::recording::Recording;
use geometry::Pose;
use geometry::nalgebra::{Vector2, Vector3};
use slam::Map;
use slam::map::{Keyframe, LineLandmark, Observation, PointLandmark};
use std::collections::BTreeMap;
use synthetic::VisibleSegment;

/// A segment is of an edge no farther than this and turned no more than this against it.
const MAX_DISTANCE_PX: f64 = 1.5;
const MAX_ANGLE_DEG: f64 = 3.0;
/// Edges of less contrast than this, gray levels, are hidden in the noise.
const MIN_CONTRAST: f64 = 4.0;
/// Least share of a line's sightings that must be of the same edge.
const MIN_SHARE: f64 = 0.7;
/// Segments are compared with places this far past their ends, in lengths.
const MAX_PAST_END: f64 = 0.3;
/// Landmarks that should have moved less than this say nothing, pixels.
const MIN_MOTION_PX: f64 = 1.0;
/// Keypoints farther from their place than this are of something else, standard deviations.
const MAX_ERROR_SIGMAS: f64 = 5.0;
/// What surrounds a keypoint is looked at as far as this, pixels of its level, and flat if inverse depths
/// depart from those of a plane by less than this share.
const REACH_PX: f64 = 5.0;
const MAX_RELIEF: f64 = 0.002;

/// Of one sighting: how far it should have moved since the landmark was seen first, by the camera's way, and
/// how far ahead of that it lies; pixels. A camera that only turns moves nothing here.
struct Motion {
    true_px: f64,
    ahead_px: f64,
    sigma_px: f64,
}

/// Prints by how much the sightings of lines and points run ahead of their true motion.
pub fn print_flow(map: &Map, recording: &Recording) {
    let seen = |keyframe: &Keyframe| recording.visible_segments(keyframe.sequence as usize);
    let edges: Edges = map.keyframes().map(|keyframe| (keyframe.sequence, seen(keyframe))).collect();
    let lines =
        map.lines().flat_map(|line| motions_of_line(map, recording, &edges, line).unwrap_or_default());
    print_ratio("lines", lines);
    for (name, is_flat) in [("points on surfaces", true), ("points beside an edge of depth", false)] {
        let points = map.points().flat_map(|point| motions_of_point(map, recording, point, is_flat));
        print_ratio(name, points);
    }
}

/// The edges that each frame sees, by the frame's number.
type Edges = BTreeMap<u64, Vec<VisibleSegment>>;

fn print_ratio(name: &str, motions: impl Iterator<Item = Motion>) {
    let (mut n, mut product, mut square) = (0, 0.0, 0.0);
    for Motion { true_px, ahead_px, sigma_px } in motions.filter(|motion| motion.true_px > MIN_MOTION_PX) {
        let weight = sigma_px.powi(-2);
        n += 1;
        product += weight * true_px * ahead_px;
        square += weight * true_px * true_px;
    }
    println!(
        "{name}: {n} sightings, ahead of the true motion by {:+.2} thousandths, standard deviation {:.2}",
        1e3 * product / square,
        1e3 / square.sqrt()
    );
}

fn observations<'a>(
    map: &'a Map,
    observations: &'a [Observation],
) -> impl Iterator<Item = (&'a Keyframe, usize)> {
    observations.iter().filter_map(|seen| Some((map.keyframe(seen.keyframe)?, seen.feature_idx as usize)))
}

fn true_pose(recording: &Recording, keyframe: &Keyframe) -> Pose {
    recording.camera_from_world(keyframe.sequence as usize)
}

/// Where a keyframe sees a place, and where it would if its camera had only turned since `first`.
fn seen_and_turned(
    recording: &Recording,
    keyframe: &Keyframe,
    first: &Pose,
    place: &Vector3<f64>,
) -> [Vector2<f64>; 2] {
    let pose = true_pose(recording, keyframe);
    let turned = pose.rotation * (first.rotation.inverse() * first.transform(place));
    [pose.transform(place), turned].map(|in_camera| keyframe.features.pinhole.project(&in_camera))
}

/// Of the points that lie on a surface, or of those that do not: beside an edge of depth a keypoint is where
/// two things cross in the image as often as it is a place, and the ray may meet either.
fn motions_of_point(map: &Map, recording: &Recording, point: &PointLandmark, is_flat: bool) -> Vec<Motion> {
    let mut seen = observations(map, &point.observations);
    let Some((first, idx)) = seen.next() else { return Vec::new() };
    let bearing = first.features.pinhole.bearing(&first.features.undistorted[idx]);
    let Some(place) = recording.cast(first.sequence as usize, &bearing) else { return Vec::new() };
    if is_on_surface(recording, first, idx) != is_flat {
        return Vec::new();
    }
    let first = true_pose(recording, first);
    let motion = |(keyframe, idx): (&Keyframe, usize)| {
        let [here, turned] = seen_and_turned(recording, keyframe, &first, &place);
        let direction = (here - turned).try_normalize(1e-9)?;
        let error = keyframe.features.undistorted[idx] - here;
        let sigma_px = keyframe.features.pyramid.scale(keyframe.features.keypoints[idx].octave);
        let is_same = error.norm() < MAX_ERROR_SIGMAS * sigma_px;
        let true_px = (here - turned).norm();
        is_same.then(|| Motion { true_px, ahead_px: error.dot(&direction), sigma_px })
    };
    seen.filter_map(motion).collect()
}

/// Whether what surrounds a keypoint is flat: across a plane the inverse depth is linear.
fn is_on_surface(recording: &Recording, keyframe: &Keyframe, idx: usize) -> bool {
    let frame = keyframe.sequence as usize;
    let reach = REACH_PX * keyframe.features.pyramid.scale(keyframe.features.keypoints[idx].octave);
    let inverse_depth = |x: f64, y: f64| {
        let pixel = keyframe.features.undistorted[idx] + Vector2::new(x, y) * reach;
        let place = recording.cast(frame, &keyframe.features.pinhole.bearing(&pixel))?;
        Some(true_pose(recording, keyframe).transform(&place).z.recip())
    };
    let Some(own) = inverse_depth(0.0, 0.0) else { return false };
    [(1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7)].into_iter().all(|(x, y)| {
        let both = inverse_depth(x, y).zip(inverse_depth(-x, -y));
        both.is_some_and(|(a, b)| (a + b - 2.0 * own).abs() < MAX_RELIEF * own)
    })
}

/// `None` where the sightings are not of one edge.
fn motions_of_line(
    map: &Map,
    recording: &Recording,
    edges: &Edges,
    line: &LineLandmark,
) -> Option<Vec<Motion>> {
    let mut votes: BTreeMap<usize, usize> = BTreeMap::new();
    for (keyframe, idx) in observations(map, &line.observations) {
        let edge = edge_of(&edges[&keyframe.sequence], recording, keyframe, idx);
        edge.into_iter().for_each(|edge| *votes.entry(edge).or_default() += 1);
    }
    let (edge, n) = votes.into_iter().max_by_key(|(_, n)| *n)?;
    if (n as f64) < MIN_SHARE * line.observations.len() as f64 {
        return None;
    }
    let edge = &recording.world().segments()[edge];
    // The place on the edge that the first sighting's middle shows.
    let (first, idx) = observations(map, &line.observations).next()?;
    let middle = (first.features.lines[idx].start + first.features.lines[idx].end) / 2.0;
    let bearing = first.features.pinhole.bearing(&middle);
    let first = true_pose(recording, first);
    let bearing = first.rotation.inverse() * bearing;
    let place = nearest_to_ray(&edge.start, &(edge.end - edge.start), &first.center(), &bearing)?;
    let motion = |(keyframe, idx): (&Keyframe, usize)| {
        let segment = &keyframe.features.lines[idx];
        let [here, turned] = seen_and_turned(recording, keyframe, &first, &place);
        let along = (segment.end - segment.start).try_normalize(1e-9)?;
        let share = along.dot(&(here - segment.start)) / (segment.end - segment.start).norm();
        // Only what goes across the segment can be seen.
        let normal = Vector2::new(-along.y, along.x);
        let (moved, error) = (normal.dot(&(here - turned)), normal.dot(&(segment.start - here)));
        let is_same =
            (-MAX_PAST_END..=1.0 + MAX_PAST_END).contains(&share) && error.abs() < 2.0 * MAX_DISTANCE_PX;
        let sigma_px = segment.sigma_px;
        is_same.then(|| Motion { true_px: moved.abs(), ahead_px: moved.signum() * error, sigma_px })
    };
    Some(observations(map, &line.observations).filter_map(motion).collect())
}

/// The point of a line that comes nearest to a ray.
fn nearest_to_ray(
    start: &Vector3<f64>,
    direction: &Vector3<f64>,
    center: &Vector3<f64>,
    bearing: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let across = bearing.cross(&direction.cross(bearing));
    let slope = direction.dot(&across);
    (slope.abs() > 1e-9).then(|| start + direction * ((center - start).dot(&across) / slope))
}

/// The true edge that a segment is of.
fn edge_of(
    edges: &[VisibleSegment],
    recording: &Recording,
    keyframe: &Keyframe,
    idx: usize,
) -> Option<usize> {
    let segment = &keyframe.features.lines[idx];
    let pose = true_pose(recording, keyframe);
    let direction = (segment.end - segment.start).try_normalize(1e-9)?;
    let middle = (segment.start + segment.end) / 2.0;
    let distance = |edge: &VisibleSegment| {
        let project = |end: &Vector3<f64>| keyframe.features.pinhole.project(&pose.transform(end));
        let (start, end) = (project(&edge.ends_in_world[0]), project(&edge.ends_in_world[1]));
        let along = (end - start).try_normalize(1e-9)?;
        let sine = direction.x * along.y - direction.y * along.x;
        let share = (middle - start).dot(&along) / (end - start).norm();
        let distance = (along.x * (middle - start).y - along.y * (middle - start).x).abs();
        let is_beside = sine.abs() < MAX_ANGLE_DEG.to_radians().sin() && (0.0..=1.0).contains(&share);
        (is_beside && distance <= MAX_DISTANCE_PX).then_some((distance, edge.segment))
    };
    let visible = edges.iter().filter(|edge| edge.contrast >= MIN_CONTRAST);
    visible.filter_map(distance).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, edge)| edge)
}
