//! Messages of what is asked of stored maps and done to them: scale, single images, operations.

use super::convert::{camera, camera_parameters, frame_result, image_to_locate, ms, pose};
use crate::access::Caller;
use crate::error::ApiError;
use crate::ids::checked_id;
use crate::localization::{AskedCamera, Located, MAX_SESSIONS, Question};
use crate::model::Pose;
use crate::operations::{Kind, Operation, Outcome, State};
use crate::scale::{
    KnownDistance, Measurement, ReferencePositions, ReferenceRow, ScalePlace, ScaleSource, When,
};
use crate::session::SessionId;
use proto::v1;
use proto::v1::operation::Result as OperationResult;
use proto::v1::reference_position::Frame;
use proto::v1::scale_place::Place;
use proto::v1::set_scale_request::Reference;

pub(super) fn scale_source(request: v1::SetScaleRequest) -> Result<ScaleSource, ApiError> {
    let v1::SetScaleRequest { session_id: _, metres_per_unit, reference } = request;
    match (metres_per_unit, reference) {
        (Some(_), Some(_)) => {
            let sentence = "is given beside a reference that it would be found from; leave one out";
            Err(ApiError::invalid("metres_per_unit", sentence))
        }
        (Some(metres), None) => Ok(ScaleSource::Given(metres)),
        (None, None) => Ok(ScaleSource::Free),
        (None, Some(Reference::Distance(known))) => {
            let from = place(known.from, "distance.from")?;
            let to = place(known.to, "distance.to")?;
            Ok(ScaleSource::Distance(KnownDistance { from, to, metres: known.metres }))
        }
        (None, Some(Reference::Positions(positions))) => {
            let rows = positions.rows.into_iter().enumerate().map(|(idx, row)| reference_row(idx, row));
            let (rows, max_error_m) = (rows.collect::<Result<_, _>>()?, positions.max_error_m);
            Ok(ScaleSource::Positions(ReferencePositions { rows, max_error_m }))
        }
    }
}

fn place(place: Option<v1::ScalePlace>, field: &str) -> Result<ScalePlace, ApiError> {
    let place = place.and_then(|place| place.place);
    match place.ok_or_else(|| ApiError::invalid(field, "must be a point, a key frame or a pixel"))? {
        Place::PointId(id) => Ok(ScalePlace::Point(checked_id(&format!("{field}.point_id"), id)?)),
        Place::KeyframeId(id) => Ok(ScalePlace::Keyframe(checked_id(&format!("{field}.keyframe_id"), id)?)),
        Place::Pixel(v1::PickedPixel { keyframe_id, x, y }) => Ok(ScalePlace::Pixel {
            keyframe: checked_id(&format!("{field}.pixel.keyframe_id"), keyframe_id)?,
            pixel: [x, y],
        }),
    }
}

fn reference_row(idx: usize, row: v1::ReferencePosition) -> Result<ReferenceRow, ApiError> {
    let missing = |part: &str, what: &str| ApiError::invalid(format!("positions.rows[{idx}].{part}"), what);
    let when = match row.frame {
        Some(Frame::Sequence(sequence)) => When::Sequence(sequence),
        Some(Frame::TimestampNs(time)) => When::Timestamp(time),
        None => return Err(missing("sequence", "or timestamp_ns must say which frame it is of")),
    };
    let v1::Vector3 { x, y, z } = row.position.ok_or_else(|| missing("position", "is needed"))?;
    Ok(ReferenceRow { when, position: [x, y, z] })
}

pub(super) fn measurement(measured: Measurement) -> v1::ScaleMeasurement {
    let residual = |residual: crate::scale::Residual| v1::ScaleResidual {
        error_m: residual.error_m,
        used: residual.used,
        reason: residual.reason,
    };
    v1::ScaleMeasurement {
        metres_per_unit: measured.metres_per_unit,
        map_distance: measured.map_distance,
        places: measured.places,
        residuals: measured.residuals.into_iter().map(residual).collect(),
        rms_m: measured.rms_m,
        n_used: measured.n_used,
        pose_reference_from_map: measured.reference_from_map.as_ref().map(|found| pose(Pose::from(found))),
        submap_id: measured.submap,
    }
}

/// The sessions a request names.
pub(super) fn sessions(caller: &Caller, request: &v1::LocalizeRequest) -> Result<Vec<SessionId>, ApiError> {
    if request.session_ids.is_empty() {
        return Ok(vec![caller.session(&request.session_id, "session_id")?]);
    }
    if !request.session_id.is_empty() {
        return Err(ApiError::invalid("session_id", "is given beside session_ids; leave one out"));
    }
    if request.session_ids.len() > MAX_SESSIONS {
        return Err(ApiError::invalid("session_ids", format!("must be at most {MAX_SESSIONS}")));
    }
    request.session_ids.iter().map(|id| caller.session(id, "session_ids")).collect()
}

