//! The JSON of the HTTP interface. Names are those of the gRPC contract.

use crate::error::ApiError;
use crate::service::NewSession;
use crate::session::{SessionId, SessionView};
use geometry::{CameraModel, CameraParameters};
use serde::{Deserialize, Serialize};
use slam::map::FrameState;
use utoipa::ToSchema;

/// A camera's calibration. Lengths are pixels; the origin is the centre of the top-left pixel.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// The family of the lens distortion.
    pub model: Model,
    /// Image width.
    #[schema(example = 640)]
    pub width: u32,
    /// Image height.
    #[schema(example = 480)]
    pub height: u32,
    /// Horizontal focal length.
    #[schema(example = 525.0)]
    pub fx: f64,
    /// Vertical focal length.
    #[schema(example = 525.0)]
    pub fy: f64,
    /// Principal point, horizontal.
    #[schema(example = 319.5)]
    pub cx: f64,
    /// Principal point, vertical.
    #[schema(example = 239.5)]
    pub cy: f64,
    /// Coefficients of the model: none; `k1 k2 p1 p2 [k3 [k4 k5 k6]]`; `k1 k2 k3 k4`; `omega`.
    #[serde(default)]
    pub distortion: Vec<f64>,
}

/// The families of lens distortion.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// No distortion.
    Pinhole,
    /// Brown-Conrady.
    Radtan,
    /// Kannala-Brandt equidistant fisheye.
    KannalaBrandt,
    /// Devernay-Faugeras field of view.
    Fov,
}

/// What a session runs with; every field left out takes the server's default.
#[derive(Clone, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Same frames and seed, same bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Seed of every random choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Features asked of the extractor per frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n_features: Option<u32>,
    /// Whether points are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points: Option<bool>,
    /// Whether lines are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lines: Option<bool>,
    /// Whether global primitives are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub global_primitives: Option<bool>,
    /// Whether loops are closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loop_closing: Option<bool>,
    /// Whether the calibration is put right as the map grows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine_calibration: Option<bool>,
    /// Most key frames the session keeps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_keyframes: Option<u32>,
}

/// A session to be made.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CreateSession {
    /// Letters, digits, `-` and `_`, up to 64; left out, the server makes one.
    #[serde(default)]
    pub id: Option<String>,
    /// Its camera.
    pub camera: Camera,
    /// What it runs with.
    #[serde(default)]
    pub options: Options,
}

/// What to change of a session; what is left out stays.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct UpdateSession {
    /// Options to change. They hold from the session's next stream on.
    pub options: Options,
}

/// How long a map unit is.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetScale {
    /// Metres per map unit, above 0; `null` frees the scale.
    #[serde(deserialize_with = "Option::deserialize")]
    pub metres_per_unit: Option<f64>,
}

/// How tracking a frame ended.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// There was no map yet.
    Initialising,
    /// The pose is good.
    Tracked,
    /// The geometry does not pin the pose down well.
    Weak,
    /// There is no pose.
    Lost,
}

/// What a length of 1 means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// Map units of unknown length.
    UpToScale,
    /// Metres.
    Metric,
}

impl Scale {
    /// Of a session with so many metres per map unit, if anybody has said so.
    pub fn of(metres_per_unit: Option<f64>) -> Self {
        if metres_per_unit.is_some() { Self::Metric } else { Self::UpToScale }
    }
}

/// A session.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Session {
    /// Its name.
    pub id: String,
    /// Its camera, as it was given.
    pub camera: Camera,
    /// Its camera as it was found to be; `null` while it is used as it was given.
    pub refined_camera: Option<Camera>,
    /// What it runs with.
    pub options: Options,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// How tracking its last frame ended; `null` before the first.
    pub state: Option<State>,
    /// What a length of 1 means.
    pub scale: Scale,
    /// Metres per map unit; `null` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// Frames of the trajectory.
    pub n_frames: u64,
    /// Key frames.
    pub n_keyframes: u64,
    /// Points.
    pub n_points: u64,
    /// Lines.
    pub n_lines: u64,
    /// Global primitives.
    pub n_primitives: u64,
    /// Submaps that have key frames.
    pub n_submaps: u32,
    /// Every frame up to this one is in the database; `null` before the first.
    pub durable_sequence: Option<u64>,
    /// The frame the server expects next.
    pub next_sequence: u64,
    /// Time of the last frame, nanoseconds: later ones must be after it; `null` before the first.
    pub last_timestamp_ns: Option<i64>,
    /// Whether the session is in memory.
    pub loaded: bool,
    /// Whether a writer is connected.
    pub has_writer: bool,
}

