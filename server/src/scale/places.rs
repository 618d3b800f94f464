//! Scale from the distance between two places of a map.

use super::{Measurement, undetermined, working_factors};
use crate::error::{ApiError, ErrorCode};
use crate::options::working_camera;
use crate::session::SessionId;
use futures_util::TryStreamExt;
use geometry::nalgebra::{Vector2, Vector3};
use slam::map::{KeyframeId, LineId, LineLandmark, PointId, SubmapId};
use std::collections::BTreeSet;
use store::{KeyframeRecord, MeasuredKeyframe, Store};

/// How near a picked pixel must be to a point's keypoint, pixels of the session's image: a finger or a mouse
/// hits no better.
const MAX_POINT_PX: f64 = 12.0;
/// The same to a line's segment: lines are found first where both are near.
const MAX_LINE_PX: f64 = 4.0;
/// Smallest sine of the angle between a picked ray and a line that tells where on the line: 6 degrees.
const MIN_CROSSING_SINE: f64 = 0.1;

/// Two places of a map, and how far apart they are.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownDistance {
    /// The one.
    pub from: ScalePlace,
    /// The other.
    pub to: ScalePlace,
    /// Metres between them.
    pub metres: f64,
}

/// A place of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScalePlace {
    /// A point.
    Point(PointId),
    /// Where a keyframe's camera was.
    Keyframe(KeyframeId),
    /// What a pixel of a keyframe's image shows.
    Pixel {
        /// The keyframe.
        keyframe: KeyframeId,
        /// The pixel, of the session's image size.
        pixel: [f64; 2],
    },
}

/// A place that was found.
struct Place {
    position: Vector3<f64>,
    submap: SubmapId,
    what: String,
}

pub(super) async fn measure(
    store: &Store,
    id: &SessionId,
    known: &KnownDistance,
) -> Result<Measurement, ApiError> {
    if !(known.metres.is_finite() && known.metres > 0.0) {
        return Err(ApiError::invalid("distance.metres", "must be a number above 0"));
    }
    let from = place(store, id, &known.from, "distance.from").await?;
    let to = place(store, id, &known.to, "distance.to").await?;
    if from.submap != to.submap {
        return Err(undetermined(format!(
            "{} is in submap {} and {} in submap {}, and nothing is known of how they lie to each other; choose two \
             places of one submap",
            from.what, from.submap, to.what, to.submap
        )));
    }
    let distance = (from.position - to.position).norm();
    let metres_per_unit = known.metres / distance;
    if !(metres_per_unit.is_finite() && distance > 0.0) {
        return Err(undetermined("the two places are one and the same in the map"));
    }
    Ok(Measurement {
        metres_per_unit,
        map_distance: Some(distance),
        places: vec![from.what, to.what],
        residuals: Vec::new(),
        rms_m: None,
        n_used: 0,
        reference_from_map: None,
        submap: from.submap.0,
    })
}

async fn place(store: &Store, id: &SessionId, place: &ScalePlace, field: &str) -> Result<Place, ApiError> {
    match place {
        ScalePlace::Point(point) => {
            let found = point_place(store, id, *point).await?;
            found.ok_or_else(|| ApiError::invalid(field, format!("the map has no point {point}")))
        }
        ScalePlace::Keyframe(keyframe) => {
            let record = keyframe_record(store, id, *keyframe).await?;
            let (position, submap) = (record.camera_from_world.center(), record.submap);
            Ok(Place { position, submap, what: format!("the camera at keyframe {keyframe}") })
        }
        ScalePlace::Pixel { keyframe, pixel } => picked(store, id, *keyframe, *pixel, field).await,
    }
}

async fn keyframe_record(
    store: &Store,
    id: &SessionId,
    keyframe: KeyframeId,
) -> Result<KeyframeRecord, ApiError> {
    store.keyframe(id.as_str(), keyframe).await?.ok_or_else(|| {
        let sentence = format!("session {id} has no keyframe {keyframe}");
        ApiError::new(ErrorCode::KeyframeNotFound, sentence)
    })
}

async fn point_place(store: &Store, id: &SessionId, point: PointId) -> Result<Option<Place>, ApiError> {
    let mut found = store.points_of(id.as_str(), &BTreeSet::from([point])).await?;
    let found = found.try_next().await?;
    Ok(found.map(|found| Place {
        position: found.position,
        submap: found.submap,
        what: format!("point {point}"),
    }))
}

