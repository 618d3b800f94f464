//! What happens in a session, as server-sent events.

use super::extract::AskedBy;
use super::model::{Readout, Session};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::model::{Pose, Scale, State as TrackingState, Units};
use crate::session::{FrameOutcome, MapChange, SessionEvent};
use crate::watch::{Watched, watch};
use axum::extract::{Path, State};
use axum::response::sse::{Event, KeepAlive, Sse};
use serde::Serialize;

use slam::map::{KeyframeId, PrimitiveId};
use std::convert::Infallible;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use utoipa::ToSchema;

/// Data of an event `frame`: a frame was tracked, or tried to be.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct FrameEvent {
    /// The client's number of the frame.
    sequence: u64,
    /// The client's time of the frame, nanoseconds.
    timestamp_ns: i64,
    /// The same in text, for programs whose numbers do not hold all its digits, such as JavaScript's.
    timestamp_ns_text: String,
    /// How tracking ended.
    state: TrackingState,
    /// Why there is no pose, or a weak one, in a plain sentence. Empty when tracked.
    reason: String,
    /// The camera's pose in the world; `null` while there is none.
    world_from_camera: Option<Pose>,
    /// What a length of 1 means.
    scale: Scale,
    /// The submap whose frame of reference the pose is in.
    submap_id: u32,
    /// The frame became a keyframe.
    is_key_frame: bool,
    /// Keypoints found in the image.
    n_keypoints: usize,
    /// Segments followed into the image or begun in it.
    n_segments: usize,
    /// Points that agree with the pose.
    n_inlier_points: usize,
    /// Lines that agree with the pose.
    n_inlier_lines: usize,
    /// Time the frame took, milliseconds.
    wall_ms: f64,
    /// The pose was found by recognizing the place.
    #[serde(rename = "relocalised")]
    relocalized: bool,
    /// Corrections of the map that took effect with this frame.
    corrections: Vec<MapCorrection>,
}

/// How the camera that fits the images best differs from its calibration.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct CameraCorrection {
    /// Relative change of both focal lengths.
    focal: f64,
    /// Shift of the principal point to the right, in focal lengths.
    #[serde(rename = "centre_x")]
    center_x: f64,
    /// Shift of the principal point downwards, in focal lengths.
    #[serde(rename = "centre_y")]
    center_y: f64,
    /// Radial distortion that the calibration does not describe, `k1` and `k2` of Brown's model.
    k1: f64,
    /// See `k1`.
    k2: f64,
    /// Standard deviation of the focal length, as a share of it; `null` where it was not determined.
    focal_sigma: Option<f64>,
    /// The map was adjusted to that camera. Otherwise it is more than a calibration can be wrong by: it is
    /// used as it was given, and should be looked at.
    adopted: bool,
}

/// The map was corrected: a loop was closed, submaps were merged, or the intrinsics were refined.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct MapCorrection {
    /// The keyframe that shows the place again; `null` if it is about the camera.
    keyframe: Option<u64>,
    /// The keyframe that showed it before.
    matched_keyframe: Option<u64>,
    /// Points of the place that were found again.
    n_matches: usize,
    /// The submap that became part of another one; `null` where a loop within a submap was closed.
    submap_gone: Option<u32>,
    /// The submap it became part of.
    submap_kept: Option<u32>,
    /// What was found out about the camera.
    camera: Option<CameraCorrection>,
    /// The readout of its rolling shutter, where that was found out.
    readout: Option<Readout>,
}

/// Data of an event `map`: the map was changed. It is in the database a moment later.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct MapEvent {
    /// Keyframes that are new, moved, or see other landmarks than before.
    changed_keyframes: Vec<u64>,
    /// Keyframes that were removed.
    removed_keyframes: Vec<u64>,
    /// Points that are new or changed.
    n_changed_points: usize,
    /// Points that were removed.
    n_removed_points: usize,
    /// Lines that are new or changed.
    n_changed_lines: usize,
    /// Lines that were removed.
    n_removed_lines: usize,
    /// Global primitives that are new or changed.
    changed_primitives: Vec<u64>,
    /// Global primitives that were removed.
    removed_primitives: Vec<u64>,
    /// Keyframes there are now.
    n_keyframes: usize,
    /// Points there are now.
    n_points: usize,
    /// Lines there are now.
    n_lines: usize,
    /// Global primitives there are now.
    n_primitives: usize,
}

/// Data of an event `scene`: the database holds a newer state of the map; `…/scene?since=` tells what
/// changed.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct SceneEvent {
    /// The newest revision.
    revision: String,
}

/// Data of an event `missed`: events were left out because the client did not read them.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct MissedEvent {
    /// How many.
    n_events: u64,
}

