//! The JSON of sessions. Names are those of the gRPC contract.

use crate::access::Caller;
use crate::error::ApiError;
use crate::model::{Camera, Scale, State};
use crate::options::SessionOptions;
use crate::service::NewSession;
use crate::session::SessionView;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A session to be made.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateSession {
    /// Letters, digits, `-` and `_`, up to 64; left out, the server makes one.
    #[serde(default)]
    pub id: Option<String>,
    /// A session, or one that extends the same map: the new camera extends that map too. Left out, the
    /// session has a map of its own.
    #[serde(default)]
    pub map: Option<String>,
    /// Its camera; may be left out where `map` is given and the camera is like the map's own.
    #[serde(default)]
    pub camera: Option<Camera>,
    /// The session's options; with `map`, those that do not concern the map.
    #[serde(default)]
    pub options: SessionOptions,
}

/// What to change of a session; what is left out stays.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct UpdateSession {
    /// Options to change. They hold from the session's next stream on.
    pub options: SessionOptions,
}

/// A session.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Session {
    /// Its name.
    pub id: String,
    /// The session whose map its camera extends; `null` if it has one of its own.
    pub map: Option<String>,
    /// Its camera, as it was given.
    pub camera: Camera,
    /// Its camera as it was found to be; `null` while it is used as it was given.
    pub refined_camera: Option<Camera>,
    /// The readout of its camera's rolling shutter as it was found; `null` where it was told, and until the
    /// motion has shown one.
    pub found_readout: Option<Readout>,
    /// The session's options.
    pub options: SessionOptions,
    /// What of its images is left out as not being the scene, such as a black border; `null` while nothing
    /// is.
    pub mask: Option<Mask>,
    /// What is doubtful about the camera without keeping it from being used, in plain sentences.
    pub camera_warnings: Vec<String>,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// The same in text, for programs whose numbers do not hold all its digits, such as JavaScript's.
    pub created_at_ns_text: String,
    /// How tracking its last frame ended; `null` before the first.
    pub state: Option<State>,
    /// What a length of 1 means.
    pub scale: Scale,
    /// Metres per map unit; `null` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// Frames of the trajectory.
    pub n_frames: u64,
    /// Keyframes.
    pub n_keyframes: u64,
    /// Points.
    pub n_points: u64,
    /// Lines.
    pub n_lines: u64,
    /// Global primitives.
    pub n_primitives: u64,
    /// Submaps that have keyframes.
    pub n_submaps: u32,
    /// Every frame up to this one is in the database; `null` before the first.
    pub durable_sequence: Option<u64>,
    /// The frame the server expects next.
    pub next_sequence: u64,
    /// Time of the last frame, nanoseconds: later ones must be after it; `null` before the first.
    pub last_timestamp_ns: Option<i64>,
    /// The same in text, for programs whose numbers do not hold all its digits, such as JavaScript's.
    pub last_timestamp_ns_text: Option<String>,
    /// Whether the session is in memory.
    pub loaded: bool,
    /// Whether a writer is connected.
    pub has_writer: bool,
    /// What of it is damaged, so that it cannot be streamed into: restore a backup or delete it. `null` if
    /// nothing is known to be.
    pub damage: Option<String>,
}

/// What of a session's images is not the scene.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[schema(as = SessionMask)]
pub struct Mask {
    /// The share of the image, 0 to 1.
    pub share: f64,
    /// It was given; else it was found as what stays where it is while the scene moves.
    pub given: bool,
}

/// How long a camera takes to read the rows of an image, and how well that is known.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub struct Readout {
    /// From the first row to the last, milliseconds.
    pub readout_ms: f64,
    /// Its standard deviation, milliseconds.
    pub sigma_ms: f64,
}

impl From<slam::map::Readout> for Readout {
    fn from(found: slam::map::Readout) -> Self {
        Self { readout_ms: found.ms(), sigma_ms: found.sigma_ms() }
    }
}

/// Some sessions in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SessionPage {
    /// The sessions.
    pub sessions: Vec<Session>,
    /// Where the next page begins; `null` on the last.
    pub next_page_token: Option<String>,
}

impl CreateSession {
    /// The service's terms.
    ///
    /// # Errors
    /// If the id is not one.
    pub fn into_new_session(self, caller: &Caller) -> Result<NewSession, ApiError> {
        let id = self.id.filter(|id| !id.is_empty());
        let id = id.map(|id| caller.session(&id, "id")).transpose()?;
        let map = self.map.filter(|map| !map.is_empty());
        let map = map.map(|map| caller.session(&map, "map")).transpose()?;
        let camera = self.camera.map(Into::into);
        Ok(NewSession { id, map, camera, options: self.options, mask: None })
    }
}

impl From<SessionView> for Session {
    fn from(view: SessionView) -> Self {
        let camera_warnings = view.camera_warnings();
        Self {
            id: view.id,
            map: view.map,
            camera_warnings,
            camera: view.camera.into(),
            refined_camera: view.refined_camera.map(Camera::from),
            found_readout: view.readout.map(Readout::from),
            options: view.options,
            mask: view.mask.map(|mask| Mask { share: mask.share, given: mask.is_given }),
            created_at_ns: view.created_at_ns,
            created_at_ns_text: view.created_at_ns.to_string(),
            state: view.state.map(State::from),
            scale: Scale::of(view.metres_per_unit),
            metres_per_unit: view.metres_per_unit,
            n_frames: view.n_frames,
            n_keyframes: view.n_keyframes,
            n_points: view.n_points,
            n_lines: view.n_lines,
            n_primitives: view.n_primitives,
            n_submaps: view.n_submaps,
            durable_sequence: view.durable_sequence,
            next_sequence: view.next_sequence,
            last_timestamp_ns: view.last_timestamp_ns,
            last_timestamp_ns_text: view.last_timestamp_ns.map(|ns| ns.to_string()),
            loaded: view.loaded,
            has_writer: view.has_writer,
            damage: view.damage,
        }
    }
}