/// What a pixel shows: a line where one is hit, else the nearest point.
async fn picked(
    store: &Store,
    id: &SessionId,
    keyframe: KeyframeId,
    pixel: [f64; 2],
    field: &str,
) -> Result<Place, ApiError> {
    let field = format!("{field}.pixel");
    if !pixel.iter().all(|length| length.is_finite()) {
        return Err(ApiError::invalid(field, "must be two finite numbers"));
    }
    let session = store.record_of_keyframe(id.as_str(), keyframe).await?;
    let working = working_camera(&session)?.with_correction(session.correction);
    let record = keyframe_record(store, id, keyframe).await?;
    let measured = store.measured_keyframe(id.as_str(), keyframe).await?;
    let measured = measured.ok_or_else(|| ApiError::internal("a keyframe has no features"))?;
    let factors = working_factors(&session.camera, &working);
    // Pixel centers are at integers.
    let at: [f64; 2] = std::array::from_fn(|axis| (pixel[axis] + 0.5) * factors[axis] - 0.5);
    let at = Vector2::from(at);
    let factor = factors[0];
    if let Some(line) = nearest_line(&measured, &at, &working, MAX_LINE_PX * factor) {
        let mut lines = store.lines_of(id.as_str(), &BTreeSet::from([line])).await?;
        let found = lines.try_next().await?;
        let ray = working.unproject(&at).map(|ray| record.camera_from_world.rotation.inverse() * ray);
        let center = record.camera_from_world.center();
        let hit = found.zip(ray).and_then(|(line, ray)| hit(&line, &center, &ray));
        if let Some(position) = hit {
            let what = format!("line {line} where keyframe {keyframe} shows it");
            return Ok(Place { position, submap: record.submap, what });
        }
    }
    if let Some(point) = nearest_point(&measured, &at, MAX_POINT_PX * factor)
        && let Some(place) = point_place(store, id, point).await?
    {
        return Ok(place);
    }
    let [x, y] = pixel;
    Err(ApiError::invalid(
        field,
        format!(
            "the map knows nothing at ({x:.1}, {y:.1}) of keyframe {keyframe}: pick a corner that is a point of the map, \
             within {MAX_POINT_PX} pixels, or an edge that is a line of it, within {MAX_LINE_PX}"
        ),
    ))
}

fn nearest_point(measured: &MeasuredKeyframe, at: &Vector2<f64>, max_px: f64) -> Option<PointId> {
    let seen = measured.keypoints.iter().zip(&measured.points);
    let distances = seen.filter_map(|([x, y], point)| {
        let distance = (Vector2::new(f64::from(*x), f64::from(*y)) - at).norm();
        Some((distance, (*point)?)).filter(|(distance, _)| *distance <= max_px)
    });
    distances.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, point)| point)
}

fn nearest_line(
    measured: &MeasuredKeyframe,
    at: &Vector2<f64>,
    working: &geometry::Camera,
    max_px: f64,
) -> Option<LineId> {
    // Segments are stored without the lens's distortion, as the calibration alone has it.
    let nominal = working.with_correction(geometry::CameraCorrection::default());
    let at = nominal.undistort(at)?;
    let seen = measured.segments.iter().zip(&measured.lines);
    let distances = seen.filter_map(|(segment, line)| {
        let along = segment.end - segment.start;
        let share = ((at - segment.start).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        let distance = (segment.start + along * share - at).norm();
        Some((distance, (*line)?)).filter(|(distance, _)| *distance <= max_px)
    });
    distances.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, line)| line)
}

/// The place on a line that is nearest to a ray, if the two cross well enough to tell.
fn hit(line: &LineLandmark, center: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Vector3<f64>> {
    let [start, end] = line.endpoints;
    let (along, ray) = ((end - start).try_normalize(0.0)?, ray.try_normalize(0.0)?);
    let cosine = along.dot(&ray);
    let squared_sine = 1.0 - cosine * cosine;
    if squared_sine < MIN_CROSSING_SINE * MIN_CROSSING_SINE {
        return None;
    }
    let between = start - center;
    let depth = (between.dot(&ray) - cosine * between.dot(&along)) / squared_sine;
    let position = start + along * ((cosine * between.dot(&ray) - between.dot(&along)) / squared_sine);
    (depth > 0.0).then_some(position)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Line3;

    fn edge() -> LineLandmark {
        let (start, end) = (Vector3::new(-1.0, 0.0, 2.0), Vector3::new(1.0, 0.0, 4.0));
        LineLandmark {
            id: LineId::new(1).unwrap(),
            submap: SubmapId(0),
            line: Line3::from_points(&start, &end).unwrap(),
            endpoints: [start, end],
            descriptor: vision::Descriptor::default(),
            created_by: KeyframeId::new(1).unwrap(),
            observations: Vec::new(),
            n_visible: 0,
            n_found: 0,
            primitive: None,
        }
    }

    #[test]
    fn a_ray_hits_a_line_where_it_passes_and_not_behind_or_along() {
        let center = Vector3::new(0.5, -1.0, 0.0);
        let target = Vector3::new(0.25, 0.0, 3.25);
        let found = hit(&edge(), &center, &(target - center)).unwrap();
        assert!((found - target).norm() < 1e-12, "{found}");
        assert!(hit(&edge(), &center, &(center - target)).is_none(), "behind the camera");
        assert!(hit(&edge(), &center, &Vector3::new(1.0, 0.01, 1.0)).is_none(), "along the line");
    }
}
