//! How far detected segments lie from the true edges, by how near the next edge is.

use crate::recording::Recording;
use geometry::nalgebra::Vector2;
use std::error::Error;
use vision::lines::{Segment, SegmentDetector};

/// Every so many frames are looked at.
const EVERY: usize = 10;
/// A segment is of an edge no farther than this and turned no more than this against it.
const MAX_DISTANCE_PX: f64 = 1.5;
const MAX_ANGLE_DEG: f64 = 3.0;
/// Edges of less contrast than this, gray levels, are hidden in the noise.
const MIN_CONTRAST: f64 = 4.0;
/// Bounds of the table's rows: distance of the next edge beside, pixels.
const GAPS_PX: [f64; 8] = [0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 10.0, f64::INFINITY];

/// A true edge without lens distortion.
struct Edge {
    start: Vector2<f64>,
    end: Vector2<f64>,
}

/// Prints a table of how far segments lie towards their brighter side of the edges they are of.
pub fn print_offsets(
    recording: &Recording,
    detector: &mut dyn SegmentDetector,
    n_frames: usize,
) -> Result<(), Box<dyn Error>> {
    let mut offsets: [Vec<f64>; GAPS_PX.len() - 1] = Default::default();
    for index in (0..n_frames).step_by(EVERY) {
        let edges = recording.edges(index, MIN_CONTRAST);
        let edges: Vec<Edge> = edges.into_iter().map(|[start, end]| Edge { start, end }).collect();
        for segment in detector.detect(&recording.image(index)?) {
            let Some((offset, gap)) = offset(recording, &segment, &edges) else { continue };
            let row = GAPS_PX.windows(2).position(|bounds| (bounds[0]..bounds[1]).contains(&gap));
            offsets[row.unwrap_or(offsets.len() - 1)].push(offset);
        }
    }
    println!(
        "| next edge, px | segments | mean offset, px | median | median deviation | nine of ten within |"
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: |");
    for (row, offsets) in offsets.iter_mut().enumerate().filter(|(_, offsets)| !offsets.is_empty()) {
        let n = offsets.len();
        let mean = offsets.iter().sum::<f64>() / n as f64;
        offsets.sort_by(f64::total_cmp);
        let median = offsets[n / 2];
        let mut absolute: Vec<f64> = offsets.iter().map(|offset| offset.abs()).collect();
        absolute.sort_by(f64::total_cmp);
        let mut deviations: Vec<f64> = offsets.iter().map(|offset| (offset - median).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        println!(
            "| {}–{} | {n} | {mean:+.3} | {median:+.3} | {:.3} | {:.3} |",
            GAPS_PX[row],
            GAPS_PX[row + 1],
            deviations[n / 2],
            absolute[n * 9 / 10]
        );
    }
    Ok(())
}

/// How far a segment lies towards its brighter side of the edge it is of, and how far the next edge beside
/// that is.
fn offset(recording: &Recording, segment: &Segment, edges: &[Edge]) -> Option<(f64, f64)> {
    let undistort = |end: Vector2<f32>| recording.camera().undistort(&end.cast());
    let (start, end) = (undistort(segment.start)?, undistort(segment.end)?);
    let direction = (end - start).try_normalize(1e-9)?;
    let normal = Vector2::new(-direction.y, direction.x);
    let middle = (start + end) / 2.0;
    // The brighter side is where the normal points; an edge's distance along it, if it runs beside the
    // segment.
    let beside = |edge: &Edge| {
        let along = (edge.end - edge.start).try_normalize(1e-9)?;
        let sine = direction.x * along.y - direction.y * along.x;
        let share = (middle - edge.start).dot(&along) / (edge.end - edge.start).norm();
        let runs_beside = sine.abs() < MAX_ANGLE_DEG.to_radians().sin() && (0.0..=1.0).contains(&share);
        let foot = edge.start + along * along.dot(&(middle - edge.start));
        runs_beside.then(|| normal.dot(&(foot - middle)))
    };
    let mut distances: Vec<f64> = edges.iter().filter_map(beside).collect();
    distances.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let own = *distances.first().filter(|own| own.abs() <= MAX_DISTANCE_PX)?;
    // Edges in one place are one edge, of two faces that meet there.
    let gaps = distances[1..].iter().map(|other| (other - own).abs()).filter(|gap| *gap > 0.3);
    Some((-own, gaps.fold(f64::INFINITY, f64::min)))
}
