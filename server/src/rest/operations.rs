//! Operations: what takes long and goes on whether or not its client is there.

use super::extract::{AskedBy, Body, Params};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::operations::{Kind, Operation as Told, Outcome, State as HowFar};
use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderName, StatusCode};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// What kind of operation.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum OperationKind {
    /// Global bundle adjustment of a map.
    Optimize,
    /// Joining two maps.
    Merge,
}

/// How far an operation is.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum OperationState {
    /// It waits for its turn.
    Queued,
    /// It runs.
    Running,
    /// It has ended with a result.
    Done,
    /// It has ended with an error.
    Failed,
    /// It was ended without a result.
    Cancelled,
}

/// Something that takes long, and goes on whether or not its client is there.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct Operation {
    /// Its name.
    id: String,
    /// What kind.
    kind: OperationKind,
    /// The session it changes.
    session_id: String,
    /// Of a merger: the session that is taken in.
    from_session_id: Option<String>,
    /// How far it is.
    state: OperationState,
    /// Share that is done, 0 to 1.
    progress: f64,
    /// Iterations of optimization so far.
    n_iterations: u32,
    /// What came of it, or why it failed, in a plain sentence. Empty before it ends.
    message: String,
    /// Stable name of the kind of error, if it failed.
    error_code: Option<&'static str>,
    /// Wall-clock time, nanoseconds since 1970.
    created_at_ns: i64,
    /// Likewise; `null` before it ends.
    ended_at_ns: Option<i64>,
    /// When it began, in text, for programs whose numbers do not hold all the digits.
    created_at_ns_text: String,
    /// When it ended, likewise.
    ended_at_ns_text: Option<String>,
    /// What adjusting a map came to.
    optimized: Option<OptimizeResult>,
    /// What joining two maps came to.
    merged: Option<MergeResult>,
}

/// Cost: half the sum of the squared errors of all sightings of points and lines, in standard deviations,
/// each counted up to that of one that just agrees. The same sightings before and after. A map that would not
/// agree better stays as it is.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct OptimizeResult {
    /// Before.
    cost_before: f64,
    /// Afterwards.
    cost_after: f64,
    /// Keyframes of the map.
    n_keyframes: usize,
    /// Points of the map.
    n_points: usize,
    /// Lines of the map.
    n_lines: usize,
}

/// What joining two maps came to.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct MergeResult {
    /// Whether a place was found that both show. If not, nothing was changed.
    found: bool,
    /// The places.
    places: Vec<MergedPlace>,
    /// Keyframes that were taken in.
    n_keyframes: usize,
    /// Frames that were taken in.
    n_frames: usize,
    /// What was added to the numbers of those frames, so that they come after those that were there.
    sequence_shift: i64,
    /// What was added to their times, nanoseconds.
    timestamp_shift_ns: i64,
    /// The same in text.
    timestamp_shift_ns_text: String,
    /// Loops closed inside of the joined map.
    n_loops: usize,
    /// Cost before the adjustment that followed.
    cost_before: f64,
    /// And afterwards.
    cost_after: f64,
}

/// A place by which two maps were joined.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct MergedPlace {
    /// The keyframe of the session taken in, by its number there.
    from_keyframe: u64,
    /// The keyframe that shows the same place.
    into_keyframe: u64,
    /// Points of the place that were found.
    n_matches: usize,
    /// Map units per map unit of the session taken in.
    scale: f64,
}

/// Operations, the newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct OperationList {
    /// The operations.
    operations: Vec<Operation>,
}

/// Which session is joined.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Merge {
    /// The session that is taken in; it stays as it is.
    from: String,
}

/// Which operations.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct OperationParams {
    /// Those on this session only.
    session: String,
}

impl From<Told> for Operation {
    fn from(told: Told) -> Self {
        let message = told.message();
        let (mut optimized, mut merged) = (None, None);
        match told.result {
            Some(Outcome::Adjusted(found)) => {
                optimized = Some(OptimizeResult {
                    cost_before: found.cost_before,
                    cost_after: found.cost_after,
                    n_keyframes: found.n_keyframes,
                    n_points: found.n_points,
                    n_lines: found.n_lines,
                });
            }
            Some(Outcome::Joined(found)) => merged = Some(found.into()),
            Some(Outcome::Cancelled) | None => {}
        }
        Self {
            id: told.id,
            kind: match told.kind {
                Kind::Optimize => OperationKind::Optimize,
                Kind::Merge => OperationKind::Merge,
            },
            session_id: told.session.map(|id| id.to_string()).unwrap_or_default(),
            from_session_id: told.from.map(|id| id.to_string()),
            state: match told.state {
                HowFar::Queued => OperationState::Queued,
                HowFar::Running => OperationState::Running,
                HowFar::Done => OperationState::Done,
                HowFar::Failed => OperationState::Failed,
                HowFar::Cancelled => OperationState::Cancelled,
            },
            progress: told.progress,
            n_iterations: told.n_iterations,
            message,
            error_code: told.error.map(|error| error.code.name()),
            created_at_ns_text: told.created_at_ns.to_string(),
            created_at_ns: told.created_at_ns,
            ended_at_ns_text: told.ended_at_ns.map(|ns| ns.to_string()),
            ended_at_ns: told.ended_at_ns,
            optimized,
            merged,
        }
    }
}

