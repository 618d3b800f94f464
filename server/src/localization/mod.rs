//! Locating single images in stored maps: in one, or in whichever of many shows the place.
//!
//! The image is looked for by engines of their own, made of the maps' last commits. So nothing of a session
//! changes, a connected writer is neither in the way nor disturbed, and the same image gives the same answer
//! whatever was asked before. Of many maps those that look like the image are found first, by descriptors
//! alone; only the best few are read and looked at closely.

mod cache;
mod sketch;

use crate::clock::SystemClock;
use crate::config::SessionConfig;
use crate::error::{ApiError, ErrorCode};
use crate::model::Units;
use crate::session::{
    FrameOutcome, LoadContext, Registry, SentImage, SessionId, brightest, decode_image, read,
};
use cache::{Cache, MapState};
use geometry::nalgebra::{Matrix6, Vector3};
use geometry::{Camera, CameraParameters};
use sketch::{MIN_VOTES, Sketch, looks_of};
use slam::map::FrameState;
use slam::{Found, LocalizeCamera, Localizer, Near, ResumeState};
use std::sync::Arc;
use std::time::{Duration, Instant};
use store::{SessionRecord, Store};
use tokio::sync::OwnedSemaphorePermit;
use vision::GrayImage;
use vision::decode::{DecodeLimits, SampleDepth};

/// Sessions one image is looked for in, at most.
pub const MAX_SESSIONS: usize = 1000;
/// Maps that look like an image and are looked at closely, at most.
const MAX_TRIED: usize = 6;
/// Landmarks that show a place beyond doubt: no further map is looked at.
const BEYOND_DOUBT: usize = 100;
/// Fields of view, across the longer side of the image, that a camera without distortion can have, degrees.
const FIELDS_OF_VIEW_DEG: std::ops::RangeInclusive<f64> = 5.0..=170.0;
/// By how much the sides' ratio of an image may differ from the session's camera's and be taken for the same.
const SAME_ASPECT: f64 = 0.01;

/// What is said of the camera that took an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum AskedCamera {
    /// Nothing: it is the session's if the image is of its size, and found otherwise.
    #[default]
    Unsaid,
    /// This one.
    Given(CameraParameters),
    /// It has no distortion and this field of view across the longer side of the image, degrees.
    FieldOfView(f64),
    /// Nobody knows.
    Unknown,
}

/// An image, and where to look for it.
#[derive(Clone, Debug)]
pub struct Question {
    /// The sessions.
    pub sessions: Vec<SessionId>,
    /// The image.
    pub image: SentImage,
    /// Its camera.
    pub camera: AskedCamera,
    /// Where the camera is thought to be, and how far it may be from there, as lengths of the sessions are
    /// told.
    pub near: Option<([f64; 3], f64)>,
}

/// Where an image was taken, or why that is not known.
#[derive(Clone, Debug)]
pub struct Located {
    /// In whose map; of several, `None` if in none.
    pub session: Option<SessionId>,
    /// What came of the image.
    pub report: FrameOutcome,
    /// Covariance of position (as lengths are told) and attitude (radians about the world's axes).
    pub covariance: Option<Matrix6<f64>>,
    /// The camera it was located with.
    pub camera: Option<CameraParameters>,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// The map is as of this frame.
    pub durable_sequence: Option<u64>,
    /// Nanoseconds to read maps and to make them ready.
    pub load_ns: u64,
    /// Nanoseconds to locate the image.
    pub locate_ns: u64,
    /// Sessions that were searched by looks.
    pub n_searched: u32,
    /// Sessions the image was looked for in.
    pub n_tried: u32,
}

/// See the module's documentation. Clones are the same.
#[derive(Clone)]
pub struct Localization(Arc<Inner>);

struct Inner {
    store: Store,
    registry: Arc<Registry>,
    limits: DecodeLimits,
    /// By bytes.
    sketches: Cache<Sketch>,
    /// By keyframes.
    maps: Cache<Localizer>,
    /// What is not used for this long is forgotten.
    keep: Duration,
}

/// A map that is ready, and what its session says.
struct Ready {
    record: SessionRecord,
    state: MapState,
    localizer: Localizer,
}

