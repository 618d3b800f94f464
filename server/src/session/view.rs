//! A session as callers see it: its row, under what is known of it while it is in memory.

use super::host::MapCounts;
use crate::options::{SessionOptions, camera_warnings};
use geometry::CameraParameters;
use slam::map::{FrameState, Readout};
use store::{MaskShare, SessionRecord};

/// How a loaded session is doing, as of its last frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Live {
    /// How tracking the last frame ended, if there was one since the session was loaded.
    pub state: Option<FrameState>,
    /// Number and time of the last frame, nanoseconds, if there ever was one.
    pub last_frame: Option<(u64, i64)>,
    /// Frames tracked since the session was loaded.
    pub n_frames: u64,
    /// What of the images is left out.
    pub mask: Option<MaskShare>,
}

/// How a session in memory is doing.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedView {
    /// As of its last frame.
    pub live: Live,
    /// How much there is in its map, which others may extend too.
    pub counts: MapCounts,
    /// Whether a writer is connected.
    pub has_writer: bool,
}

/// A session, as stored and as it is in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionView {
    /// Its name.
    pub id: String,
    /// Its camera, as it was given.
    pub camera: CameraParameters,
    /// Its camera as it was found to be; `None` while it is used as it was given.
    pub refined_camera: Option<CameraParameters>,
    /// Whether its images were found to contradict its camera.
    pub is_contradicted: bool,
    /// The readout of its camera's shutter as it was found; `None` where it was told, or is not known.
    pub readout: Option<Readout>,
    /// What of its images is left out as not being the scene, if anything is.
    pub mask: Option<MaskShare>,
    /// The session's options.
    pub options: SessionOptions,
    /// Wall-clock time of creation, nanoseconds since 1970.
    pub created_at_ns: i64,
    /// How tracking its last frame ended; `None` before the first.
    pub state: Option<FrameState>,
    /// Metres per map unit; `None` while the scale is free.
    pub metres_per_unit: Option<f64>,
    /// Frames of the trajectory.
    pub n_frames: u64,
    /// Keyframes.
    pub n_keyframes: u64,
    /// Points.
    pub n_points: u64,
    /// Lines.
    pub n_lines: u64,
    /// Global primitives.
    pub n_primitives: u64,
    /// Submaps that have keyframes.
    pub n_submaps: u32,
    /// Every frame up to this one is in the database.
    pub durable_sequence: Option<u64>,
    /// The frame the server expects next.
    pub next_sequence: u64,
    /// Time of the last frame, nanoseconds: later ones must be after it. `None` before the first.
    pub last_timestamp_ns: Option<i64>,
    /// Whether the session is in memory.
    pub loaded: bool,
    /// Whether a writer is connected.
    pub has_writer: bool,
    /// The session whose map its camera extends; `None` if it has one of its own.
    pub map: Option<String>,
    /// What of it is damaged, so that it cannot be streamed into; `None` if nothing is known to be.
    pub damage: Option<String>,
}

impl SessionView {
    /// What is stored of a session, and how it is doing if it is in memory.
    pub fn of(record: SessionRecord, loaded: Option<LoadedView>) -> Self {
        let mut view = Self::stored(record);
        if let Some(loaded) = loaded {
            view.update(loaded);
        }
        view
    }

    /// What is doubtful about its camera, in plain sentences.
    pub fn camera_warnings(&self) -> Vec<String> {
        let contradicted = self.is_contradicted.then(|| {
            let sentence = "the images contradict the calibration, so that all poses are weak: were they resized or cropped, or \
                            is the calibration that of another camera? With options.give_up_calibration a session finds its \
                            camera itself";
            sentence.to_owned()
        });
        camera_warnings(&self.camera).into_iter().chain(contradicted).collect()
    }

    fn stored(record: SessionRecord) -> Self {
        let refined_camera = record.refined_camera();
        let SessionRecord {
            id,
            camera,
            correction: _,
            is_contradicted,
            readout,
            options,
            enlarges_small_images: _,
            enlarges_for_border: _,
            mask,
            created_at_ns,
            state,
            metres_per_unit,
            last_frame,
            counts,
            map: _,
            camera_id: _,
            last_camera: _,
        } = record;
        let durable_sequence = last_frame.map(|(sequence, _)| sequence);
        Self {
            id,
            camera,
            refined_camera,
            is_contradicted,
            readout,
            mask,
            options: options.into(),
            created_at_ns,
            state: last_frame.map(|_| state),
            metres_per_unit,
            n_frames: counts.n_frames,
            n_keyframes: counts.n_keyframes,
            n_points: counts.n_points,
            n_lines: counts.n_lines,
            n_primitives: counts.n_primitives,
            n_submaps: counts.n_submaps,
            durable_sequence,
            next_sequence: durable_sequence.map_or(0, |sequence| sequence.saturating_add(1)),
            last_timestamp_ns: last_frame.map(|(_, timestamp_ns)| timestamp_ns),
            loaded: false,
            has_writer: false,
            map: None,
            damage: None,
        }
    }

    /// A session in memory is ahead of its row.
    fn update(&mut self, loaded: LoadedView) {
        let LoadedView { live, counts, has_writer } = loaded;
        self.loaded = true;
        self.has_writer = has_writer;
        self.state = live.state.or(self.state);
        if let Some((sequence, timestamp_ns)) = live.last_frame {
            let next_sequence = sequence.saturating_add(1);
            // Of the newer frame: a new segment may have an earlier time.
            if next_sequence >= self.next_sequence {
                self.next_sequence = next_sequence;
                self.last_timestamp_ns = Some(timestamp_ns);
            }
        }
        if live.state.is_some() {
            self.n_keyframes = counts.n_keyframes as u64;
            self.n_points = counts.n_points as u64;
            self.n_lines = counts.n_lines as u64;
            self.n_primitives = counts.n_primitives as u64;
            self.mask = live.mask;
        }
    }
}
