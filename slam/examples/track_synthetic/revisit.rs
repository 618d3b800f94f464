//! Coming back: when the camera first sees a place again, and when the map first knows it.

use crate::recording::Recording;
use slam::{Keyframe, Map};

/// Frames between two visits at least: what is nearer in time was in view all along.
const MIN_FRAMES_BETWEEN: usize = 600;
/// Truly as near as this, and turned no more than this, two cameras see the same place.
const MAX_DISTANCE: f64 = 1.0;
const MAX_ANGLE_DEG: f64 = 15.0;
/// Points that two key frames must share to be tied.
const MIN_SHARED_POINTS: u32 = 15;

/// A place seen again, by the numbers of the frames.
pub struct Revisit {
    /// The first frame that truly shows a place left long before.
    pub shown: usize,
    /// The first key frame that shares points with one of the first visit.
    pub tied: Option<usize>,
}

impl Revisit {
    /// `None` if the camera never comes back.
    pub fn of(map: &Map, recording: &Recording, n_frames: usize) -> Option<Self> {
        let is_revisit = |now: &usize| {
            (0..now.saturating_sub(MIN_FRAMES_BETWEEN)).any(|before| is_near(recording, *now, before))
        };
        let shown = (0..n_frames).find(is_revisit)?;
        let index = |keyframe: &Keyframe| keyframe.sequence as usize;
        let is_tied = |keyframe: &&Keyframe| {
            keyframe.covisible().iter().any(|(id, n_shared)| {
                let other = map.keyframe(*id).map(index);
                *n_shared >= MIN_SHARED_POINTS
                    && other.is_some_and(|other| other + MIN_FRAMES_BETWEEN < index(keyframe))
            })
        };
        Some(Self { shown, tied: map.keyframes().filter(is_tied).map(index).min() })
    }

    pub fn in_table(&self) -> String {
        format!("{}, {}", self.shown, self.tied.map_or("-".to_owned(), |tied| tied.to_string()))
    }

    pub fn print(&self) {
        match self.tied {
            Some(tied) => println!(
                "a place is seen again from frame {} on, and tied to the first visit at frame {tied}",
                self.shown
            ),
            None => println!(
                "a place is seen again from frame {} on, but not tied to the first visit",
                self.shown
            ),
        }
    }
}

fn is_near(recording: &Recording, a: usize, b: usize) -> bool {
    let (a, b) = (recording.camera_from_world(a), recording.camera_from_world(b));
    (a.centre() - b.centre()).norm() <= MAX_DISTANCE
        && a.rotation.angle_to(&b.rotation).to_degrees() <= MAX_ANGLE_DEG
}
