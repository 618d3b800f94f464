//! Keyframes and their images.

use super::{Batches, MapQueries, ROWS_PER_BATCH, Scaled, batches_of_pages};
use crate::error::{ApiError, ErrorCode};
use crate::model::{Pose, Units};
use crate::page::{Page, PageRequest};
use crate::session::SessionId;
use serde::Serialize;
use slam::map::KeyframeId;
use store::{KeyframeRecord, StoredImage};
use utoipa::ToSchema;

/// A keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Keyframe {
    /// Identity within the session.
    pub id: u64,
    /// The submap whose frame of reference the pose is in.
    pub submap_id: u32,
    /// The client's number of the frame.
    pub sequence: u64,
    /// The client's time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// The same in text, for programs whose numbers do not hold all its digits, such as JavaScript's.
    pub timestamp_ns_text: String,
    /// The camera's pose in the world.
    pub world_from_camera: Pose,
    /// The keyframe it hangs on in the spanning tree.
    pub parent: Option<u64>,
    /// Keypoints measured in it.
    pub n_keypoints: u32,
    /// Keypoints that see a point.
    pub n_points: u32,
    /// Segments measured in it.
    pub n_segments: u32,
    /// Segments that see a line.
    pub n_lines: u32,
    /// Whether its image was kept.
    pub has_image: bool,
}

impl Keyframe {
    pub(super) fn new(record: &KeyframeRecord, units: Units) -> Self {
        Self {
            id: record.id.get(),
            submap_id: record.submap.0,
            sequence: record.sequence,
            timestamp_ns: record.timestamp_ns,
            timestamp_ns_text: record.timestamp_ns.to_string(),
            world_from_camera: units.pose(&record.camera_from_world.inverse()),
            parent: record.parent.map(KeyframeId::get),
            n_keypoints: record.n_keypoints,
            n_points: record.n_points,
            n_segments: record.n_segments,
            n_lines: record.n_lines,
            has_image: record.has_image,
        }
    }
}

impl MapQueries {
    /// A page of keyframes in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session, or the token cannot be used.
    pub async fn keyframes(
        &self,
        id: &SessionId,
        page: &PageRequest,
    ) -> Result<Scaled<Page<Keyframe>>, ApiError> {
        let after = page.after()?;
        let units = self.units(id).await?;
        let keyframes = self.store.keyframes(id.as_str(), after, page.size()).await?;
        Ok(Scaled::new(units, Page::of(keyframes, |record| Keyframe::new(&record, units))))
    }

    /// Every keyframe in the order of their ids.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn all_keyframes(&self, id: &SessionId) -> Result<Scaled<Batches<Keyframe>>, ApiError> {
        let units = self.units(id).await?;
        let (store, id) = (self.store.clone(), id.clone());
        let read = move |after| {
            let (store, id) = (store.clone(), id.clone());
            async move { store.keyframes(id.as_str(), after, ROWS_PER_BATCH as u32).await }
        };
        let keyframes = batches_of_pages(read, move |record: KeyframeRecord| Keyframe::new(&record, units));
        Ok(Scaled::new(units, keyframes))
    }

    /// A keyframe.
    ///
    /// # Errors
    /// If there is no such session or keyframe.
    pub async fn keyframe(&self, id: &SessionId, keyframe_id: KeyframeId) -> Result<Keyframe, ApiError> {
        let units = self.units(id).await?;
        let record = self.store.keyframe(id.as_str(), keyframe_id).await?;
        let record = record.ok_or_else(|| no_keyframe(id, keyframe_id))?;
        Ok(Keyframe::new(&record, units))
    }

    /// A keyframe's image, as it was sent; pixels sent raw come as PNG.
    ///
    /// # Errors
    /// If there is no such session or keyframe, or the image was not kept.
    pub async fn keyframe_image(
        &self,
        id: &SessionId,
        keyframe_id: KeyframeId,
    ) -> Result<StoredImage, ApiError> {
        if let Some(image) = self.store.keyframe_image(id.as_str(), keyframe_id).await? {
            return Ok(image);
        }
        if self.store.keyframe(id.as_str(), keyframe_id).await?.is_none() {
            return Err(no_keyframe(id, keyframe_id));
        }
        let sentence = format!("the image of keyframe {keyframe_id} was not kept");
        Err(ApiError::new(ErrorCode::ImageNotFound, sentence))
    }
}

pub(super) fn no_keyframe(id: &SessionId, keyframe_id: KeyframeId) -> ApiError {
    let sentence = format!("session {id} has no keyframe {keyframe_id}");
    ApiError::new(ErrorCode::KeyframeNotFound, sentence)
}
