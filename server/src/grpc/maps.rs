//! Questions about maps, answered in streams.

use super::convert;
use crate::access::Caller;
use crate::error::ApiError;
use crate::ids::checked_id;
use crate::maps::{
    Batches, BoundingBox, ColmapPart, Keyframe, Line, LineQuery, MapFormat, MapQueries, Place, Point,
    PointQuery, Primitive, Scaled, SubmapChoice, TrajectoryKind, TrajectoryPose, TrajectoryQuery,
};
use crate::model::Pose;
use futures_util::stream::{self, BoxStream, StreamExt};
use proto::v1;
use proto::v1::export_map_response::Part;
use slam::map::SubmapId;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

/// The server's side of an answer.
pub type Rows<T> = BoxStream<'static, Result<T, Status>>;

pub async fn keyframes(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::ListKeyframesRequest,
) -> Result<Rows<v1::ListKeyframesResponse>, ApiError> {
    let id = super::session_id(caller, &request.session_id)?;
    let Scaled { scale, value } = maps.all_keyframes(&id).await?;
    let scale = convert::scale(scale).into();
    Ok(rows(value, keyframe, move |keyframes| v1::ListKeyframesResponse { scale, keyframes }))
}

pub async fn points(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::QueryPointsRequest,
) -> Result<Rows<v1::QueryPointsResponse>, ApiError> {
    let v1::QueryPointsRequest { session_id, bbox, near, radius, min_observations, submap_id } = request;
    let id = super::session_id(caller, &session_id)?;
    let place = place(bbox, near, radius)?;
    let query = PointQuery { place, min_observations, submap: submap_id.map(SubmapId) };
    let Scaled { scale, value } = maps.all_points(&id, &query).await?;
    let scale = convert::scale(scale).into();
    Ok(rows(value, point, move |points| v1::QueryPointsResponse { scale, points }))
}

pub async fn lines(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::QueryLinesRequest,
) -> Result<Rows<v1::QueryLinesResponse>, ApiError> {
    let v1::QueryLinesRequest { session_id, bbox, near, radius, min_observations, submap_id, primitive_id } =
        request;
    let id = super::session_id(caller, &session_id)?;
    let place = place(bbox, near, radius)?;
    let primitive = primitive_id.map(|number| checked_id("primitive_id", number)).transpose()?;
    let query = LineQuery { place, min_observations, submap: submap_id.map(SubmapId), primitive };
    let Scaled { scale, value } = maps.all_lines(&id, &query).await?;
    let scale = convert::scale(scale).into();
    Ok(rows(value, line, move |lines| v1::QueryLinesResponse { scale, lines }))
}

pub async fn primitives(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::ListPrimitivesRequest,
) -> Result<Rows<v1::ListPrimitivesResponse>, ApiError> {
    let id = super::session_id(caller, &request.session_id)?;
    let primitives = maps.all_primitives(&id, request.submap_id.map(SubmapId)).await?;
    Ok(rows(primitives, primitive, |primitives| v1::ListPrimitivesResponse { primitives }))
}

pub async fn trajectory(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::GetTrajectoryRequest,
) -> Result<Rows<v1::GetTrajectoryResponse>, ApiError> {
    let id = super::session_id(caller, &request.session_id)?;
    let kind = match v1::TrajectoryKind::try_from(request.kind) {
        Ok(v1::TrajectoryKind::Unspecified | v1::TrajectoryKind::Frames) => TrajectoryKind::Frames,
        Ok(v1::TrajectoryKind::Keyframes) => TrajectoryKind::Keyframes,
        Err(_) => return Err(ApiError::invalid("kind", "must be FRAMES or KEYFRAMES")),
    };
    let submaps = match (request.submap_id, v1::SubmapSelection::try_from(request.submaps)) {
        (Some(id), Ok(v1::SubmapSelection::Unspecified)) => SubmapChoice::One(SubmapId(id)),
        (Some(_), _) => {
            return Err(ApiError::invalid("submap_id", "is given beside submaps; leave one out"));
        }
        (None, Ok(v1::SubmapSelection::Unspecified | v1::SubmapSelection::All)) => SubmapChoice::All,
        (None, Ok(v1::SubmapSelection::Largest)) => SubmapChoice::Largest,
        (None, Err(_)) => return Err(ApiError::invalid("submaps", "must be ALL or LARGEST")),
    };
    let v1::GetTrajectoryRequest { from_timestamp_ns, to_timestamp_ns, .. } = request;
    let query = TrajectoryQuery { kind, from_timestamp_ns, to_timestamp_ns, submaps };
    let n_poses_left_out = maps.n_poses_left_out(&id, kind, submaps).await?;
    let Scaled { scale, value } = maps.trajectory(&id, &query).await?;
    let scale = convert::scale(scale).into();
    Ok(rows(value, trajectory_pose, move |poses| v1::GetTrajectoryResponse {
        scale,
        poses,
        n_poses_left_out,
    }))
}

