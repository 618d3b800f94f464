//! What became of the frames of a stream, in figures.

use proto::v1;
use serde::{Deserialize, Serialize};

/// Median and 95th percentile of some values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distribution {
    /// Half of the values are not above this.
    pub median: f64,
    /// Nineteen in twenty values are not above this.
    pub p95: f64,
}

impl Distribution {
    /// Of the finite ones among the values; `None` if there are none. Between two values a percentile is
    /// interpolated.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut values: Vec<f64> = values.into_iter().filter(|x| x.is_finite()).collect();
        values.sort_unstable_by(f64::total_cmp);
        Some(Self { median: percentile(&values, 0.5)?, p95: percentile(&values, 0.95)? })
    }
}

fn percentile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    Some(below + (above - below) * place.fract())
}

/// Time spent in one stage of tracking, over the frames in which it ran.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageSummary {
    /// Its name.
    pub name: String,
    /// Frames in which it ran.
    pub frames: usize,
    /// Milliseconds of wall time.
    pub ms: Distribution,
}

/// What became of one frame.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameAnswer {
    /// It was tracked, or tried to be.
    Result(Box<v1::FrameResult>),
    /// It was dropped to keep up.
    Dropped,
    /// It could not be used, for this reason.
    Rejected(String),
}

/// What became of the frames of a stream, in figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StreamSummary {
    /// The session.
    pub session: String,
    /// Frames that were to be streamed.
    pub frames: usize,
    /// Frames with a pose.
    pub tracked: usize,
    /// Frames with a pose that the geometry does not pin down well.
    pub weak: usize,
    /// Frames before there was a map.
    pub initialising: usize,
    /// Frames without a pose.
    pub lost: usize,
    /// Frames dropped to keep up.
    pub dropped: usize,
    /// Frames that could not be used.
    pub rejected: usize,
    /// Frames that the session had already.
    pub repeated: usize,
    /// The share of `frames` that was given a pose as it came. Poses found later, such as those of the frames
    /// from which the map was begun, are in the trajectory and not counted here.
    pub coverage: f64,
    /// Keyframes of the session.
    pub keyframes: u64,
    /// Points of the session.
    pub points: u64,
    /// Lines of the session.
    pub lines: u64,
    /// Global primitives of the session.
    pub primitives: u64,
    /// Submaps of the session.
    pub submaps: u32,
    /// Wall time of tracking a frame, milliseconds.
    pub wall_ms: Option<Distribution>,
    /// Processor time of the tracking thread for a frame, milliseconds.
    pub tracking_cpu_ms: Option<Distribution>,
    /// Wall time by stage, in the order in which stages first ran.
    pub stages: Vec<StageSummary>,
    /// Duration of the recording by the times of its frames, seconds.
    #[serde(default)]
    pub recorded_s: f64,
    /// Time from the first frame sent to the last answered, seconds.
    pub elapsed_s: f64,
    /// Frames answered per second.
    pub frames_per_second: f64,
    /// Duration of the recording over that of the stream; above one is faster than real time.
    pub realtime_factor: f64,
    /// Times the connection was lost and found again.
    pub reconnects: usize,
    /// What the session found out about the camera, last.
    #[serde(default)]
    pub camera: Option<CameraFinding>,
}

/// How the camera that fits the images best differs from its calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFinding {
    /// Relative change of both focal lengths.
    pub focal: f64,
    /// Shift of the principal point to the right, in focal lengths.
    #[serde(rename = "centre_x")]
    pub center_x: f64,
    /// The same downwards.
    #[serde(rename = "centre_y")]
    pub center_y: f64,
    /// The session goes on with that camera; otherwise it is more than a calibration can be wrong by.
    pub adopted: bool,
}

impl StreamSummary {
    /// Adds what the session holds at the end.
    pub fn set_session(&mut self, session: &v1::Session) {
        self.session.clone_from(&session.id);
        self.keyframes = session.n_keyframes;
        self.points = session.n_points;
        self.lines = session.n_lines;
        self.primitives = session.n_primitives;
        self.submaps = session.n_submaps;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_definition() {
        assert_eq!(Distribution::of([]), None);
        assert_eq!(Distribution::of([7.0]), Some(Distribution { median: 7.0, p95: 7.0 }));
        let hundred = Distribution::of((0..=100).rev().map(f64::from)).unwrap();
        assert_eq!((hundred.median, hundred.p95), (50.0, 95.0));
    }
}