impl Localization {
    /// Over a database.
    pub fn new(store: Store, registry: Arc<Registry>, limits: DecodeLimits, config: &SessionConfig) -> Self {
        let sketches = Cache::new(config.localization_index_mb.saturating_mul(1 << 20));
        let (maps, keep) = (Cache::new(config.localization_keyframes), config.idle_unload());
        Self(Arc::new(Inner { store, registry, limits, sketches, maps, keep }))
    }

    /// Looks for an image. The `turn` is kept for as long as that is worked at, also when the future is given
    /// up: the work then ends at its next stage.
    ///
    /// # Errors
    /// If the image or what is said of its camera cannot be used, or a session not be read. A place that is
    /// not found is no error.
    pub async fn locate(&self, question: Question, turn: OwnedSemaphorePermit) -> Result<Located, ApiError> {
        let (limits, turn) = (self.0.limits, Turn(Arc::new(turn)));
        let Question { sessions, image, camera, near } = question;
        let decoding = move || {
            decode_image(&image, &limits, &mut SampleDepth::default())
                .map_err(|refusal| ApiError::invalid(refusal.field, refusal.reason))
        };
        let image = turn.work(decoding).await??;
        let image = Arc::new(image);
        check_asked(&camera, &image)?;
        let located = match &sessions[..] {
            [only] => self.locate_in(only, &image, &camera, near, &turn).await,
            several => self.locate_among(several, &image, &camera, near, &turn).await,
        };
        self.forget_later();
        located
    }

    /// In whichever map fits best.
    async fn locate_among(
        &self,
        sessions: &[SessionId],
        image: &Arc<GrayImage>,
        camera: &AskedCamera,
        near: Option<([f64; 3], f64)>,
        turn: &Turn,
    ) -> Result<Located, ApiError> {
        let begin = Instant::now();
        let ranked = self.rank(sessions, image, turn).await?;
        let mut load_ns = begin.elapsed().as_nanos() as u64;
        let (mut best, mut n_tried, mut locate_ns) = (None::<Located>, 0, 0);
        let alike = ranked.iter().filter(|(votes, _)| *votes >= MIN_VOTES).map(|(_, id)| id);
        for id in alike.take(MAX_TRIED) {
            let located = self.locate_in(id, image, camera, near, turn).await?;
            n_tried += 1;
            load_ns += located.load_ns;
            locate_ns += located.locate_ns;
            if best.as_ref().is_none_or(|best| rank_of(&located) > rank_of(best)) {
                best = Some(located);
            }
            if best.as_ref().is_some_and(|best| rank_of(best) >= (2, BEYOND_DOUBT)) {
                break;
            }
        }
        let mut best = match best {
            Some(best) => best,
            // Nothing looks like it: the map that does so least badly tells why it is not found.
            None => {
                let first = ranked.first().map(|(_, id)| id).or(sessions.first());
                self.locate_in(first.ok_or_else(no_session)?, image, camera, near, turn).await?
            }
        };
        if best.report.world_from_camera.is_none() {
            best.session = None;
        }
        Ok(Located { n_searched: sessions.len() as u32, n_tried, load_ns, locate_ns, ..best })
    }

    /// The sessions that have maps, by how many descriptors speak for each; the most first.
    async fn rank(
        &self,
        sessions: &[SessionId],
        image: &Arc<GrayImage>,
        turn: &Turn,
    ) -> Result<Vec<(u32, SessionId)>, ApiError> {
        let seen = image.clone();
        let looks = turn.work(move || looks_of(&seen)).await??;
        let looks = Arc::new(looks);
        let mut ranked = Vec::new();
        for id in sessions {
            let revision = self.0.registry.revision(id);
            let record = self.0.store.get_session(id.as_str()).await?;
            if record.counts.n_points == 0 {
                continue;
            }
            let state = MapState::of(&record, revision);
            let known = self.0.sketches.take(id, &state);
            let points = match known {
                Some(_) => None,
                None => Some(self.0.store.point_descriptors(id.as_str()).await?),
            };
            let looks = looks.clone();
            let voting = move || {
                let sketch = known.unwrap_or_else(|| Sketch::of(&points.unwrap_or_default()));
                let votes = sketch.votes(&looks);
                (sketch, votes)
            };
            let (sketch, votes) = turn.work(voting).await?;
            self.0.sketches.put(id.clone(), state, sketch.n_bytes(), sketch);
            ranked.push((votes, id.clone()));
        }
        ranked.sort_by(|(a, a_id), (b, b_id)| b.cmp(a).then_with(|| a_id.cmp(b_id)));
        Ok(ranked)
    }

