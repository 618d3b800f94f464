//! Trajectories in the formats of the trade, streamed.

use super::extract::{AskedBy, Params};
use super::{App, ProblemDetails};
use crate::error::ApiError;
use crate::maps::{SubmapChoice, TrajectoryKind, TrajectoryPose, TrajectoryQuery};
use crate::model::{Pose, Scale, State as TrackingState};
use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::HeaderName;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use slam::map::SubmapId;
use std::collections::BTreeMap;
use std::fmt::Write;
use tokio_stream::StreamExt;
use utoipa::{IntoParams, ToSchema};

/// How a trajectory is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// `timestamp tx ty tz qx qy qz qw`, seconds with nine decimals.
    #[default]
    Tum,
    /// Comma-separated: nanoseconds, position, quaternion w x y z.
    Euroc,
    /// The upper 3x4 of world_from_camera, row by row; no times.
    Kitti,
    /// Comma-separated with a header and everything that is known.
    Csv,
    /// One object with a list of poses.
    Json,
}

/// Which poses.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// Every frame with a pose.
    #[default]
    Frames,
    /// Keyframes.
    Keyframes,
}

/// Which trajectory and how.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Wanted {
    /// How it is written.
    #[param(inline)]
    format: Format,
    /// Which poses.
    #[param(inline)]
    kind: Kind,
    /// Whose poses: `all`, `largest`, or the number of a submap; submaps do not share a frame of reference.
    /// By default all submaps in `csv` and `json`, which name each pose's, and in the other formats the
    /// largest. How many are left out is told in the header `x-monoslam-poses-left-out`, and in TUM and EuRoC
    /// files of the largest in a comment.
    #[serde(alias = "submap_id")]
    submap: Option<String>,
    /// First time, nanoseconds.
    from_timestamp_ns: Option<i64>,
    /// Last time, nanoseconds.
    to_timestamp_ns: Option<i64>,
}

/// The session's trajectory, world_from_camera, as the map stands now.
#[utoipa::path(get, path = "/v1/sessions/{id}/trajectory", tag = "maps",
    params(("id", description = "The session's id"), Wanted), responses(
    (status = 200, description = "The trajectory", content(
        (String = "text/plain"), (String = "text/csv"), (JsonTrajectory = "application/json"))),
    (status = 400, description = "A parameter is wrong", body = ProblemDetails, content_type = "application/problem+json"),
    (status = 404, description = "No such session", body = ProblemDetails, content_type = "application/problem+json")
))]
pub(super) async fn trajectory(
    State(app): State<App>,
    AskedBy(caller): AskedBy,
    Path(id): Path<String>,
    Params(wanted): Params<Wanted>,
) -> Result<impl IntoResponse, ApiError> {
    let id = caller.session(&id, "id")?;
    let submaps =
        match wanted.submap.as_deref() {
            None | Some("") => wanted.format.submaps(),
            Some("all") => SubmapChoice::All,
            Some("largest") => SubmapChoice::Largest,
            Some(number) => SubmapChoice::One(SubmapId(number.parse().map_err(|_| {
                ApiError::invalid("submap", "must be all, largest, or the number of a submap")
            })?)),
        };
    let query = TrajectoryQuery {
        kind: match wanted.kind {
            Kind::Frames => TrajectoryKind::Frames,
            Kind::Keyframes => TrajectoryKind::Keyframes,
        },
        from_timestamp_ns: wanted.from_timestamp_ns,
        to_timestamp_ns: wanted.to_timestamp_ns,
        submaps,
    };
    let n_left_out = app.service.maps().n_poses_left_out(&id, query.kind, query.submaps).await?;
    let left_out = match query.submaps {
        SubmapChoice::Largest => LeftOut::of(&app.service.maps().poses_by_submap(&id, query.kind).await?),
        _ => LeftOut::default(),
    };
    let answer = app.service.maps().trajectory(&id, &query).await?;

    let mut writer = TrajectoryWriter::new(wanted.format);
    let head = left_out.comment(wanted.format) + &writer.head(&id.to_string(), answer.scale);
    let tail = writer.tail();
    let body = answer
        .value
        .map(move |poses| poses.map(|poses| poses.iter().map(|pose| writer.pose(pose)).collect::<String>()));
    let whole = tokio_stream::once(Ok(head)).chain(body).chain(tokio_stream::once(Ok(tail)));
    let chunks = whole.filter(|chunk| !matches!(chunk, Ok(text) if text.is_empty()));
    let chunks = chunks.map(|chunk| chunk.map(Bytes::from));
    let headers =
        [(CONTENT_TYPE, wanted.format.media_type().to_owned()), (POSES_LEFT_OUT, n_left_out.to_string())];
    Ok((headers, Body::from_stream(chunks)))
}

/// The header that tells how many poses a trajectory does not have, of submaps that are not the largest.
const POSES_LEFT_OUT: HeaderName = HeaderName::from_static("x-monoslam-poses-left-out");

