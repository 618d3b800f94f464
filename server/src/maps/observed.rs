//! What was measured in an image, in its pixels: keypoints, segments and vanishing points.

use super::MapQueries;
use super::keyframes::no_keyframe;
use crate::error::ApiError;
use crate::options::working_camera;
use crate::session::{SessionId, ShownFrame};
use geometry::Camera;
use geometry::nalgebra::Vector2;
use serde::Serialize;
use slam::features::LineFeature;
use slam::map::{KeyframeId, LineId, PointId, PrimitiveId, VanishingObservation};
use store::MeasuredKeyframe;
use utoipa::ToSchema;

/// What was measured in an image, and what of it was recognized.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Observed {
    /// Width of the image that the pixels below are of: the session's, or the width the engine works with if
    /// that is less.
    pub width: u32,
    /// Height of that image.
    pub height: u32,
    /// Keypoints, pixels.
    pub keypoints: Vec<[f32; 2]>,
    /// The point of the map each keypoint sees.
    pub point_ids: Vec<Option<u64>>,
    /// Line segments: x and y of one end, then of the other, pixels.
    pub segments: Vec<[f32; 4]>,
    /// The line of the map each segment sees.
    pub line_ids: Vec<Option<u64>>,
    /// The global primitive each segment runs along.
    pub primitive_ids: Vec<Option<u64>>,
    /// Keyframes: which of `vanishing_points` each segment meets.
    pub vanishing_idx: Vec<Option<u32>>,
    /// Keyframes: the vanishing points.
    pub vanishing_points: Vec<VanishingPoint>,
}

/// Where parallel edges of the scene meet in an image.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct VanishingPoint {
    /// Its place, pixels, mostly outside of the image; `null` if it is at infinity.
    pub pixel: Option<[f32; 2]>,
    /// The global primitive it shows.
    pub primitive_id: Option<u64>,
    /// Segments that meet there.
    pub n_segments: u32,
}

impl MapQueries {
    /// What a keyframe measured and what of it is in the map.
    ///
    /// # Errors
    /// If there is no such session or keyframe.
    pub async fn observed_keyframe(
        &self,
        id: &SessionId,
        keyframe_id: KeyframeId,
    ) -> Result<Observed, ApiError> {
        let record = self.store.record_of_keyframe(id.as_str(), keyframe_id).await?;
        let camera = working_camera(&record)?;
        let measured = self.store.measured_keyframe(id.as_str(), keyframe_id).await?;
        Ok(of_keyframe(&measured.ok_or_else(|| no_keyframe(id, keyframe_id))?, &camera))
    }

    /// What was measured and recognized in one of a session's last frames.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn observed_frame(&self, id: &SessionId, frame: &ShownFrame) -> Result<Observed, ApiError> {
        let camera = working_camera(&self.store.get_session(id.as_str()).await?)?;
        Ok(of_frame(frame, &camera))
    }
}

fn of_keyframe(measured: &MeasuredKeyframe, camera: &Camera) -> Observed {
    let MeasuredKeyframe { keypoints, points, segments, lines, vanishing } = measured;
    let mut vanishing_idx = vec![None; segments.len()];
    for (idx, seen) in vanishing.iter().enumerate() {
        for segment in &seen.segments {
            if let Some(slot) = vanishing_idx.get_mut(*segment as usize) {
                *slot = Some(idx as u32);
            }
        }
    }
    let primitive_of = |idx: &Option<u32>| vanishing.get((*idx)? as usize)?.primitive.map(PrimitiveId::get);
    Observed {
        width: camera.width(),
        height: camera.height(),
        keypoints: keypoints.clone(),
        point_ids: points.iter().map(|id| id.map(PointId::get)).collect(),
        segments: segments.iter().map(|segment| ends_px(segment, camera)).collect(),
        line_ids: lines.iter().map(|id| id.map(LineId::get)).collect(),
        primitive_ids: vanishing_idx.iter().map(primitive_of).collect(),
        vanishing_idx,
        vanishing_points: vanishing.iter().map(|seen| vanishing_point(seen, camera)).collect(),
    }
}

fn of_frame(frame: &ShownFrame, camera: &Camera) -> Observed {
    let observed = &frame.observed;
    let features = &observed.features;
    Observed {
        width: camera.width(),
        height: camera.height(),
        keypoints: features.keypoints.iter().map(|keypoint| [keypoint.x, keypoint.y]).collect(),
        point_ids: observed.points.iter().map(|id| id.map(PointId::get)).collect(),
        segments: features.lines.iter().map(|segment| ends_px(segment, camera)).collect(),
        line_ids: observed.lines.iter().map(|id| id.map(LineId::get)).collect(),
        primitive_ids: observed.primitives.iter().map(|id| id.map(PrimitiveId::get)).collect(),
        vanishing_idx: vec![None; features.lines.len()],
        vanishing_points: Vec::new(),
    }
}

/// A segment's ends as the lens shows them; where the lens model ends, as an ideal one would.
fn ends_px(segment: &LineFeature, camera: &Camera) -> [f32; 4] {
    let seen = |pixel: &Vector2<f64>| camera.distort(pixel).unwrap_or(*pixel);
    let (start, end) = (seen(&segment.start), seen(&segment.end));
    [start.x as f32, start.y as f32, end.x as f32, end.y as f32]
}

fn vanishing_point(seen: &VanishingObservation, camera: &Camera) -> VanishingPoint {
    // A direction and its negative vanish in the same place.
    let ahead = if seen.direction.z < 0.0 { -seen.direction } else { seen.direction };
    let pixel = camera.project(&ahead).map(|pixel| [pixel.x as f32, pixel.y as f32]);
    VanishingPoint {
        pixel: pixel.filter(|pixel| pixel.iter().all(|length| length.is_finite())),
        primitive_id: seen.primitive.map(PrimitiveId::get),
        n_segments: seen.segments.len() as u32,
    }
}
