//! How many metres a map unit is, from what somebody has measured: a distance between two places of the map,
//! or positions of the camera.

mod places;
mod positions;

pub use places::{KnownDistance, ScalePlace};
pub use positions::{ReferencePositions, ReferenceRow, When};

use crate::error::{ApiError, ErrorCode};
use crate::session::SessionId;
use geometry::{CameraParameters, Pose};
use store::Store;

/// Where a scale comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum ScaleSource {
    /// Nobody knows it.
    Free,
    /// Somebody says it, metres per map unit.
    Given(f64),
    /// From a distance.
    Distance(KnownDistance),
    /// From positions.
    Positions(ReferencePositions),
}

/// What a scale was found from.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// The scale.
    pub metres_per_unit: f64,
    /// Of a known distance: the distance in the map, map units.
    pub map_distance: Option<f64>,
    /// Of a known distance: what the two places are.
    pub places: Vec<String>,
    /// Of reference positions: what became of each row, in their order.
    pub residuals: Vec<Residual>,
    /// Root mean square of the residuals of the rows that were used, metres.
    pub rms_m: Option<f64>,
    /// Rows that were used.
    pub n_used: u32,
    /// Takes the map, in metres, to the frame of the reference positions.
    pub reference_from_map: Option<Pose>,
    /// The submap it was measured in.
    pub submap: u32,
}

/// What became of a row of reference positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Residual {
    /// How far it is from the camera's way, metres; `None` where the camera's place is not known.
    pub error_m: Option<f64>,
    /// Whether it was used.
    pub used: bool,
    /// Why not.
    pub reason: String,
}

/// Measures a scale; `None` if there is nothing to measure.
///
/// # Errors
/// If a place is not in the map, or what was given does not determine the scale.
pub async fn measure(
    store: &Store,
    id: &SessionId,
    source: &ScaleSource,
) -> Result<Option<Measurement>, ApiError> {
    match source {
        ScaleSource::Free | ScaleSource::Given(_) => Ok(None),
        ScaleSource::Distance(known) => places::measure(store, id, known).await.map(Some),
        ScaleSource::Positions(positions) => positions::measure(store, id, positions).await.map(Some),
    }
}

fn undetermined(sentence: impl Into<String>) -> ApiError {
    ApiError::new(ErrorCode::ScaleUndetermined, sentence)
}

/// From a session's image to the image that its features are in.
fn working_factors(camera: &CameraParameters, working: &geometry::Camera) -> [f64; 2] {
    let factor = |working: u32, own: u32| f64::from(working) / f64::from(own);
    [factor(working.width(), camera.width), factor(working.height(), camera.height)]
}