/// What is not written of a session with several frames of reference.
#[derive(Debug, Default, PartialEq, Eq)]
struct LeftOut {
    n_poses: u64,
    n_all: u64,
    /// The submaps that have them, and how many.
    submaps: Vec<(SubmapId, u64)>,
}

/// Submaps named in a comment.
const MAX_NAMED: usize = 8;

impl LeftOut {
    fn of(n_poses: &BTreeMap<SubmapId, u64>) -> Self {
        let mut submaps: Vec<(SubmapId, u64)> = n_poses.iter().map(|(submap, n)| (*submap, *n)).collect();
        submaps.sort_by_key(|(submap, n)| (std::cmp::Reverse(*n), *submap));
        let n_all = submaps.iter().map(|(_, n)| n).sum();
        submaps.drain(..submaps.len().min(1));
        Self { n_poses: submaps.iter().map(|(_, n)| n).sum(), n_all, submaps }
    }

    /// A line that readers of the format pass over.
    fn comment(&self, format: Format) -> String {
        if self.n_poses == 0 || !matches!(format, Format::Tum | Format::Euroc) {
            return String::new();
        }
        let named: Vec<String> = self
            .submaps
            .iter()
            .take(MAX_NAMED)
            .map(|(submap, n)| format!("submap={submap} has {n}"))
            .collect();
        let more = if self.submaps.len() > MAX_NAMED { ", …" } else { "" };
        format!(
            "# {} of {} poses; {} are left out, in frames of reference of their own: {}{more}\n",
            self.n_all - self.n_poses,
            self.n_all,
            self.n_poses,
            named.join(", ")
        )
    }
}

impl Format {
    /// Whose poses are written when nothing else is asked for: several frames of reference can only be told
    /// apart where each pose names its submap.
    fn submaps(self) -> SubmapChoice {
        match self {
            Self::Tum | Self::Euroc | Self::Kitti => SubmapChoice::Largest,
            Self::Csv | Self::Json => SubmapChoice::All,
        }
    }

    fn media_type(self) -> &'static str {
        match self {
            Self::Tum | Self::Kitti => "text/plain; charset=utf-8",
            Self::Euroc | Self::Csv => "text/csv; charset=utf-8",
            Self::Json => "application/json",
        }
    }
}

/// The JSON format, which is written pose by pose.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it is there to be described")]
struct JsonTrajectory {
    session_id: String,
    /// What the poses are: `world_from_camera`.
    transform: String,
    scale: Scale,
    poses: Vec<JsonPose>,
}

/// A pose in the JSON format.
#[derive(Serialize, ToSchema)]
struct JsonPose {
    sequence: u64,
    timestamp_ns: i64,
    /// For programs whose numbers do not hold all the digits.
    timestamp_ns_text: String,
    state: TrackingState,
    submap_id: u32,
    backfilled: bool,
    world_from_camera: Pose,
}

/// Writes a trajectory piece by piece.
#[derive(Clone, Debug)]
pub struct TrajectoryWriter {
    format: Format,
    n_written: u64,
}

impl TrajectoryWriter {
    /// A writer of this format.
    pub fn new(format: Format) -> Self {
        Self { format, n_written: 0 }
    }

    /// What comes before the poses.
    pub(super) fn head(&self, id: &str, scale: Scale) -> String {
        match self.format {
            Format::Tum | Format::Kitti => String::new(),
            Format::Euroc => {
                "#timestamp [ns],p_RS_R_x,p_RS_R_y,p_RS_R_z,q_RS_w,q_RS_x,q_RS_y,q_RS_z\n".to_owned()
            }
            Format::Csv => {
                "sequence,timestamp_ns,state,submap_id,backfilled,tx,ty,tz,qx,qy,qz,qw\n".to_owned()
            }
            Format::Json => {
                let scale = if scale == Scale::Metric { "metric" } else { "up_to_scale" };
                format!(
                    "{{\"session_id\":\"{id}\",\"transform\":\"world_from_camera\",\"scale\":\"{scale}\",\"poses\":["
                )
            }
        }
    }

    /// One pose.
    pub fn pose(&mut self, pose: &TrajectoryPose) -> String {
        let Pose { tx, ty, tz, qx, qy, qz, qw } = Pose::from(&pose.world_from_camera);
        let TrajectoryPose { sequence, timestamp_ns, submap, backfilled, .. } = *pose;
        let state = TrackingState::from(pose.state);
        self.n_written += 1;
        match self.format {
            Format::Tum => format!("{} {tx} {ty} {tz} {qx} {qy} {qz} {qw}\n", seconds(timestamp_ns)),
            Format::Euroc => format!("{timestamp_ns},{tx},{ty},{tz},{qw},{qx},{qy},{qz}\n"),
            Format::Kitti => kitti_row(&pose.world_from_camera),
            Format::Csv => {
                let state = state.name();
                format!(
                    "{sequence},{timestamp_ns},{state},{submap},{backfilled},{tx},{ty},{tz},{qx},{qy},{qz},{qw}\n"
                )
            }
            Format::Json => {
                let world_from_camera = Pose { tx, ty, tz, qx, qy, qz, qw };
                let submap_id = submap.0;
                let timestamp_ns_text = timestamp_ns.to_string();
                let row = JsonPose {
                    sequence,
                    timestamp_ns,
                    timestamp_ns_text,
                    state,
                    submap_id,
                    backfilled,
                    world_from_camera,
                };
                let comma = if self.n_written == 1 { "\n" } else { ",\n" };
                // Numbers and words only: nothing that JSON cannot say, as poses are finite.
                format!("{comma}{}", serde_json::to_string(&row).unwrap_or_default())
            }
        }
    }

