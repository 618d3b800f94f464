//! How many metres a map unit is.

use super::extract::{AskedBy, Body};
use super::model::Session;
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::ids::checked_id;
use crate::model::Pose;
use crate::scale::{
    KnownDistance, Measurement, ReferencePositions, ReferenceRow, Residual, ScalePlace, ScaleSource, When,
};
use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

/// How long a map unit is: exactly one of the three.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SetScale {
    /// Metres per map unit, above 0; `null` frees the scale.
    #[serde(default, deserialize_with = "told")]
    #[schema(value_type = Option<f64>)]
    metres_per_unit: Option<Option<f64>>,
    /// Two places of the map whose distance is known; they must be in one submap.
    #[serde(default)]
    distance: Option<Distance>,
    /// Where the camera was by another measurement, such as GPS in a local frame or motion capture.
    #[serde(default)]
    positions: Option<Positions>,
}

/// `null` is something else than nothing.
fn told<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Option<f64>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

/// Two places of a map, and how far apart they are.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Distance {
    /// The one.
    from: PlaceOfMap,
    /// The other.
    to: PlaceOfMap,
    /// Metres between them, above 0.
    metres: f64,
}

/// A place of a map: exactly one of the three, where a pixel needs a keyframe as well.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaceOfMap {
    /// A point of the map.
    #[serde(default)]
    point_id: Option<u64>,
    /// Where a keyframe's camera was; with `pixel`, whose image it is a pixel of.
    #[serde(default)]
    keyframe_id: Option<u64>,
    /// A pixel of the keyframe's image, of the session's image size. It must show a point of the map within
    /// 12 pixels, or a line within 4.
    #[serde(default)]
    pixel: Option<[f64; 2]>,
}

/// Where the camera was: three rows at least, not all on one line. Rows that disagree with the others are
/// named and left out.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Positions {
    /// The rows, at most 100 000.
    rows: Vec<PositionRow>,
    /// Rows this far off or farther are left out, metres. Left out: what the rows themselves say.
    #[serde(default)]
    max_error_m: Option<f64>,
}

/// Where the camera was with a frame, or at a time.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PositionRow {
    /// The frame's number.
    #[serde(default)]
    sequence: Option<u64>,
    /// Or the time by the frames' clock, nanoseconds.
    #[serde(default)]
    timestamp_ns: Option<i64>,
    /// Where, metres.
    position: [f64; 3],
}

/// The session, and what its scale was found from.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct ScaledSession {
    #[serde(flatten)]
    session: Session,
    /// What the scale was found from; absent where it was said or freed.
    #[serde(skip_serializing_if = "Option::is_none")]
    scale_measurement: Option<ScaleMeasurement>,
}

/// What a scale was found from.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct ScaleMeasurement {
    /// The scale.
    metres_per_unit: f64,
    /// Of a known distance: the distance in the map, map units.
    map_distance: Option<f64>,
    /// Of a known distance: what the two places are.
    places: Vec<String>,
    /// Of reference positions: what became of each row, in their order.
    residuals: Vec<ScaleResidual>,
    /// Root mean square of the residuals of the rows that were used, metres.
    rms_m: Option<f64>,
    /// Rows that were used.
    n_used: u32,
    /// Takes the map, in metres, to the frame of the reference positions.
    reference_from_map: Option<Pose>,
    /// The submap it was measured in.
    submap_id: u32,
}

/// What became of a row of reference positions.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(super) struct ScaleResidual {
    /// How far it is from the camera's way, metres; `null` for a row whose frame has no pose in the submap.
    error_m: Option<f64>,
    /// Whether it was used.
    used: bool,
    /// Why not, in a plain sentence.
    reason: String,
}

impl SetScale {
    fn source(self) -> Result<ScaleSource, ApiError> {
        match (self.metres_per_unit, self.distance, self.positions) {
            (Some(Some(metres)), None, None) => Ok(ScaleSource::Given(metres)),
            (Some(None), None, None) => Ok(ScaleSource::Free),
            (None, Some(Distance { from, to, metres }), None) => {
                let (from, to) = (from.place("distance.from")?, to.place("distance.to")?);
                Ok(ScaleSource::Distance(KnownDistance { from, to, metres }))
            }
            (None, None, Some(Positions { rows, max_error_m })) => {
                let rows = rows.iter().enumerate().map(|(idx, row)| row.checked(idx));
                let rows = rows.collect::<Result<_, _>>()?;
                Ok(ScaleSource::Positions(ReferencePositions { rows, max_error_m }))
            }
            _ => {
                let sentence = "must be given, or else distance or positions; and one of them only";
                Err(ApiError::invalid("metres_per_unit", sentence))
            }
        }
    }
}

impl PlaceOfMap {
    fn place(&self, field: &str) -> Result<ScalePlace, ApiError> {
        match (self.point_id, self.keyframe_id, self.pixel) {
            (Some(point), None, None) => {
                Ok(ScalePlace::Point(checked_id(&format!("{field}.point_id"), point)?))
            }
            (None, Some(keyframe), pixel) => {
                let keyframe = checked_id(&format!("{field}.keyframe_id"), keyframe)?;
                Ok(pixel
                    .map_or(ScalePlace::Keyframe(keyframe), |pixel| ScalePlace::Pixel { keyframe, pixel }))
            }
            _ => Err(ApiError::invalid(
                field,
                "must be a point_id, a keyframe_id, or a keyframe_id with a pixel",
            )),
        }
    }
}

impl PositionRow {
    fn checked(&self, idx: usize) -> Result<ReferenceRow, ApiError> {
        let when = match (self.sequence, self.timestamp_ns) {
            (Some(sequence), None) => When::Sequence(sequence),
            (None, Some(time)) => When::Timestamp(time),
            _ => {
                let field = format!("positions.rows[{idx}].sequence");
                return Err(ApiError::invalid(
                    field,
                    "or timestamp_ns must say which frame it is of, not both",
                ));
            }
        };
        Ok(ReferenceRow { when, position: self.position })
    }
}

impl From<Measurement> for ScaleMeasurement {
    fn from(measured: Measurement) -> Self {
        let residual = |residual: Residual| ScaleResidual {
            error_m: residual.error_m,
            used: residual.used,
            reason: residual.reason,
        };
        Self {
            metres_per_unit: measured.metres_per_unit,
            map_distance: measured.map_distance,
            places: measured.places,
            residuals: measured.residuals.into_iter().map(residual).collect(),
            rms_m: measured.rms_m,
            n_used: measured.n_used,
            reference_from_map: measured.reference_from_map.as_ref().map(Pose::from),
            submap_id: measured.submap,
        }
    }
}

/// Says how many metres a map unit is, directly or by a known distance or positions. Every length of later
/// answers is in metres then.
#[utoipa::path(post, path = "/v1/sessions/{id}/scale", tag = "maps", params(("id", description = "The session's id")),
    request_body = SetScale, responses(
    (status = 200, description = "The session", body = ScaledSession),
    (status = 400, description = "A field is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session or keyframe", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 409, description = "An operation works on the session", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 422, description = "What was given does not determine the scale", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn scale(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Body(request): Body<SetScale>,
) -> Result<Json<ScaledSession>, ApiError> {
    let id = caller.session(&id, "id")?;
    let (view, measured) = app.service.set_scale(&caller, &id, request.source()?).await?;
    let scale_measurement = measured.map(ScaleMeasurement::from);
    Ok(Json(ScaledSession { session: view.into(), scale_measurement }))
}
