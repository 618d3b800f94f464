//! An MCAP file with Foxglove's schemas, to be looked at by its viewer and others of the kind.
//!
//! | topic | has |
//! |---|---|
//! | `/map/points` | every point, gray as in the images |
//! | `/map/lines` | every line, colored by its global primitive |
//! | `/tf` | where `map` is in `world`, which has z upwards, and where `camera` is in `map`, of each frame |
//! | `/camera/pose` | the same as poses |
//! | `/camera/image` | the images of keyframes |
//! | `/camera/calibration` | the camera |

use super::Export;
use super::foxglove::{self, Cloud, Lines, Schema};
use super::ply::{BLUE, color_of};
use crate::error::ApiError;
use crate::model::Pose;
use futures_util::TryStreamExt;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use serde_json::Value;
use slam::map::{KeyframeId, SubmapId};
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};
use store::{SubmapChoice, TrajectoryFilter, TrajectoryKind};

/// Points of a cloud at most: a cloud is one message and in memory as a whole, at 38 bytes a point. Of a
/// larger map every second point is taken, or every third, and so on.
const MAX_POINTS: u64 = 1 << 20;

/// Lines at most, likewise, at some 200 bytes a line.
const MAX_LINES: u64 = 1 << 17;

/// Where the map is in a frame whose z axis points up, if the first camera was held level: it looks along x.
const WORLD_FROM_MAP: Pose = Pose { tx: 0.0, ty: 0.0, tz: 0.0, qx: -0.5, qy: 0.5, qz: -0.5, qw: 0.5 };

/// Topics and their schemas, in the order of their numbers.
const TOPICS: [(&str, Schema); 6] = [
    ("/tf", Schema::FrameTransform),
    ("/map/points", Schema::PointCloud),
    ("/map/lines", Schema::SceneUpdate),
    ("/camera/pose", Schema::PoseInFrame),
    ("/camera/image", Schema::CompressedImage),
    ("/camera/calibration", Schema::CameraCalibration),
];

pub(super) async fn write(export: &mut Export) -> Result<(), ApiError> {
    let mut recorder = Recorder::new()?;
    let keyframes = keyframes(export).await?;
    let submap = export.submap.unwrap_or_default();
    let filter = TrajectoryFilter { submaps: SubmapChoice::One(submap), ..TrajectoryFilter::default() };
    let id = export.session.id.clone();
    let mut poses = export.store.trajectory(id.as_str(), TrajectoryKind::Frames, filter).await?;
    let first = poses.try_next().await?;
    let start_ns = first.as_ref().map_or(0, |pose| time_ns(pose.timestamp_ns));
    write_map(export, &mut recorder, start_ns, submap).await?;

    let mut next = first;
    while let Some(pose) = next {
        let timestamp_ns = time_ns(pose.timestamp_ns);
        // A keyframe's own pose is better than that of its frame, which hangs on the keyframe before.
        let keyframe = keyframes.get(&pose.sequence);
        let world_from_camera =
            keyframe.map_or(pose.world_from_camera, |keyframe| keyframe.world_from_camera);
        let map_from_camera = export.units.pose(&world_from_camera);
        let transform = foxglove::frame_transform(timestamp_ns, "map", "camera", &map_from_camera);
        recorder.add(Schema::FrameTransform, timestamp_ns, &transform)?;
        let in_map = foxglove::pose_in_frame(timestamp_ns, "map", &map_from_camera);
        recorder.add(Schema::PoseInFrame, timestamp_ns, &in_map)?;
        if let Some(keyframe) = keyframe.filter(|keyframe| keyframe.has_image)
            && let Some(image) = export.store.keyframe_image(id.as_str(), keyframe.id).await?
        {
            let format = image.media_type.strip_prefix("image/").unwrap_or(&image.media_type);
            let image = foxglove::compressed_image(timestamp_ns, "camera", format, &image.bytes);
            recorder.add(Schema::CompressedImage, timestamp_ns, &image)?;
        }
        export.out.write_bytes(&recorder.written()).await?;
        next = poses.try_next().await?;
    }
    let rest = recorder.finish()?;
    export.out.write_bytes(&rest).await
}

/// A keyframe, as far as it is written.
struct Keyframe {
    id: KeyframeId,
    world_from_camera: geometry::Pose,
    has_image: bool,
}

/// The keyframes by the number of their frame.
async fn keyframes(export: &mut Export) -> Result<BTreeMap<u64, Keyframe>, ApiError> {
    let (mut keyframes, mut after) = (BTreeMap::new(), None);
    while let Some(records) = export.keyframes_after(&mut after).await? {
        let rows = records.into_iter().map(|record| {
            let world_from_camera = record.camera_from_world.inverse();
            (record.sequence, Keyframe { id: record.id, world_from_camera, has_image: record.has_image })
        });
        keyframes.extend(rows);
    }
    Ok(keyframes)
}