pub async fn export(
    maps: &MapQueries,
    caller: &Caller,
    request: v1::ExportMapRequest,
) -> Result<Rows<v1::ExportMapResponse>, ApiError> {
    let id = super::session_id(caller, &request.session_id)?;
    let format = match v1::MapFormat::try_from(request.format) {
        Ok(v1::MapFormat::Ply) => MapFormat::Ply,
        Ok(v1::MapFormat::Json) => MapFormat::Json,
        Ok(v1::MapFormat::ColmapCameras) => MapFormat::Colmap(ColmapPart::Cameras),
        Ok(v1::MapFormat::ColmapImages) => MapFormat::Colmap(ColmapPart::Images),
        Ok(v1::MapFormat::ColmapPoints3d) => MapFormat::Colmap(ColmapPart::Points3D),
        Ok(v1::MapFormat::Transforms) => MapFormat::Transforms,
        Ok(v1::MapFormat::Mcap) => MapFormat::Mcap,
        Ok(v1::MapFormat::Unspecified) | Err(_) => {
            let sentence =
                "must be PLY, JSON, COLMAP_CAMERAS, COLMAP_IMAGES, COLMAP_POINTS3D, TRANSFORMS or MCAP";
            return Err(ApiError::invalid("format", sentence));
        }
    };
    let file = maps.export(&id, format, request.submap_id.map(SubmapId)).await?;
    let head = v1::MapFile {
        name: file.name.clone(),
        media_type: file.media_type.to_owned(),
        n_bytes: file.n_bytes,
    };
    let message = |part| v1::ExportMapResponse { part: Some(part) };
    let chunks = file.into_chunks().await?.map(move |chunk| {
        let data = chunk.map_err(ApiError::internal)?;
        Ok::<_, Status>(message(Part::Data(data)))
    });
    Ok(stream::iter([Ok(message(Part::File(head)))]).chain(chunks).boxed())
}

/// Each batch of rows as a message.
fn rows<T: Send + 'static, R: 'static, M: Send + 'static>(
    batches: Batches<T>,
    row: fn(T) -> R,
    message: impl Fn(Vec<R>) -> M + Send + 'static,
) -> Rows<M> {
    let batches = read_ahead(batches).map(move |batch| {
        let rows = batch.map_err(Status::from)?;
        Ok::<_, Status>(message(rows.into_iter().map(row).collect()))
    });
    batches.boxed()
}

/// The same batches, read by a task of their own, one ahead of the caller.
///
/// The transport asks for no more while a client does not read. A batch that is being read from the database
/// at that moment would keep its reader for as long.
fn read_ahead<T: Send + 'static>(mut batches: Batches<T>) -> Batches<T> {
    let (sender, receiver) = mpsc::channel(1);
    tokio::spawn(async move {
        while let Some(batch) = batches.next().await {
            if sender.send(batch).await.is_err() {
                break;
            }
        }
    });
    ReceiverStream::new(receiver).boxed()
}

fn place(
    bbox: Option<v1::BoundingBox>,
    near: Option<v1::Vector3>,
    radius: Option<f64>,
) -> Result<Place, ApiError> {
    let corner = |field, corner: Option<v1::Vector3>| {
        corner.map(array).ok_or_else(|| ApiError::invalid(field, "is needed in a box"))
    };
    let bbox = match bbox {
        Some(v1::BoundingBox { min, max }) => {
            Some(BoundingBox { min: corner("bbox.min", min)?, max: corner("bbox.max", max)? })
        }
        None => None,
    };
    Ok(Place { bbox, near: near.map(array), radius })
}

fn array(vector: v1::Vector3) -> [f64; 3] {
    [vector.x, vector.y, vector.z]
}

fn vector([x, y, z]: [f64; 3]) -> Option<v1::Vector3> {
    Some(v1::Vector3 { x, y, z })
}

fn keyframe(keyframe: Keyframe) -> v1::Keyframe {
    let Keyframe {
        id,
        submap_id,
        sequence,
        timestamp_ns,
        timestamp_ns_text: _,
        world_from_camera,
        parent,
        n_keypoints,
        n_points,
        n_segments,
        n_lines,
        has_image,
    } = keyframe;
    v1::Keyframe {
        id,
        submap_id,
        sequence,
        timestamp_ns,
        pose_world_from_camera: Some(convert::pose(world_from_camera)),
        parent,
        n_keypoints,
        n_points,
        n_segments,
        n_lines,
        has_image,
    }
}

fn point(point: Point) -> v1::Point {
    let Point { id, submap_id, position, n_observations } = point;
    v1::Point { id, submap_id, position: vector(position), n_observations }
}

fn line(line: Line) -> v1::Line {
    let Line { id, submap_id, start, end, direction, moment, n_observations, primitive_id } = line;
    v1::Line {
        id,
        submap_id,
        start: vector(start),
        end: vector(end),
        direction: vector(direction),
        moment: vector(moment),
        n_observations,
        primitive_id,
    }
}

fn primitive(primitive: Primitive) -> v1::Primitive {
    let Primitive { id, submap_id, direction, covariance, std_deg, n_keyframes, n_lines } = primitive;
    v1::Primitive {
        id,
        submap_id,
        direction: vector(direction),
        covariance: covariance.concat(),
        std_deg,
        n_keyframes,
        n_lines,
    }
}

fn trajectory_pose(pose: TrajectoryPose) -> v1::TrajectoryPose {
    v1::TrajectoryPose {
        sequence: pose.sequence,
        timestamp_ns: pose.timestamp_ns,
        state: convert::tracking_state(pose.state).into(),
        submap_id: pose.submap.0,
        backfilled: pose.backfilled,
        pose_world_from_camera: Some(convert::pose(Pose::from(&pose.world_from_camera))),
    }
}