    /// In one map.
    async fn locate_in(
        &self,
        id: &SessionId,
        image: &Arc<GrayImage>,
        camera: &AskedCamera,
        near: Option<([f64; 3], f64)>,
        turn: &Turn,
    ) -> Result<Located, ApiError> {
        let begin = Instant::now();
        let asked = self.0.store.get_session(id.as_str()).await?;
        let map = id.beside(asked.map.as_deref().unwrap_or(id.as_str()));
        let Ready { record, state, mut localizer } = self.ready(&map, turn).await?;
        // Nothing is said: it is the session's, which may be another than the map's own.
        let is_like =
            |asked: &CameraParameters| (image.width(), image.height()) == (asked.width, asked.height);
        let others = Some(&asked.camera).filter(|camera| **camera != record.camera && is_like(camera));
        let others = others.filter(|_| *camera == AskedCamera::Unsaid).cloned().map(AskedCamera::Given);
        let camera = others.as_ref().unwrap_or(camera);
        let load_ns = begin.elapsed().as_nanos() as u64;
        let units = Units::new(record.metres_per_unit);
        let near = near.map(|(position, radius)| Near {
            position: Vector3::from(position.map(|length| units.to_map(length))),
            radius: units.to_map(radius),
        });
        let tries = cameras_to_try(camera, &record.camera, image)?;
        let image = image.clone();
        let locating = move || {
            let begin = Instant::now();
            let mut found = None::<Found>;
            for camera in tries {
                let next = localizer.locate(&image, &camera, near);
                let next = next.map_err(|error| ApiError::invalid("camera", error.to_string()))?;
                let is_better = found.as_ref().is_none_or(|found| is_placed(&next) && !is_placed(found));
                found = if is_better { Some(next) } else { found };
                if found.as_ref().is_some_and(|found| found.report.outcome.state() == FrameState::Tracked) {
                    break;
                }
            }
            let found = found.ok_or_else(|| ApiError::internal("no camera was tried"))?;
            let brightest = brightest(&image);
            Ok::<_, ApiError>((localizer, found, brightest, begin.elapsed().as_nanos() as u64))
        };
        let located = turn.work(locating).await?;
        let (localizer, found, brightest, locate_ns) = located?;
        let n_keyframes = localizer.map().n_keyframes();
        self.0.maps.put(map, state, n_keyframes, localizer);
        let Found { report, covariance, camera } = found;
        Ok(Located {
            session: Some(id.clone()),
            report: FrameOutcome { report, brightest },
            covariance: covariance.map(|covariance| in_units(&covariance, units)),
            camera,
            metres_per_unit: record.metres_per_unit,
            durable_sequence: asked.last_frame.map(|(sequence, _)| sequence),
            load_ns,
            locate_ns,
            n_searched: 1,
            n_tried: 1,
        })
    }

    async fn ready(&self, id: &SessionId, turn: &Turn) -> Result<Ready, ApiError> {
        let revision = self.0.registry.revision(id);
        let record = self.0.store.get_session(id.as_str()).await?;
        let state = MapState::of(&record, revision);
        if let Some(localizer) = self.0.maps.take(id, &state) {
            return Ok(Ready { record, state, localizer });
        }
        let stored = read(&LoadContext { store: &self.0.store, id }).await?;
        let making = move || {
            let ResumeState { map, mask, .. } = stored.state;
            Localizer::new(stored.config, stored.camera, mask, map, Arc::new(SystemClock::new()))
        };
        let made = turn.work(making).await?;
        let localizer = made.map_err(|error| {
            tracing::error!(error = %error, "a stored map cannot be taken up: {error}");
            ApiError::new(ErrorCode::DataLoss, "the stored map cannot be taken up; the server's log says why")
        })?;
        Ok(Ready { record, state, localizer })
    }

