//! Lengths: rows are in map units, answers in metres once somebody has said how long a unit is.

use super::App;
use super::model::{Pose, Scale};
use crate::error::ApiError;
use crate::session::SessionId;
use geometry::nalgebra::Vector3;

/// What a map unit is in the lengths of answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Units {
    metres_per_unit: Option<f64>,
}

impl Units {
    /// Of a session with so many metres per map unit, if anybody has said so.
    pub fn new(metres_per_unit: Option<f64>) -> Self {
        Self { metres_per_unit }
    }

    /// Of a stored session.
    pub async fn of(app: &App, id: &SessionId) -> Result<Self, ApiError> {
        Ok(Self::new(app.service.get_session(id).await?.metres_per_unit))
    }

    /// How answers are labelled.
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

    /// A pose of the map in an answer.
    pub fn pose(self, pose: &geometry::Pose) -> Pose {
        (&geometry::Pose::new(pose.rotation, pose.translation * self.factor())).into()
    }
}
