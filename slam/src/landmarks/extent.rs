//! Line extent: which part of an infinite line was observed. [method: Line extent]

use super::track_view::TrackView;
use geometry::Line3;
use geometry::nalgebra::{Vector2, Vector3};

/// A viewing ray closer to the line's direction than this cosine (10 degrees) says nothing about where on the
/// line its end is. Wider than the sensitivity test, which would otherwise never see the lines it is for.
const MAX_RAY_COSINE: f64 = 0.985;
/// Lines whose seen part is shorter than this share of their distance are points, not lines.
const MIN_LENGTH_SHARE: f64 = 0.01;

/// The ends of the part of a line that at least two views show, in the views' direction; `None` if there is
/// none, or if it lies behind a camera that sees it.
pub(crate) fn seen_part(line: &Line3, views: &[TrackView]) -> Option<[Vector3<f64>; 2]> {
    let (mut starts, mut ends) = (Vec::with_capacity(views.len()), Vec::with_capacity(views.len()));
    for view in views {
        let center = view.camera_from_world.center();
        let parameter = |pixel: &Vector2<f64>| {
            let ray = view.camera_from_world.rotation.inverse() * view.pinhole.bearing(pixel);
            let is_across = ray.dot(line.direction()).abs() <= MAX_RAY_COSINE;
            is_across.then(|| line.parameter_nearest_to_ray(&center, &ray)).flatten()
        };
        starts.extend(parameter(&view.segment.start));
        ends.extend(parameter(&view.segment.end));
    }
    let (start, end) = (agreed_end(&mut starts, 1.0)?, agreed_end(&mut ends, 1.0)?);
    // Of the two orders, the one the segments have.
    let (start, end) = if start <= end {
        (agreed_end(&mut starts, 1.0)?, agreed_end(&mut ends, -1.0)?)
    } else {
        (agreed_end(&mut starts, -1.0)?, agreed_end(&mut ends, 1.0)?)
    };
    let part = [line.at(start), line.at(end)];
    let is_seen = views.iter().all(|view| {
        let middle = view.camera_from_world.transform(&((part[0] + part[1]) / 2.0));
        middle.z > 0.0 && (part[1] - part[0]).norm() >= MIN_LENGTH_SHARE * middle.norm()
    });
    is_seen.then_some(part)
}

/// The outermost value that a second view confirms, in the ascending (`sense` > 0: the least) or descending
/// order.
fn agreed_end(values: &mut [f64], sense: f64) -> Option<f64> {
    values.sort_by(|a, b| (a * sense).total_cmp(&(b * sense)));
    values.get(1).or(values.first()).copied()
}
