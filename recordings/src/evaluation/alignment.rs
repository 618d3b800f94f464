//! Alignment (Umeyama): what is free in an estimate and taken out before it is compared.

use std::str::FromStr;

use geometry::Similarity;
use geometry::nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The freedom given to the estimate before it is compared with the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Alignment {
    /// Rotation, translation and scale: what one camera leaves open.
    #[default]
    Sim3,
    /// Rotation and translation: for maps whose scale has been set.
    Se3,
    /// Nothing: both are in the same frame already.
    None,
}

impl Alignment {
    /// The motion that brings the estimate onto the truth; `None` where the positions do not determine one.
    pub(super) fn truth_from_estimate(
        self,
        truth: &[Vector3<f64>],
        estimate: &[Vector3<f64>],
    ) -> Option<Similarity> {
        match self {
            Self::None => Some(Similarity::identity()),
            Self::Se3 => Similarity::from_correspondences(estimate, truth, false),
            Self::Sim3 => Similarity::from_correspondences(estimate, truth, true),
        }
    }
}

impl FromStr for Alignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "sim3" => Ok(Self::Sim3),
            "se3" => Ok(Self::Se3),
            "none" => Ok(Self::None),
            _ => Err(format!("`{text}` is not an alignment: sim3, se3 or none")),
        }
    }
}
