//! Between the messages of the contract and the service's types.

use crate::access::Caller;
use crate::budget::Charge;
use crate::error::{ApiError, FieldViolation};
use crate::model::{Pose, Scale, Units};
use crate::options::{Calibration, SessionOptions, convert_options};
use crate::service::NewSession;
use crate::session::{
    Answer, Before, Encoding, FrameOutcome, MapChange, Mode, OpenRequest, Policy, Rejection, Reply,
    SentFrame, SentImage, SessionEvent, SessionView,
};
use crate::watch::Watched;
use geometry::{CameraCorrection, CameraModel, CameraParameters};
use proto::v1;
use proto::v1::session_event::Event;
use proto::v1::stream_frames_response::Message;

use slam::map::{FrameState, KeyframeId, Readout};
use std::sync::Arc;
use std::time::Instant;
use store::MAX_SEQUENCE;
use vision::decode::PixelFormat;

pub(super) fn new_session(
    caller: &Caller,
    request: v1::CreateSessionRequest,
) -> Result<NewSession, ApiError> {
    let v1::CreateSessionRequest { session_id, camera, options, mask, map } = request;
    let id = if session_id.is_empty() { None } else { Some(caller.session(&session_id, "session_id")?) };
    let map = if map.is_empty() { None } else { Some(caller.session(&map, "map")?) };
    let camera = camera.map(camera_parameters).transpose()?;
    let options = options.map(SessionOptions::from).unwrap_or_default();
    let mask = (!mask.is_empty()).then(|| mask.into());
    Ok(NewSession { id, map, camera, options, mask })
}

pub(super) fn camera_parameters(camera: v1::Camera) -> Result<CameraParameters, ApiError> {
    let model = match camera.model() {
        v1::CameraModel::Pinhole => CameraModel::Pinhole,
        v1::CameraModel::Radtan => CameraModel::Radtan,
        v1::CameraModel::KannalaBrandt => CameraModel::KannalaBrandt,
        v1::CameraModel::Fov => CameraModel::Fov,
        v1::CameraModel::ExtendedUnified => CameraModel::ExtendedUnified,
        v1::CameraModel::DoubleSphere => CameraModel::DoubleSphere,
        // A camera that is given by its size alone has no model.
        v1::CameraModel::Unspecified if camera.fx == 0.0 && camera.fy == 0.0 => CameraModel::Pinhole,
        v1::CameraModel::Unspecified => {
            let sentence = "must be PINHOLE, RADTAN, KANNALA_BRANDT, FOV, EXTENDED_UNIFIED or DOUBLE_SPHERE";
            return Err(ApiError::invalid("camera.model", sentence));
        }
    };
    let v1::Camera { model: _, width, height, fx, fy, cx, cy, distortion } = camera;
    Ok(CameraParameters { model, width, height, fx, fy, cx, cy, distortion })
}

convert_options!(v1::SessionOptions => SessionOptions, from calibration = calibration_of);
convert_options!(SessionOptions => v1::SessionOptions, from calibration = calibration_message);

fn calibration_of(number: i32) -> Option<Calibration> {
    match v1::Calibration::try_from(number).unwrap_or_default() {
        v1::Calibration::Unspecified => None,
        v1::Calibration::Given => Some(Calibration::Given),
        v1::Calibration::Approximate => Some(Calibration::Approximate),
        v1::Calibration::Unknown => Some(Calibration::Unknown),
    }
}

fn calibration_message(calibration: Option<Calibration>) -> i32 {
    let message = match calibration {
        None => v1::Calibration::Unspecified,
        Some(Calibration::Given) => v1::Calibration::Given,
        Some(Calibration::Approximate) => v1::Calibration::Approximate,
        Some(Calibration::Unknown) => v1::Calibration::Unknown,
    };
    message.into()
}

/// What a watcher is told; `None` for what only concerns others.
pub(super) fn session_event(watched: Watched) -> Option<v1::SessionEvent> {
    let event = match watched {
        // Whoever is told of new settings is sent the session.
        Watched::Event(SessionEvent::Settings | SessionEvent::Saved(_)) => return None,
        Watched::Session(view) => Event::Session(session(&view)),
        Watched::Missed(n) => Event::Missed(n),
        Watched::Event(SessionEvent::Map(change)) => Event::Map(map_event(&change)),
        Watched::Event(SessionEvent::Frame { report, metres_per_unit }) => {
            Event::Frame(frame_event(&report, metres_per_unit))
        }
    };
    Some(v1::SessionEvent { event: Some(event) })
}