    /// Gives memory back once nothing was asked for some time.
    fn forget_later(&self) {
        let localization = self.clone();
        tokio::spawn(async move {
            let keep = localization.0.keep;
            tokio::time::sleep(keep).await;
            localization.0.maps.forget_unused(keep);
            localization.0.sketches.forget_unused(keep);
        });
    }
}

/// Leave to work on an image, which is given back when the work ends.
struct Turn(Arc<OwnedSemaphorePermit>);

impl Turn {
    /// Work that may take long. A panic of the engine is an internal error of this call.
    async fn work<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ApiError> {
        let turn = self.0.clone();
        let working = move || {
            let _turn = turn;
            work()
        };
        tokio::task::spawn_blocking(working).await.map_err(ApiError::internal)
    }
}

/// How well an image was located: well, badly or not, and by how many landmarks.
fn rank_of(located: &Located) -> (u8, usize) {
    let state = match located.report.outcome.state() {
        FrameState::Tracked => 2,
        FrameState::Weak => 1,
        FrameState::Initialising | FrameState::Lost => 0,
    };
    (state, located.report.n_inlier_points + located.report.n_inlier_lines)
}

fn is_placed(found: &Found) -> bool {
    found.report.world_from_camera.is_some()
}

fn no_session() -> ApiError {
    ApiError::invalid("sessions", "there is no session to look in")
}

/// Position in the unit of answers.
fn in_units(covariance: &Matrix6<f64>, units: Units) -> Matrix6<f64> {
    let factor = 1.0 / units.to_map(1.0);
    let of = |idx: usize| if idx < 3 { factor } else { 1.0 };
    Matrix6::from_fn(|row, column| covariance[(row, column)] * of(row) * of(column))
}

fn check_asked(asked: &AskedCamera, image: &GrayImage) -> Result<(), ApiError> {
    match asked {
        AskedCamera::Given(camera) => {
            let (width, height) = (image.width(), image.height());
            if (camera.width, camera.height) != (width, height) {
                let sentence = format!(
                    "is of images of {}x{} pixels, but the image has {width}x{height}",
                    camera.width, camera.height
                );
                return Err(ApiError::invalid("camera", sentence));
            }
            crate::options::check_camera(camera.clone()).map(|_| ())
        }
        AskedCamera::FieldOfView(degrees) if !FIELDS_OF_VIEW_DEG.contains(degrees) => {
            let (least, most) = (FIELDS_OF_VIEW_DEG.start(), FIELDS_OF_VIEW_DEG.end());
            Err(ApiError::invalid("fov_deg", format!("must be {least} to {most} degrees")))
        }
        AskedCamera::FieldOfView(_) | AskedCamera::Unsaid | AskedCamera::Unknown => Ok(()),
    }
}

/// Cameras to locate an image with, one after the other until it is found.
fn cameras_to_try(
    asked: &AskedCamera,
    own: &CameraParameters,
    image: &GrayImage,
) -> Result<Vec<LocalizeCamera>, ApiError> {
    let (width, height) = (image.width(), image.height());
    let given = |camera: Camera| LocalizeCamera::Given(Box::new(camera));
    match asked {
        AskedCamera::Given(camera) => Ok(vec![given(crate::options::check_camera(camera.clone())?)]),
        AskedCamera::FieldOfView(degrees) => {
            let camera = CameraParameters::of_field_of_view(width, height, *degrees);
            Ok(vec![given(crate::options::check_camera(camera)?)])
        }
        AskedCamera::Unknown => Ok(vec![LocalizeCamera::Unknown]),
        AskedCamera::Unsaid if (width, height) == (own.width, own.height) => {
            Ok(vec![LocalizeCamera::Session])
        }
        AskedCamera::Unsaid => {
            // Most likely it is the same camera's, made smaller.
            let [x, y] = [f64::from(width) / f64::from(own.width), f64::from(height) / f64::from(own.height)];
            let mut tries = Vec::new();
            if (x / y - 1.0).abs() < SAME_ASPECT {
                tries.push(given(crate::options::check_camera(own.clone())?.scaled(x, y)));
            }
            tries.push(LocalizeCamera::Unknown);
            Ok(tries)
        }
    }
}