    /// What comes after the poses.
    pub(super) fn tail(&self) -> String {
        if self.format == Format::Json { "\n]}\n".to_owned() } else { String::new() }
    }
}

/// Nanoseconds as seconds with nine decimals, exactly.
fn seconds(timestamp_ns: i64) -> String {
    let sign = if timestamp_ns < 0 { "-" } else { "" };
    let magnitude = timestamp_ns.unsigned_abs();
    format!("{sign}{}.{:09}", magnitude / 1_000_000_000, magnitude % 1_000_000_000)
}

fn kitti_row(world_from_camera: &geometry::Pose) -> String {
    let (r, t) = (world_from_camera.rotation_matrix(), world_from_camera.translation);
    let mut row = String::new();
    for i in 0..3 {
        let space = if i == 0 { "" } else { " " };
        let _ = write!(row, "{space}{} {} {} {}", r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]);
    }
    row.push('\n');
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::nalgebra::{UnitQuaternion, Vector3};
    use slam::map::{FrameState, KeyframeId};

    fn pose() -> TrajectoryPose {
        // A quarter turn about z, so that every format shows a different order of numbers.
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        TrajectoryPose {
            sequence: 7,
            timestamp_ns: 1_403_636_579_763_555_584,
            submap: SubmapId(0),
            state: FrameState::Tracked,
            backfilled: false,
            reference: KeyframeId::new(1).unwrap(),
            world_from_camera: geometry::Pose::new(rotation, Vector3::new(1.0, 2.5, -3.0)),
        }
    }

    fn written(format: Format) -> String {
        let mut writer = TrajectoryWriter::new(format);
        let head = writer.head("kitchen", Scale::UpToScale);
        let body = writer.pose(&pose()) + &writer.pose(&pose());
        head + &body + &writer.tail()
    }

    #[test]
    fn tum_has_exact_times_and_the_quaternion_last() {
        let text = written(Format::Tum);
        let fields: Vec<_> = text.lines().next().unwrap().split(' ').collect();
        assert_eq!(fields[..4], ["1403636579.763555584", "1", "2.5", "-3"]);
        let quaternion: Vec<f64> = fields[4..].iter().map(|field| field.parse().unwrap()).collect();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(quaternion.iter().zip([0.0, 0.0, half, half]).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn what_is_left_out_is_told() {
        let of =
            |counts: &[(u32, u64)]| LeftOut::of(&counts.iter().map(|(id, n)| (SubmapId(*id), *n)).collect());
        let two = of(&[(0, 122), (1, 149)]);
        let comment =
            "# 149 of 271 poses; 122 are left out, in frames of reference of their own: submap=0 has 122\n";
        assert_eq!(two.comment(Format::Tum), comment);
        assert_eq!((two.n_poses, two.comment(Format::Kitti).as_str()), (122, ""));
        assert_eq!(
            (of(&[(3, 9)]).comment(Format::Tum), of(&[]).comment(Format::Tum)),
            (String::new(), String::new())
        );
    }

    #[test]
    fn times_before_1970_keep_their_sign() {
        assert_eq!(seconds(-1), "-0.000000001");
        assert_eq!(seconds(0), "0.000000000");
        assert_eq!(seconds(i64::MIN), "-9223372036.854775808");
    }

    #[test]
    fn euroc_puts_the_real_part_first() {
        let line = written(Format::Euroc).lines().nth(1).unwrap().to_owned();
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        assert!((fields[4] - std::f64::consts::FRAC_1_SQRT_2).abs() < 1e-12 && fields[5].abs() < 1e-12);
    }

    #[test]
    fn kitti_is_the_matrix_row_by_row() {
        let line = written(Format::Kitti).lines().next().unwrap().to_owned();
        let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
        let expected = [0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.5, 0.0, 0.0, 1.0, -3.0];
        assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{numbers:?}");
    }

    #[test]
    fn json_is_json() {
        let value: serde_json::Value = serde_json::from_str(&written(Format::Json)).unwrap();
        assert_eq!(value["poses"].as_array().unwrap().len(), 2);
        assert_eq!(value["poses"][1]["timestamp_ns"], 1_403_636_579_763_555_584_i64);
        assert_eq!(value["scale"], "up_to_scale");
        let empty = TrajectoryWriter::new(Format::Json);
        let text = empty.head("a", Scale::Metric) + &empty.tail();
        assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok());
    }
}