impl From<crate::session::Joined> for MergeResult {
    fn from(joined: crate::session::Joined) -> Self {
        let place = |place: &slam::Joined| MergedPlace {
            from_keyframe: place.from_keyframe.get(),
            into_keyframe: place.into_keyframe.get(),
            n_matches: place.n_matches,
            scale: place.scale,
        };
        Self {
            found: !joined.places.is_empty(),
            places: joined.places.iter().map(place).collect(),
            n_keyframes: joined.n_keyframes,
            n_frames: joined.n_frames,
            sequence_shift: joined.sequence_shift,
            timestamp_shift_ns: joined.timestamp_shift_ns,
            timestamp_shift_ns_text: joined.timestamp_shift_ns.to_string(),
            n_loops: joined.n_loops,
            cost_before: joined.costs.0,
            cost_after: joined.costs.1,
        }
    }
}

type Begun = (StatusCode, [(HeaderName, String); 1], Json<Operation>);

fn begun(operation: Told) -> Begun {
    let location = format!("/v1/operations/{}", operation.id);
    (StatusCode::ACCEPTED, [(LOCATION, location)], Json(operation.into()))
}

/// Begins global bundle adjustment of a session's map. Answers at once with the operation, which goes on when
/// the client leaves; its result is saved as a whole or not at all.
#[utoipa::path(post, path = "/v1/sessions/{id}/optimize", tag = "maps",
    params(("id", description = "The session's id")), responses(
    (status = 202, description = "It was begun; `Location` is where it is told of", body = Operation),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected, or another operation works on the session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 429, description = "Too many wait", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn optimize(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Begun, ApiError> {
    let id = caller.session(&id, "id")?;
    Ok(begun(app.service.optimize(&caller, &id).await?))
}

/// Begins to join another session of the same camera with this one, where both maps show the same place. The
/// other one stays as it is; nothing is changed if no such place is found.
#[utoipa::path(post, path = "/v1/sessions/{id}/merge", tag = "maps",
    params(("id", description = "The id of the session that takes the other one in")),
    request_body = Merge, responses(
    (status = 202, description = "It was begun; `Location` is where it is told of", body = Operation),
    (status = 400, description = "A field is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "A writer is connected, or another operation works on one of them", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 429, description = "Too many wait", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn merge(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Body(request): Body<Merge>,
) -> Result<Begun, ApiError> {
    let into = caller.session(&id, "id")?;
    // Whether there is one is told before anything is said of the other.
    app.service.get_session(&into).await?;
    let from = caller.session(&request.from, "from")?;
    Ok(begun(app.service.merge(&caller, &into, &from).await?))
}

/// Operations on the caller's sessions, the newest first: those that have not ended, and some hundred that
/// have. A restart of the server forgets them; one that it cut short has changed nothing.
#[utoipa::path(get, path = "/v1/operations", tag = "operations", params(OperationParams), responses(
    (status = 200, description = "The operations", body = OperationList),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn list(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Params(OperationParams { session }): Params<OperationParams>,
) -> Result<Json<OperationList>, ApiError> {
    let session = Some(session).filter(|id| !id.is_empty());
    let session = session.map(|id| caller.session(&id, "session")).transpose()?;
    if let Some(id) = &session {
        app.service.get_session(id).await?;
    }
    let operations = app.service.operations().list(&caller, session.as_ref());
    Ok(Json(OperationList { operations: operations.into_iter().map(Operation::from).collect() }))
}

/// An operation.
#[utoipa::path(get, path = "/v1/operations/{operation}", tag = "operations",
    params(("operation", description = "The operation's id")), responses(
    (status = 200, description = "The operation", body = Operation),
    (status = 404, description = "No such operation, or no longer", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn get(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Json<Operation>, ApiError> {
    Ok(Json(app.service.operations().get(&caller, &id)?.into()))
}

/// Asks an operation to end without a result. One that has ended stays as it is.
#[utoipa::path(post, path = "/v1/operations/{operation}/cancel", tag = "operations",
    params(("operation", description = "The operation's id")), responses(
    (status = 200, description = "The operation; it may take a moment to notice", body = Operation),
    (status = 404, description = "No such operation, or no longer", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn cancel(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
) -> Result<Json<Operation>, ApiError> {
    Ok(Json(app.service.operations().cancel(&caller, &id)?.into()))
}
