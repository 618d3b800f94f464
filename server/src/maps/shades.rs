//! Gray values of points: what a keyframe's image shows where its keypoints are.
//!
//! They are no part of the map, so they are looked up in the images when somebody wants to see it, and what
//! was looked up is kept, within bounds: a keyframe's keypoints and image never change.

use crate::error::ApiError;
use crate::options::working_camera;
use crate::session::SessionId;
use slam::map::{KeyframeId, PointLandmark};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use store::{Store, StoredImage};
use vision::GrayImage;
use vision::decode::{DecodeLimits, EncodedImage, decode_gray};

/// Keyframes whose gray values are kept, over all sessions: a byte for each keypoint, some megabytes.
const MAX_KEYFRAMES: usize = 4096;

/// A session, told from another one of the same name by the time it was made, and the width of the images its
/// keypoints are in.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ShadedSession {
    pub id: SessionId,
    pub created_at_ns: i64,
    pub working_width_px: u32,
}

type Key = (ShadedSession, KeyframeId);

/// The gray value at each keypoint; empty if the keyframe's image was not kept.
type Grays = Arc<[u8]>;

/// See the module's documentation.
pub(super) struct Shades {
    limits: DecodeLimits,
    kept: Mutex<Kept>,
    /// One image is decoded at a time, however many viewers there are.
    turn: tokio::sync::Mutex<()>,
}

#[derive(Default)]
struct Kept {
    grays: BTreeMap<Key, Grays>,
    /// The oldest first.
    order: VecDeque<Key>,
}

impl Shades {
    pub fn new(limits: DecodeLimits) -> Self {
        Self { limits, kept: Mutex::default(), turn: tokio::sync::Mutex::default() }
    }

    /// The gray value of each point, where the image of a keyframe that sees it was kept.
    pub async fn of_points(
        &self,
        store: &Store,
        session: &ShadedSession,
        points: &[PointLandmark],
    ) -> Result<Vec<Option<u8>>, ApiError> {
        let mut grays = Vec::with_capacity(points.len());
        for point in points {
            // The keyframe that made the point sees it best; a removed one's place is taken by the oldest.
            let seen = point.observation_in(point.created_by).map(|idx| (point.created_by, idx));
            let seen =
                seen.or_else(|| point.observations.first().map(|seen| (seen.keyframe, seen.feature_idx)));
            grays.push(match seen {
                Some((keyframe, idx)) => {
                    self.of_keyframe(store, session, keyframe).await?.get(idx as usize).copied()
                }
                None => None,
            });
        }
        Ok(grays)
    }

    async fn of_keyframe(
        &self,
        store: &Store,
        session: &ShadedSession,
        keyframe: KeyframeId,
    ) -> Result<Grays, ApiError> {
        let key = (session.clone(), keyframe);
        if let Some(grays) = self.kept(&key) {
            return Ok(grays);
        }
        let _turn = self.turn.lock().await;
        if let Some(grays) = self.kept(&key) {
            return Ok(grays);
        }
        let id = session.id.as_str();
        let keypoints = store.keypoints(id, keyframe).await?;
        let image = store.keyframe_image(id, keyframe).await?;
        let grays = match keypoints.zip(image) {
            Some((keypoints, image)) => {
                let added = store.added_camera_of(id, keyframe).await?;
                let width = match added {
                    // It may have images of another size than the map's own.
                    Some(_) => working_camera(&store.record_of_keyframe(id, keyframe).await?)?.width(),
                    None => session.working_width_px,
                };
                let limits = self.limits;
                let sample = move || Some(sample(&decode(&image, &limits)?, &keypoints, width));
                tokio::task::spawn_blocking(sample).await.map_err(ApiError::internal)?.unwrap_or_default()
            }
            None => Grays::default(),
        };
        self.keep(key, grays.clone());
        Ok(grays)
    }

    fn kept(&self, key: &Key) -> Option<Grays> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).grays.get(key).cloned()
    }

    fn keep(&self, key: Key, grays: Grays) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.order.len() == MAX_KEYFRAMES
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.grays.remove(&oldest);
        }
        kept.order.push_back(key.clone());
        kept.grays.insert(key, grays);
    }
}

/// A stored image in gray; `None`, with a word in the log, if it cannot be read.
pub(super) fn decode(image: &StoredImage, limits: &DecodeLimits) -> Option<GrayImage> {
    let decoded = decode_gray(&EncodedImage::Auto(&image.bytes), limits);
    decoded.inspect_err(|error| tracing::warn!("a stored image cannot be shown: {error}")).ok()
}

/// The gray values at keypoints of an image that was `working_width_px` wide when they were found.
fn sample(image: &GrayImage, keypoints: &[[f32; 2]], working_width_px: u32) -> Grays {
    let factor = image.width() as f32 / working_width_px.max(1) as f32;
    let pixel =
        |length: f32, size: u32| (length * factor).round().clamp(0.0, size.saturating_sub(1) as f32) as u32;
    let gray =
        |[x, y]: &[f32; 2]| image.get(pixel(*x, image.width()), pixel(*y, image.height())).unwrap_or(0);
    keypoints.iter().map(gray).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grays_are_those_of_the_image_at_its_own_size() {
        let image = GrayImage::from_fn(200, 100, |x, y| ((x + y) / 2) as u8);
        let keypoints = [[10.0, 20.0], [-5.0, 0.0], [1e9, 1e9]];
        assert_eq!(*sample(&image, &keypoints, 200), [15, 0, 149]);
        assert_eq!(*sample(&image, &keypoints[..1], 100), [30], "the engine worked at half the size");
    }

    #[test]
    fn the_oldest_keyframe_is_forgotten_first() {
        let shades = Shades::new(DecodeLimits::default());
        let id = SessionId::parse("s", "id").unwrap();
        let session = ShadedSession { id, created_at_ns: 0, working_width_px: 640 };
        let key = |n: u64| (session.clone(), KeyframeId::new(n).unwrap());
        (1..=MAX_KEYFRAMES as u64 + 1).for_each(|n| shades.keep(key(n), Grays::default()));
        assert!(shades.kept(&key(1)).is_none());
        assert!(shades.kept(&key(2)).is_some());
        assert_eq!(shades.kept.lock().unwrap().grays.len(), MAX_KEYFRAMES);
    }
}
