//! The whole map as a file.
//!
//! A file needs to know how much is in it before it begins, and should be of one commit. So the map is read
//! from one commit into a file without a name, at the speed of the disk, and sent from there at the speed of
//! the client: a slow client keeps neither the database's log from being folded nor the map in memory.

mod colmap;
mod foxglove;
mod json;
mod mcap;
mod ply;
mod spool;
mod transforms;

use super::MapQueries;
use super::shades::{ShadedSession, Shades};
use crate::error::ApiError;
use crate::model::Units;
use crate::options::working_camera;
use crate::session::SessionId;
use bytes::Bytes;
use futures_util::Stream;
use geometry::CameraParameters;
use slam::map::{CameraId, KeyframeId, PointLandmark, SubmapId};
use spool::Spool;
use std::collections::BTreeMap;
use std::sync::Arc;
use store::{KeyframeRecord, MapSnapshot, SessionRecord, Store};

/// How a map is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFormat {
    /// Polygon file (ASCII): points as vertices, lines as edges between two vertices each.
    Ply,
    /// One object with keyframes, points, lines and primitives.
    Json,
    /// A file of COLMAP's text model.
    Colmap(ColmapPart),
    /// `transforms.json` of nerfstudio and instant-ngp: the camera and a pose for each keyframe's image.
    Transforms,
    /// MCAP with the schemas of Foxglove: points, lines, the camera's way and the keyframes' images.
    Mcap,
}

/// A file of a COLMAP text model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColmapPart {
    /// `cameras.txt`: the session's camera.
    Cameras,
    /// `images.txt`: keyframes with their keypoints.
    Images,
    /// `points3D.txt`: points with who sees them.
    Points3D,
}

/// A map in a file, ready to be sent.
pub struct MapFile {
    /// What the bytes are.
    pub media_type: &'static str,
    /// What the file may be called: letters, digits, `-`, `_` and `.`.
    pub name: String,
    /// How long it is.
    pub n_bytes: u64,
    spool: Spool,
}

impl MapFile {
    /// The bytes, read as they are taken.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub async fn into_chunks(self) -> Result<impl Stream<Item = std::io::Result<Bytes>> + use<>, ApiError> {
        self.spool.into_chunks().await
    }
}

impl MapQueries {
    /// The map as a file, as of one commit: of one submap, or, if none is given, in JSON of all of them and
    /// otherwise of the one with the most keyframes, as submaps do not share a frame of reference.
    ///
    /// # Errors
    /// If there is no such session, or no room on the disk.
    pub async fn export(
        &self,
        id: &SessionId,
        format: MapFormat,
        submap: Option<SubmapId>,
    ) -> Result<MapFile, ApiError> {
        let snapshot = self.store.snapshot(id.as_str()).await?;
        let units = Units::new(snapshot.record().metres_per_unit);
        let out = Spool::new(self.export_dir.clone()).await?;
        let session = ShadedSession {
            id: id.clone(),
            created_at_ns: snapshot.record().created_at_ns,
            working_width_px: working_camera(snapshot.record())?.width(),
        };
        let (store, shades) = (self.store.clone(), self.shades.clone());
        let cameras = AddedCameras::read(&store, snapshot.record()).await?;
        let mut export = Export { units, snapshot, submap, out, store, shades, session, cameras };
        if submap.is_none() && format != MapFormat::Json {
            export.submap = Some(export.largest_submap().await?);
        }
        match format {
            MapFormat::Ply => ply::write(&mut export).await?,
            MapFormat::Json => json::write(&mut export).await?,
            MapFormat::Colmap(part) => colmap::write(&mut export, part).await?,
            MapFormat::Transforms => transforms::write(&mut export).await?,
            MapFormat::Mcap => mcap::write(&mut export).await?,
        }
        // The snapshot ends here, before the client reads the first byte.
        let Export { out: spool, .. } = export;
        let (media_type, name) = (format.media_type(), format.file_name(id));
        Ok(MapFile { media_type, name, n_bytes: spool.n_bytes(), spool })
    }
}