impl FrameEvent {
    /// Of what the engine reports, in a session of these units.
    pub(super) fn new(report: &FrameOutcome, units: Units) -> Self {
        Self {
            sequence: report.sequence,
            timestamp_ns: report.timestamp_ns,
            timestamp_ns_text: report.timestamp_ns.to_string(),
            state: report.outcome.state().into(),
            reason: report.reason(),
            world_from_camera: report.world_from_camera.as_ref().map(|pose| units.pose(pose)),
            scale: units.scale(),
            submap_id: report.submap.0,
            is_key_frame: report.is_keyframe,
            n_keypoints: report.n_keypoints,
            n_segments: report.n_segments,
            n_inlier_points: report.n_inlier_points,
            n_inlier_lines: report.n_inlier_lines,
            wall_ms: report.wall_ns as f64 * 1e-6,
            relocalized: report.relocalized,
            corrections: report.map_events.iter().map(MapCorrection::from).collect(),
        }
    }
}

impl From<&slam::MapEvent> for MapCorrection {
    fn from(event: &slam::MapEvent) -> Self {
        let (keyframe, matched) = event.keyframes().unzip();
        let (submap_gone, submap_kept) = event.submaps().unzip();
        let focal_sigma = event.focal_sigma();
        Self {
            keyframe: keyframe.map(KeyframeId::get),
            matched_keyframe: matched.map(KeyframeId::get),
            n_matches: event.n_matches(),
            submap_gone: submap_gone.map(|submap| submap.0),
            submap_kept: submap_kept.map(|submap| submap.0),
            camera: event.camera().map(|(correction, adopted)| {
                let geometry::CameraCorrection { focal, center_x, center_y, k1, k2 } = correction;
                CameraCorrection { focal, center_x, center_y, k1, k2, focal_sigma, adopted }
            }),
            readout: event.readout().map(Readout::from),
        }
    }
}

impl From<&MapChange> for MapEvent {
    fn from(change: &MapChange) -> Self {
        let keyframes = |ids: &[KeyframeId]| ids.iter().map(|id| id.get()).collect();
        let primitives = |ids: &[PrimitiveId]| ids.iter().map(|id| id.get()).collect();
        let [n_changed_points, n_removed_points] = change.n_points;
        let [n_changed_lines, n_removed_lines] = change.n_lines;
        let [n_keyframes, n_points, n_lines, n_primitives] = change.totals;
        Self {
            changed_keyframes: keyframes(&change.changed_keyframes),
            removed_keyframes: keyframes(&change.removed_keyframes),
            n_changed_points,
            n_removed_points,
            n_changed_lines,
            n_removed_lines,
            changed_primitives: primitives(&change.changed_primitives),
            removed_primitives: primitives(&change.removed_primitives),
            n_keyframes,
            n_points,
            n_lines,
            n_primitives,
        }
    }
}

/// What happens in the session from now on, as server-sent events: `session` (the session as it is now, and
/// after its options or scale were changed), `frame`, `map`, `scene` and `missed`, each with a JSON object as
/// its data. Ends when the session is deleted or the server shuts down.
#[utoipa::path(get, path = "/v1/sessions/{id}/events", tag = "sessions",
    params(("id", description = "The session's id")), responses(
    (status = 200, description = "The events", content(
        (Session = "text/event-stream"), (FrameEvent = "text/event-stream; event=frame"),
        (MapEvent = "text/event-stream; event=map"),
        (SceneEvent = "text/event-stream; event=scene"), (MissedEvent = "text/event-stream; event=missed"))),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn events(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, ApiError> {
    let id = caller.session(&id, "id")?;
    let watched = ReceiverStream::new(watch(app.service.clone(), id).await?);
    // An error ends the stream, which its reader notices.
    let events = watched.filter_map(|watched| event(watched.ok()?)).map(Ok);
    Ok(Sse::new(events).keep_alive(KeepAlive::default()))
}

fn event(watched: Watched) -> Option<Event> {
    let event = match watched {
        Watched::Session(view) => Event::default().event("session").json_data(Session::from(*view)),
        Watched::Missed(n_events) => Event::default().event("missed").json_data(MissedEvent { n_events }),
        Watched::Event(SessionEvent::Frame { report, metres_per_unit }) => {
            let frame = FrameEvent::new(&report, Units::new(metres_per_unit));
            Event::default().event("frame").json_data(frame)
        }
        Watched::Event(SessionEvent::Map(change)) => {
            Event::default().event("map").json_data(MapEvent::from(&*change))
        }
        Watched::Event(SessionEvent::Saved(revision)) => {
            Event::default().event("scene").json_data(SceneEvent { revision: revision.to_string() })
        }
        // Whoever is told of new settings is sent the session.
        Watched::Event(SessionEvent::Settings) => return None,
    };
    event.ok()
}