pub(super) fn localize(sessions: Vec<SessionId>, request: v1::LocalizeRequest) -> Result<Question, ApiError> {
    let v1::LocalizeRequest { image, camera, fov_deg, unknown_camera, near, radius, .. } = request;
    let camera = match (camera, fov_deg, unknown_camera) {
        (None, None, false) => AskedCamera::Unsaid,
        (Some(camera), None, false) => AskedCamera::Given(camera_parameters(camera)?),
        (None, Some(degrees), false) => AskedCamera::FieldOfView(degrees),
        (None, None, true) => AskedCamera::Unknown,
        _ => {
            let sentence = "a camera, fov_deg and unknown_camera exclude each other";
            return Err(ApiError::invalid("camera", sentence));
        }
    };
    let near = match (near, radius) {
        (None, None) => None,
        (Some(v1::Vector3 { x, y, z }), Some(radius)) => Some(checked_near([x, y, z], radius)?),
        (Some(_), None) => return Err(ApiError::invalid("radius", "is needed with near")),
        (None, Some(_)) => return Err(ApiError::invalid("near", "is needed with radius")),
    };
    Ok(Question { sessions, image: image_to_locate(image)?, camera, near })
}

fn checked_near(position: [f64; 3], radius: f64) -> Result<([f64; 3], f64), ApiError> {
    if !position.iter().all(|length| length.is_finite()) {
        return Err(ApiError::invalid("near", "must be three finite numbers"));
    }
    if !(radius.is_finite() && radius > 0.0) {
        return Err(ApiError::invalid("radius", "must be a number above 0"));
    }
    Ok((position, radius))
}

pub(super) fn located(located: &Located) -> v1::LocalizeResponse {
    let result = frame_result(&located.report, located.metres_per_unit);
    let covariance = located.covariance.as_ref().filter(|_| result.pose_world_from_camera.is_some());
    v1::LocalizeResponse {
        state: result.state,
        reason: result.reason,
        pose_world_from_camera: result.pose_world_from_camera,
        scale: result.scale,
        submap_id: result.submap_id,
        n_inlier_points: result.n_inlier_points,
        n_inlier_lines: result.n_inlier_lines,
        n_keypoints: result.n_keypoints,
        durable_sequence: located.durable_sequence,
        load_ms: ms(located.load_ns),
        locate_ms: ms(located.locate_ns),
        session_id: located.session.as_ref().map(ToString::to_string).unwrap_or_default(),
        covariance: covariance
            .map(|covariance| covariance.transpose().as_slice().to_vec())
            .unwrap_or_default(),
        camera: located.camera.as_ref().map(camera),
        n_sessions_searched: located.n_searched,
        n_sessions_tried: located.n_tried,
    }
}

pub(super) fn operation(operation: &Operation) -> v1::Operation {
    let kind = match operation.kind {
        Kind::Optimize => v1::OperationKind::Optimize,
        Kind::Merge => v1::OperationKind::Merge,
    };
    let state = match operation.state {
        State::Queued => v1::OperationState::Queued,
        State::Running => v1::OperationState::Running,
        State::Done => v1::OperationState::Done,
        State::Failed => v1::OperationState::Failed,
        State::Cancelled => v1::OperationState::Cancelled,
    };
    let named = |id: &Option<SessionId>| id.as_ref().map(ToString::to_string).unwrap_or_default();
    v1::Operation {
        id: operation.id.clone(),
        kind: kind.into(),
        session_id: named(&operation.session),
        from_session_id: named(&operation.from),
        state: state.into(),
        progress: operation.progress,
        n_iterations: operation.n_iterations,
        message: operation.message(),
        error_code: operation.error.as_ref().map(|error| error.code.name().to_owned()).unwrap_or_default(),
        created_at_ns: operation.created_at_ns,
        ended_at_ns: operation.ended_at_ns,
        result: operation.result.as_ref().and_then(result),
    }
}

fn result(outcome: &Outcome) -> Option<OperationResult> {
    match outcome {
        Outcome::Cancelled => None,
        Outcome::Adjusted(adjusted) => Some(OperationResult::Optimized(v1::OptimizeResult {
            cost_before: adjusted.cost_before,
            cost_after: adjusted.cost_after,
            n_keyframes: adjusted.n_keyframes as u64,
            n_points: adjusted.n_points as u64,
            n_lines: adjusted.n_lines as u64,
        })),
        Outcome::Joined(joined) => Some(OperationResult::Merged(v1::MergeResult {
            found: !joined.places.is_empty(),
            places: joined
                .places
                .iter()
                .map(|place| v1::MergedPlace {
                    from_keyframe: place.from_keyframe.get(),
                    into_keyframe: place.into_keyframe.get(),
                    n_matches: place.n_matches as u32,
                    scale: place.scale,
                })
                .collect(),
            n_keyframes: joined.n_keyframes as u64,
            n_frames: joined.n_frames as u64,
            sequence_shift: joined.sequence_shift,
            timestamp_shift_ns: joined.timestamp_shift_ns,
            n_loops: joined.n_loops as u32,
            cost_before: joined.costs.0,
            cost_after: joined.costs.1,
        })),
    }
}
