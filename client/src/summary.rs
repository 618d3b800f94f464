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
    /// Counts and times the answers to the frames of a stream, one for each frame.
    pub fn of_answers(answers: &[Option<FrameAnswer>]) -> Self {
        let mut summary = Self { frames: answers.len(), ..Self::default() };
        let mut results = Vec::new();
        for answer in answers.iter().flatten() {
            match answer {
                FrameAnswer::Result(result) => {
                    summary.count(result);
                    results.push(result.as_ref());
                }
                FrameAnswer::Dropped => summary.dropped += 1,
                FrameAnswer::Rejected(_) => summary.rejected += 1,
            }
        }
        let n_with_pose = results.iter().filter(|result| result.pose_world_from_camera.is_some()).count();
        summary.coverage = n_with_pose as f64 / answers.len().max(1) as f64;
        let timings: Vec<&v1::FrameTimings> = results.iter().filter_map(|r| r.timings.as_ref()).collect();
        summary.wall_ms = Distribution::of(timings.iter().map(|t| t.total_ms));
        summary.tracking_cpu_ms = Distribution::of(timings.iter().map(|t| t.tracking_cpu_ms));
        summary.stages = stages(&timings);
        summary
    }

    fn count(&mut self, result: &v1::FrameResult) {
        if let Some(found) = result.corrections.iter().rev().find_map(|correction| correction.camera) {
            let v1::CameraCorrection { focal, centre_x: center_x, centre_y: center_y, adopted } = found;
            self.camera = Some(CameraFinding { focal, center_x, center_y, adopted });
        }
        self.repeated += usize::from(result.repeated);
        match result.state() {
            v1::TrackingState::Tracked => self.tracked += 1,
            v1::TrackingState::Weak => self.weak += 1,
            v1::TrackingState::Initialising => self.initialising += 1,
            v1::TrackingState::Lost => self.lost += 1,
            // A repeated frame whose answer the server no longer has.
            v1::TrackingState::Unspecified => {}
        }
    }

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

fn stages(timings: &[&v1::FrameTimings]) -> Vec<StageSummary> {
    let mut times: Vec<(&str, Vec<f64>)> = Vec::new();
    for stage in timings.iter().flat_map(|t| &t.stages) {
        match times.iter_mut().find(|(name, _)| *name == stage.name) {
            Some((_, values)) => values.push(stage.ms),
            None => times.push((&stage.name, vec![stage.ms])),
        }
    }
    let summary = |(name, values): (&str, Vec<f64>)| {
        let frames = values.len();
        Some(StageSummary { name: name.to_owned(), frames, ms: Distribution::of(values)? })
    };
    times.into_iter().filter_map(summary).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(state: v1::TrackingState, total_ms: f64, stages: &[(&str, f64)]) -> Option<FrameAnswer> {
        let has_pose = matches!(state, v1::TrackingState::Tracked | v1::TrackingState::Weak);
        let stage = |(name, ms): &(&str, f64)| v1::StageTime { name: (*name).to_owned(), ms: *ms };
        let timings = v1::FrameTimings {
            stages: stages.iter().map(stage).collect(),
            total_ms,
            tracking_cpu_ms: total_ms / 2.0,
            queue_ms: 0.0,
        };
        Some(FrameAnswer::Result(Box::new(v1::FrameResult {
            state: state.into(),
            pose_world_from_camera: has_pose.then(v1::Pose::default),
            timings: Some(timings),
            ..Default::default()
        })))
    }

    #[test]
    fn every_frame_is_counted_once() {
        use v1::TrackingState::{Initialising, Lost, Tracked, Weak};
        let answers = [
            answer(Initialising, 1.0, &[("points", 1.0)]),
            answer(Tracked, 2.0, &[("points", 3.0), ("pose", 0.5)]),
            answer(Weak, 3.0, &[("points", 2.0)]),
            answer(Lost, 4.0, &[]),
            Some(FrameAnswer::Dropped),
            Some(FrameAnswer::Rejected("too small".into())),
            None,
            answer(Tracked, f64::NAN, &[]),
        ];
        let summary = StreamSummary::of_answers(&answers);
        assert_eq!((summary.frames, summary.tracked, summary.weak, summary.initialising), (8, 2, 1, 1));
        assert_eq!((summary.lost, summary.dropped, summary.rejected), (1, 1, 1));
        assert_eq!(summary.coverage, 3.0 / 8.0);
        assert_eq!(summary.wall_ms.unwrap().median, 2.5);
        assert_eq!(summary.tracking_cpu_ms.unwrap().median, 1.25);
        let stages: Vec<_> =
            summary.stages.iter().map(|s| (s.name.as_str(), s.frames, s.ms.median)).collect();
        assert_eq!(stages, [("points", 3, 2.0), ("pose", 1, 0.5)]);
    }

    #[test]
    fn percentiles_are_those_of_the_definition() {
        assert_eq!(Distribution::of([]), None);
        assert_eq!(Distribution::of([7.0]), Some(Distribution { median: 7.0, p95: 7.0 }));
        let hundred = Distribution::of((0..=100).rev().map(f64::from)).unwrap();
        assert_eq!((hundred.median, hundred.p95), (50.0, 95.0));
    }
}
