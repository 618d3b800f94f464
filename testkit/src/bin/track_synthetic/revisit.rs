//! Coming back: when the camera first sees a place again, and when the map first knows it.

use crate::recording::Recording;
use slam::Map;

/// Frames between two visits at least: what is nearer in time was in view all along.
const MIN_FRAMES_BETWEEN: usize = 600;
/// Truly as near as this, and turned no more than this, two cameras see the same place.
const MAX_DISTANCE: f64 = 1.0;
const MAX_ANGLE_DEG: f64 = 15.0;
/// Keyframes that share points can be as far apart as this down a corridor; places that look alike are
/// farther.
const MAX_TIE_DISTANCE: f64 = 5.0;
/// Points that two keyframes must share to be tied.
const MIN_SHARED_POINTS: u32 = 15;

/// A place seen again, by the numbers of the frames.
pub struct Revisit {
    /// The first frame that truly shows a place left long before.
    pub shown: usize,
    /// The first keyframe, in the map as it is in the end, that shares points with one of the first visit.
    pub tied: Option<usize>,
    /// Keyframes that share points with one of long before and of another place.
    pub n_false: usize,
}

impl Revisit {
    /// `None` if the camera never comes back.
    pub fn of(map: &Map, recording: &Recording, n_frames: usize) -> Option<Self> {
        let is_revisit = |now: &usize| {
            (0..now.saturating_sub(MIN_FRAMES_BETWEEN)).any(|before| is_near(recording, *now, before))
        };
        let shown = (0..n_frames).find(is_revisit)?;
        let mut revisit = Self { shown, tied: None, n_false: 0 };
        for keyframe in map.keyframes() {
            let now = keyframe.sequence as usize;
            let tied = keyframe.covisible().iter().filter(|(_, n_shared)| *n_shared >= MIN_SHARED_POINTS);
            let tied = tied.filter_map(|(id, _)| Some(map.keyframe(*id)?.sequence as usize));
            let distances = tied
                .filter(|before| before + MIN_FRAMES_BETWEEN < now)
                .map(|before| distance(recording, now, before));
            let Some(nearest) = distances.reduce(f64::min) else { continue };
            if nearest > MAX_TIE_DISTANCE {
                revisit.n_false += 1;
            } else {
                revisit.tied = Some(revisit.tied.map_or(now, |tied| tied.min(now)));
            }
        }
        Some(revisit)
    }

    pub fn in_table(&self) -> String {
        let tied = self.tied.map_or("-".to_owned(), |tied| tied.to_string());
        let falsely = if self.n_false > 0 { format!(" ({} false)", self.n_false) } else { String::new() };
        format!("{}, {tied}{falsely}", self.shown)
    }

    pub fn print(&self) {
        println!(
            "a place is seen again from frame on, tied to the first visit at frame: {}",
            self.in_table()
        );
    }
}

fn is_near(recording: &Recording, a: usize, b: usize) -> bool {
    let angle = recording.camera_from_world(a).rotation.angle_to(&recording.camera_from_world(b).rotation);
    distance(recording, a, b) <= MAX_DISTANCE && angle.to_degrees() <= MAX_ANGLE_DEG
}

fn distance(recording: &Recording, a: usize, b: usize) -> f64 {
    (recording.camera_from_world(a).center() - recording.camera_from_world(b).center()).norm()
}