impl MapFormat {
    fn media_type(self) -> &'static str {
        match self {
            Self::Ply | Self::Mcap => "application/octet-stream",
            Self::Json | Self::Transforms => "application/json",
            Self::Colmap(_) => "text/plain; charset=utf-8",
        }
    }

    fn file_name(self, id: &SessionId) -> String {
        match self {
            Self::Ply => format!("{id}.ply"),
            Self::Json => format!("{id}.json"),
            Self::Mcap => format!("{id}.mcap"),
            Self::Transforms => "transforms.json".to_owned(),
            Self::Colmap(ColmapPart::Cameras) => "cameras.txt".to_owned(),
            Self::Colmap(ColmapPart::Images) => "images.txt".to_owned(),
            Self::Colmap(ColmapPart::Points3D) => "points3D.txt".to_owned(),
        }
    }
}

/// A map on its way into a file.
struct Export {
    snapshot: MapSnapshot,
    units: Units,
    /// The submap wanted; `None` for all.
    submap: Option<SubmapId>,
    out: Spool,
    store: Store,
    shades: Arc<Shades>,
    session: ShadedSession,
    cameras: AddedCameras,
}

/// Cameras that were added to the map and have another calibration than its own.
#[derive(Default)]
struct AddedCameras {
    cameras: BTreeMap<CameraId, CameraParameters>,
    /// Of which of them keyframes are.
    of_keyframes: BTreeMap<KeyframeId, CameraId>,
}

impl AddedCameras {
    async fn read(store: &Store, map: &SessionRecord) -> Result<Self, ApiError> {
        if map.last_camera == CameraId::default() {
            return Ok(Self::default());
        }
        let (mut cameras, of_keyframes) = store.added_cameras(&map.id).await?;
        cameras.retain(|_, camera| *camera != map.camera);
        Ok(Self { cameras, of_keyframes })
    }

    /// That of a keyframe; `None` where it is like the map's own.
    fn of(&self, keyframe: KeyframeId) -> Option<(CameraId, &CameraParameters)> {
        let id = self.of_keyframes.get(&keyframe)?;
        Some((*id, self.cameras.get(id)?))
    }
}

/// The gray of points that no kept image shows.
const GRAY: u8 = 200;

impl Export {
    /// The map's own camera.
    fn camera(&self) -> CameraParameters {
        let record = self.snapshot.record();
        record.refined_camera().unwrap_or_else(|| record.camera.clone())
    }

    /// How bright the images are where they show these points.
    async fn grays(&self, points: &[PointLandmark]) -> Result<Vec<u8>, ApiError> {
        let grays = self.shades.of_points(&self.store, &self.session, points).await?;
        Ok(grays.into_iter().map(|gray| gray.unwrap_or(GRAY)).collect())
    }

    /// The wanted keyframes with ids above the given one, and the id to go on with; `None` at the end.
    async fn keyframes_after(
        &mut self,
        after: &mut Option<slam::map::KeyframeId>,
    ) -> Result<Option<Vec<KeyframeRecord>>, ApiError> {
        let mut records = self.snapshot.keyframes_after(*after).await?;
        let Some(last) = records.last() else { return Ok(None) };
        *after = Some(last.id);
        records.retain(|record| self.wants(record.submap));
        Ok(Some(records))
    }

    /// What the file of a keyframe's image is called.
    async fn image_name(&mut self, keyframe: &KeyframeRecord) -> Result<String, ApiError> {
        let media_type = self.snapshot.image_media_type(keyframe.id).await?;
        let extension = match media_type.as_deref() {
            Some("image/jpeg") => ".jpg",
            Some("image/png") => ".png",
            _ => "",
        };
        Ok(format!("keyframe_{:06}{extension}", keyframe.id.get()))
    }

    /// The submap with the most keyframes, of equal ones the first.
    async fn largest_submap(&mut self) -> Result<SubmapId, ApiError> {
        let mut n_keyframes: BTreeMap<SubmapId, usize> = BTreeMap::new();
        let mut after = None;
        loop {
            let step = self.snapshot.keyframes_after(after).await?;
            let Some(last) = step.last() else { break };
            after = Some(last.id);
            step.iter().for_each(|record| *n_keyframes.entry(record.submap).or_default() += 1);
        }
        let largest = n_keyframes.iter().max_by_key(|(submap, n)| (**n, std::cmp::Reverse(**submap)));
        Ok(largest.map_or_else(SubmapId::default, |(submap, _)| *submap))
    }

    fn wants(&self, submap: SubmapId) -> bool {
        self.submap.is_none_or(|wanted| wanted == submap)
    }
}