fn frame_event(report: &FrameOutcome, metres_per_unit: Option<f64>) -> v1::FrameEvent {
    let result = frame_result(report, metres_per_unit);
    v1::FrameEvent {
        sequence: result.sequence,
        timestamp_ns: result.timestamp_ns,
        state: result.state,
        reason: result.reason,
        pose_world_from_camera: result.pose_world_from_camera,
        scale: result.scale,
        submap_id: result.submap_id,
        is_key_frame: result.is_key_frame,
        relocalised: result.relocalised,
        corrections: result.corrections,
    }
}

fn map_event(change: &MapChange) -> v1::MapEvent {
    let [n_changed_points, n_removed_points] = change.n_points.map(|n| n as u64);
    let [n_changed_lines, n_removed_lines] = change.n_lines.map(|n| n as u64);
    let [n_keyframes, n_points, n_lines, n_primitives] = change.totals.map(|n| n as u64);
    v1::MapEvent {
        changed_keyframes: change.changed_keyframes.iter().map(|id| id.get()).collect(),
        removed_keyframes: change.removed_keyframes.iter().map(|id| id.get()).collect(),
        n_changed_points,
        n_removed_points,
        n_changed_lines,
        n_removed_lines,
        changed_primitives: change.changed_primitives.iter().map(|id| id.get()).collect(),
        removed_primitives: change.removed_primitives.iter().map(|id| id.get()).collect(),
        n_keyframes,
        n_points,
        n_lines,
        n_primitives,
    }
}

pub(super) fn session(view: &SessionView) -> v1::Session {
    v1::Session {
        id: view.id.clone(),
        camera: Some(camera(&view.camera)),
        options: Some(view.options.clone().into()),
        created_at_ns: view.created_at_ns,
        state: view.state.map_or(v1::TrackingState::Unspecified, tracking_state).into(),
        n_frames: view.n_frames,
        n_keyframes: view.n_keyframes,
        n_points: view.n_points,
        n_lines: view.n_lines,
        n_primitives: view.n_primitives,
        n_submaps: view.n_submaps,
        durable_sequence: view.durable_sequence,
        next_sequence: view.next_sequence,
        loaded: view.loaded,
        has_writer: view.has_writer,
        last_timestamp_ns: view.last_timestamp_ns,
        metres_per_unit: view.metres_per_unit,
        refined_camera: view.refined_camera.as_ref().map(camera),
        damage: view.damage.clone(),
        scale_measurement: None,
        mask: view.mask.map(|mask| v1::Mask { share: mask.share, given: mask.is_given }),
        camera_warnings: view.camera_warnings(),
        found_readout: view.readout.map(readout),
        map: view.map.clone(),
    }
}

pub(super) fn camera(camera: &CameraParameters) -> v1::Camera {
    let model = match camera.model {
        CameraModel::Pinhole => v1::CameraModel::Pinhole,
        CameraModel::Radtan => v1::CameraModel::Radtan,
        CameraModel::KannalaBrandt => v1::CameraModel::KannalaBrandt,
        CameraModel::Fov => v1::CameraModel::Fov,
        CameraModel::ExtendedUnified => v1::CameraModel::ExtendedUnified,
        CameraModel::DoubleSphere => v1::CameraModel::DoubleSphere,
    };
    let CameraParameters { model: _, width, height, fx, fy, cx, cy, ref distortion } = *camera;
    v1::Camera { model: model.into(), width, height, fx, fy, cx, cy, distortion: distortion.clone() }
}

pub(super) fn tracking_state(state: FrameState) -> v1::TrackingState {
    match state {
        FrameState::Initialising => v1::TrackingState::Initialising,
        FrameState::Tracked => v1::TrackingState::Tracked,
        FrameState::Weak => v1::TrackingState::Weak,
        FrameState::Lost => v1::TrackingState::Lost,
    }
}