/// What does not change: it is there from the first moment on.
async fn write_map(
    export: &mut Export,
    recorder: &mut Recorder,
    start_ns: u64,
    submap: SubmapId,
) -> Result<(), ApiError> {
    let world = foxglove::frame_transform(start_ns, "world", "map", &WORLD_FROM_MAP);
    recorder.add(Schema::FrameTransform, start_ns, &world)?;
    let calibration = foxglove::camera_calibration(start_ns, "camera", &export.camera());
    recorder.add(Schema::CameraCalibration, start_ns, &calibration)?;
    let (n_points, n_lines) = export.snapshot.n_landmarks(Some(submap)).await?;
    let cloud = read_points(export, every(n_points, MAX_POINTS)).await?;
    recorder.add(Schema::PointCloud, start_ns, &cloud.message(start_ns, "map"))?;
    export.out.write_bytes(&recorder.written()).await?;
    let lines = read_lines(export, every(n_lines, MAX_LINES)).await?;
    recorder.add(Schema::SceneUpdate, start_ns, &lines.message(start_ns, "map"))
}

/// Of how many one is taken.
fn every(n: u64, max: u64) -> usize {
    usize::try_from(n.div_ceil(max).max(1)).unwrap_or(usize::MAX)
}

async fn read_points(export: &mut Export, every: usize) -> Result<Cloud, ApiError> {
    let (mut cloud, mut after, mut n_seen) = (Cloud::default(), None, 0);
    loop {
        let points = export.snapshot.points_after(after, export.submap).await?;
        let Some(last) = points.last() else { return Ok(cloud) };
        after = Some(last.id);
        let grays = export.grays(&points).await?;
        for (point, gray) in points.iter().zip(grays) {
            if n_seen % every == 0 {
                cloud.push(export.units.position(&point.position), gray);
            }
            n_seen += 1;
        }
    }
}

async fn read_lines(export: &mut Export, every: usize) -> Result<Lines, ApiError> {
    let (mut scene, mut after, mut n_seen) = (Lines::default(), None, 0);
    loop {
        let lines = export.snapshot.lines_after(after, export.submap).await?;
        let Some(last) = lines.last() else { return Ok(scene) };
        after = Some(last.id);
        for line in &lines {
            if n_seen % every == 0 {
                let ends = line.endpoints.map(|end| export.units.position(&end));
                scene.push(ends, line.primitive.map_or(BLUE, color_of));
            }
            n_seen += 1;
        }
    }
}

/// A file has no time before zero.
fn time_ns(timestamp_ns: i64) -> u64 {
    timestamp_ns.max(0).unsigned_abs()
}

/// Bytes that were written and not taken yet.
#[derive(Clone, Default)]
struct Pending(Arc<Mutex<Vec<u8>>>);

impl Pending {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Pending {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A file that is written.
struct Recorder {
    writer: mcap::Writer<NoSeek<Pending>>,
    pending: Pending,
    /// Messages of each topic so far.
    n_messages: [u32; TOPICS.len()],
}

impl Recorder {
    fn new() -> Result<Self, ApiError> {
        let pending = Pending::default();
        let options = mcap::WriteOptions::new()
            .compression(None)
            .profile("")
            .library(concat!("monoslam ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true);
        let mut writer = options.create(NoSeek::new(pending.clone())).map_err(ApiError::internal)?;
        for (idx, (topic, schema)) in TOPICS.into_iter().enumerate() {
            let definition = schema.definition().to_string();
            let schema_id = writer
                .add_schema(schema.name(), "jsonschema", definition.as_bytes())
                .map_err(ApiError::internal)?;
            let channel_id =
                writer.add_channel(schema_id, topic, "json", &BTreeMap::new()).map_err(ApiError::internal)?;
            debug_assert_eq!(usize::from(channel_id), idx + 1, "channels are numbered from one");
        }
        Ok(Self { writer, pending, n_messages: [0; TOPICS.len()] })
    }

    fn add(&mut self, schema: Schema, timestamp_ns: u64, message: &Value) -> Result<(), ApiError> {
        let idx = TOPICS.iter().position(|(_, of_topic)| *of_topic == schema).unwrap_or_default();
        let header = MessageHeader {
            channel_id: idx as u16 + 1,
            sequence: self.n_messages[idx],
            log_time: timestamp_ns,
            publish_time: timestamp_ns,
        };
        self.n_messages[idx] += 1;
        self.writer
            .write_to_known_channel(&header, message.to_string().as_bytes())
            .map_err(ApiError::internal)
    }

    fn written(&self) -> Vec<u8> {
        self.pending.take()
    }

    fn finish(mut self) -> Result<Vec<u8>, ApiError> {
        self.writer.finish().map_err(ApiError::internal)?;
        Ok(self.pending.take())
    }
}
