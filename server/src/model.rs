//! What callers are told in, whichever interface they ask by: cameras, states, poses, and what a length of 1
//! means.
//!
//! Serialized, these are the JSON of the HTTP interface and of exported files; the gRPC interface has
//! messages of its own.

use geometry::nalgebra::Vector3;
use geometry::{CameraModel, CameraParameters};
use serde::{Deserialize, Serialize};
use slam::map::FrameState;
use utoipa::ToSchema;

/// A camera's calibration. Lengths are pixels; the origin is the center of the top-left pixel.
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
    /// Horizontal focal length. All four left out: the camera is given by its size alone.
    #[schema(example = 525.0)]
    #[serde(default)]
    pub fx: f64,
    /// Vertical focal length.
    #[schema(example = 525.0)]
    #[serde(default)]
    pub fy: f64,
    /// Principal point, horizontal.
    #[schema(example = 319.5)]
    #[serde(default)]
    pub cx: f64,
    /// Principal point, vertical.
    #[schema(example = 239.5)]
    #[serde(default)]
    pub cy: f64,
    /// Coefficients of the model: none; `k1 k2 p1 p2 [k3 [k4 k5 k6]]`; `k1 k2 k3 k4`; `omega`;
    /// `alpha beta`; `xi alpha`.
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
    /// Extended unified model; with a second coefficient of 1 the unified model.
    Eucm,
    /// Double sphere.
    DoubleSphere,
}

impl From<Camera> for CameraParameters {
    fn from(camera: Camera) -> Self {
        let Camera { model, width, height, fx, fy, cx, cy, distortion } = camera;
        let model = match model {
            Model::Pinhole => CameraModel::Pinhole,
            Model::Radtan => CameraModel::Radtan,
            Model::KannalaBrandt => CameraModel::KannalaBrandt,
            Model::Fov => CameraModel::Fov,
            Model::Eucm => CameraModel::ExtendedUnified,
            Model::DoubleSphere => CameraModel::DoubleSphere,
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
            CameraModel::ExtendedUnified => Model::Eucm,
            CameraModel::DoubleSphere => Model::DoubleSphere,
        };
        Self { model, width, height, fx, fy, cx, cy, distortion }
    }
}

/// How tracking a frame ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
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

/// What a map unit is in the lengths of answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Units {
    metres_per_unit: Option<f64>,
}

impl Units {
    /// Of a session with so many metres per map unit, if anybody has said so.
    pub fn new(metres_per_unit: Option<f64>) -> Self {
        Self { metres_per_unit }
    }

    /// How answers are labeled.
    pub fn scale(self) -> Scale {
        Scale::of(self.metres_per_unit)
    }

    fn factor(self) -> f64 {
        self.metres_per_unit.unwrap_or(1.0)
    }

    /// A length of a request in map units.
    pub fn to_map(self, length: f64) -> f64 {
        length / self.factor()
    }

    /// A place of the map in an answer.
    pub fn position(self, position: &Vector3<f64>) -> [f64; 3] {
        (position * self.factor()).into()
    }

    /// A pose of the map with its place in the unit of answers.
    pub fn scaled(self, pose: &geometry::Pose) -> geometry::Pose {
        geometry::Pose::new(pose.rotation, pose.translation * self.factor())
    }

    /// A pose of the map in an answer.
    pub fn pose(self, pose: &geometry::Pose) -> Pose {
        Pose::from(&self.scaled(pose))
    }
}