pub(super) fn open_request(caller: &Caller, open: v1::OpenStream) -> Result<OpenRequest, ApiError> {
    let mut violations = Vec::new();
    let mut violate = |field: &str, description: &str| {
        violations.push(FieldViolation { field: field.into(), description: description.into() });
    };
    let mode = match open.mode() {
        v1::StreamMode::MapAndLocalize => Mode::MapAndLocalize,
        v1::StreamMode::LocalizeOnly => Mode::LocalizeOnly,
        v1::StreamMode::Unspecified => {
            violate("open.mode", "must be MAP_AND_LOCALIZE or LOCALIZE_ONLY");
            Mode::LocalizeOnly
        }
    };
    let policy = match open.policy() {
        v1::StreamPolicy::Lossless => Policy::Lossless,
        v1::StreamPolicy::Realtime => Policy::Realtime,
        v1::StreamPolicy::Unspecified => {
            violate("open.policy", "must be LOSSLESS or REALTIME");
            Policy::Lossless
        }
    };
    if !violations.is_empty() {
        return Err(ApiError::invalid_fields(violations));
    }
    let id = caller.session(&open.session_id, "open.session_id")?;
    Ok(OpenRequest { id, mode, policy, take_over: open.take_over, new_segment: open.new_segment })
}

/// A frame, or why it cannot be one.
pub(super) fn frame(frame: v1::Frame, charge: Option<Charge>) -> Result<SentFrame, Rejection> {
    let v1::Frame { sequence, timestamp_ns, image } = frame;
    let reject = |field, reason: &str, code| Rejection { sequence, field, reason: reason.to_owned(), code };
    if sequence > MAX_SEQUENCE {
        return Err(reject("sequence", "must be below 2^63", "SEQUENCE_OUT_OF_RANGE"));
    }
    let Some(image) = image else {
        return Err(reject("image", "a frame needs an image", "MISSING_IMAGE"));
    };
    let Some(image) = sent_image(image) else {
        return Err(reject("image.encoding", "is none this server knows", "UNKNOWN_FORMAT"));
    };
    Ok(SentFrame { sequence, timestamp_ns, image, arrived: Instant::now(), charge: charge.map(Arc::new) })
}

/// The image of a request to locate it.
pub(super) fn image_to_locate(image: Option<v1::Image>) -> Result<SentImage, ApiError> {
    let image = image.ok_or_else(|| ApiError::invalid("image", "is needed"))?;
    sent_image(image).ok_or_else(|| ApiError::invalid("image.encoding", "is none this server knows"))
}

/// `None` if the encoding is unknown.
fn sent_image(image: v1::Image) -> Option<SentImage> {
    let encoding = v1::ImageEncoding::try_from(image.encoding).ok()?;
    let encoding = match encoding {
        v1::ImageEncoding::Unspecified => Encoding::Auto,
        v1::ImageEncoding::Png => Encoding::Png,
        v1::ImageEncoding::Jpeg => Encoding::Jpeg,
        v1::ImageEncoding::Gray8 => Encoding::Raw(PixelFormat::Gray8),
        v1::ImageEncoding::Gray16 => Encoding::Raw(PixelFormat::Gray16),
        v1::ImageEncoding::Rgb8 => Encoding::Raw(PixelFormat::Rgb8),
        v1::ImageEncoding::Bgr8 => Encoding::Raw(PixelFormat::Bgr8),
        v1::ImageEncoding::Rgba8 => Encoding::Raw(PixelFormat::Rgba8),
        v1::ImageEncoding::Bgra8 => Encoding::Raw(PixelFormat::Bgra8),
    };
    let v1::Image { encoding: _, width, height, row_stride, data } = image;
    Some(SentImage { encoding, width, height, row_stride, data })
}

pub(super) fn reply(reply: Reply) -> v1::StreamFramesResponse {
    let message = match reply {
        Reply::Opened(view) => Message::Opened(v1::StreamOpened { session: Some(session(&view)) }),
        Reply::Answered(answer) => Message::Result(answered(*answer)),
        Reply::Repeated { sequence, timestamp_ns, before, durable_sequence, metres_per_unit } => {
            let result = repeated(sequence, timestamp_ns, before.as_ref(), metres_per_unit);
            Message::Result(v1::FrameResult { durable_sequence, repeated: true, ..result })
        }
        Reply::Dropped(sequence) => {
            let reason = "newer frames came before this one's turn".to_owned();
            Message::Dropped(v1::FrameDropped { sequence, reason })
        }
        Reply::Rejected(Rejection { sequence, field, reason, code }) => {
            Message::Rejected(v1::FrameRejected { sequence, field: field.into(), reason, code: code.into() })
        }
    };
    v1::StreamFramesResponse { message: Some(message) }
}