/// Some sessions in the order of their ids.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SessionPage {
    /// The sessions.
    pub sessions: Vec<Session>,
    /// Where the next page begins; `null` on the last.
    pub next_page_token: Option<String>,
}

/// `world_from_camera`: the camera's position, map units, and orientation as a Hamilton unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Pose {
    /// Position, x.
    pub tx: f64,
    /// Position, y.
    pub ty: f64,
    /// Position, z.
    pub tz: f64,
    /// Orientation, x.
    pub qx: f64,
    /// Orientation, y.
    pub qy: f64,
    /// Orientation, z.
    pub qz: f64,
    /// Orientation, w.
    pub qw: f64,
}

impl From<&geometry::Pose> for Pose {
    fn from(pose: &geometry::Pose) -> Self {
        let (t, q) = (&pose.translation, pose.rotation.quaternion());
        Self { tx: t.x, ty: t.y, tz: t.z, qx: q.i, qy: q.j, qz: q.k, qw: q.w }
    }
}

impl CreateSession {
    /// The service's terms.
    ///
    /// # Errors
    /// If the id is not one.
    pub fn into_new_session(self) -> Result<NewSession, ApiError> {
        let id = self.id.filter(|id| !id.is_empty());
        let id = id.map(|id| SessionId::parse(&id, "id")).transpose()?;
        Ok(NewSession { id, camera: self.camera.into(), options: self.options.into() })
    }
}

impl From<Camera> for CameraParameters {
    fn from(camera: Camera) -> Self {
        let Camera { model, width, height, fx, fy, cx, cy, distortion } = camera;
        let model = match model {
            Model::Pinhole => CameraModel::Pinhole,
            Model::Radtan => CameraModel::Radtan,
            Model::KannalaBrandt => CameraModel::KannalaBrandt,
            Model::Fov => CameraModel::Fov,
        };
        Self { model, width, height, fx, fy, cx, cy, distortion }
    }
}

impl From<CameraParameters> for Camera {
    fn from(camera: CameraParameters) -> Self {
        let CameraParameters { model, width, height, fx, fy, cx, cy, distortion } = camera;
        let model = match model {
            CameraModel::Pinhole => Model::Pinhole,
            CameraModel::Radtan => Model::Radtan,
            CameraModel::KannalaBrandt => Model::KannalaBrandt,
            CameraModel::Fov => Model::Fov,
        };
        Self { model, width, height, fx, fy, cx, cy, distortion }
    }
}

/// The fields are the same on both sides; naming each makes the compiler see when one is added.
macro_rules! convert_options {
    ($from:ty => $to:ty) => {
        impl From<$from> for $to {
            fn from(options: $from) -> Self {
                Self {
                    deterministic: options.deterministic,
                    seed: options.seed,
                    n_features: options.n_features,
                    points: options.points,
                    lines: options.lines,
                    global_primitives: options.global_primitives,
                    loop_closing: options.loop_closing,
                    refine_calibration: options.refine_calibration,
                    max_keyframes: options.max_keyframes,
                }
            }
        }
    };
}
convert_options!(Options => store::SessionOptions);
convert_options!(store::SessionOptions => Options);

impl From<FrameState> for State {
    fn from(state: FrameState) -> Self {
        match state {
            FrameState::Initialising => Self::Initialising,
            FrameState::Tracked => Self::Tracked,
            FrameState::Weak => Self::Weak,
            FrameState::Lost => Self::Lost,
        }
    }
}

impl State {
    /// The state in one word, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Initialising => "initialising",
            Self::Tracked => "tracked",
            Self::Weak => "weak",
            Self::Lost => "lost",
        }
    }
}

impl From<SessionView> for Session {
    fn from(view: SessionView) -> Self {
        Self {
            id: view.id,
            camera: view.camera.into(),
            refined_camera: view.refined_camera.map(Camera::from),
            options: view.options.into(),
            created_at_ns: view.created_at_ns,
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
            loaded: view.loaded,
            has_writer: view.has_writer,
        }
    }
}