fn answered(answer: Answer) -> v1::FrameResult {
    let Answer { report, durable_sequence, queued_ns, metres_per_unit } = answer;
    let timings = v1::FrameTimings {
        stages: report
            .stages
            .iter()
            .map(|stage| v1::StageTime { name: stage.name.into(), ms: ms(stage.wall_ns) })
            .collect(),
        total_ms: ms(report.wall_ns),
        tracking_cpu_ms: ms(report.cpu_ns),
        queue_ms: ms(queued_ns),
    };
    v1::FrameResult { durable_sequence, timings: Some(timings), ..frame_result(&report, metres_per_unit) }
}

fn repeated(
    sequence: u64,
    timestamp_ns: i64,
    before: Option<&Before>,
    metres_per_unit: Option<f64>,
) -> v1::FrameResult {
    let units = Units::new(metres_per_unit);
    match before {
        Some(Before::Recent(report)) => frame_result(report, metres_per_unit),
        Some(Before::Stored(frame)) => v1::FrameResult {
            sequence,
            timestamp_ns: frame.timestamp_ns,
            state: tracking_state(frame.state).into(),
            pose_world_from_camera: frame
                .world_from_camera
                .as_ref()
                .map(|(_, world_from_camera)| pose(units.pose(world_from_camera))),
            scale: scale(units.scale()).into(),
            submap_id: frame.world_from_camera.map_or(0, |(submap, _)| submap.0),
            ..v1::FrameResult::default()
        },
        None => v1::FrameResult {
            sequence,
            timestamp_ns,
            reason: "a later frame was answered before; this one was not tracked".into(),
            ..v1::FrameResult::default()
        },
    }
}

pub(super) fn frame_result(report: &FrameOutcome, metres_per_unit: Option<f64>) -> v1::FrameResult {
    let units = Units::new(metres_per_unit);
    v1::FrameResult {
        sequence: report.sequence,
        timestamp_ns: report.timestamp_ns,
        state: tracking_state(report.outcome.state()).into(),
        reason: report.reason(),
        pose_world_from_camera: report.world_from_camera.as_ref().map(|camera| pose(units.pose(camera))),
        scale: scale(units.scale()).into(),
        submap_id: report.submap.0,
        n_inlier_points: report.n_inlier_points as u32,
        n_inlier_lines: report.n_inlier_lines as u32,
        is_key_frame: report.is_keyframe,
        relocalised: report.relocalized,
        durable_sequence: None,
        timings: None,
        repeated: false,
        n_keypoints: report.n_keypoints as u32,
        n_relocalisation_candidates: report.n_relocalization_candidates.map(|n| n as u32),
        corrections: report.map_events.iter().map(correction).collect(),
    }
}

fn correction(event: &slam::MapEvent) -> v1::MapCorrection {
    let (keyframe, matched) = event.keyframes().unzip();
    let (submap_gone, submap_kept) = event.submaps().unzip();
    v1::MapCorrection {
        keyframe: keyframe.map_or(0, KeyframeId::get),
        matched_keyframe: matched.map_or(0, KeyframeId::get),
        n_matches: event.n_matches() as u32,
        submap_gone: submap_gone.map(|submap| submap.0),
        submap_kept: submap_kept.map(|submap| submap.0),
        camera: event.camera().map(|(correction, adopted)| {
            let CameraCorrection { focal, center_x, center_y, .. } = correction;
            v1::CameraCorrection { focal, centre_x: center_x, centre_y: center_y, adopted }
        }),
        readout: event.readout().map(readout),
    }
}

fn readout(found: Readout) -> v1::Readout {
    v1::Readout { readout_ms: found.ms(), sigma_ms: found.sigma_ms() }
}

pub(super) fn scale(scale: Scale) -> v1::ScaleKind {
    match scale {
        Scale::UpToScale => v1::ScaleKind::UpToScale,
        Scale::Metric => v1::ScaleKind::Metric,
    }
}

pub(super) fn pose(pose: Pose) -> v1::Pose {
    let Pose { tx, ty, tz, qx, qy, qz, qw } = pose;
    v1::Pose { tx, ty, tz, qx, qy, qz, qw }
}

pub(super) fn ms(nanoseconds: u64) -> f64 {
    nanoseconds as f64 * 1e-6
}
