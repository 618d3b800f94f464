//! The runs of one recording taken together.

use client::{Distribution, StageSummary};
use serde::Serialize;

use super::child::RunResult;

/// Median, least and greatest of a figure over runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The middle one.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Of the values there are; `None` if there are none.
    fn of(values: impl IntoIterator<Item = Option<f64>>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().flatten().collect();
        let median = Distribution::of(values.iter().copied())?.median;
        let min = values.iter().copied().fold(f64::INFINITY, f64::min);
        let max = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(Self { median, min, max })
    }
}

/// One recording in one configuration.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The recording's name.
    pub sequence: String,
    /// The features that were on.
    pub configuration: &'static str,
    /// Share of frames with a pose in the trajectory.
    pub coverage: Option<Spread>,
    /// ATE RMSE after similarity alignment.
    pub ate_rmse: Option<Spread>,
    /// Scale of the second half over that of the first.
    pub scale_drift: Option<Spread>,
    /// Keyframes.
    pub keyframes: Option<Spread>,
    /// Points.
    pub points: Option<Spread>,
    /// Lines.
    pub lines: Option<Spread>,
    /// Global primitives.
    pub primitives: Option<Spread>,
    /// Wall time per frame, milliseconds: medians over runs of the runs' median and 95th percentile.
    pub wall_ms: Option<Distribution>,
    /// Processor time of the tracking thread per frame, likewise.
    pub tracking_cpu_ms: Option<Distribution>,
    /// Processor time of server and client together for a frame, all threads, milliseconds.
    pub process_cpu_ms: Option<Spread>,
    /// Wall time by stage, likewise.
    pub stages: Vec<StageSummary>,
    /// Duration of the recording over that of the run.
    pub realtime_factor: Option<Spread>,
    /// Share of frames dropped.
    pub dropped: Option<Spread>,
    /// Peak of resident memory of server and client together, MiB.
    pub peak_memory_mib: Option<Spread>,
    /// The runs.
    pub runs: Vec<RunResult>,
}

impl Row {
    /// Takes runs together; `None` if there are none.
    pub fn new(configuration: &'static str, runs: Vec<RunResult>) -> Option<Self> {
        let over = |figure: fn(&RunResult) -> Option<f64>| Spread::of(runs.iter().map(figure));
        Some(Self {
            sequence: runs.first()?.sequence.clone(),
            configuration,
            coverage: over(|run| Some(run.coverage)),
            ate_rmse: over(|run| Some(run.evaluation.as_ref()?.ate_rmse)),
            scale_drift: over(|run| run.evaluation.as_ref()?.scale_drift),
            keyframes: over(|run| Some(run.summary.keyframes as f64)),
            points: over(|run| Some(run.summary.points as f64)),
            lines: over(|run| Some(run.summary.lines as f64)),
            primitives: over(|run| Some(run.summary.primitives as f64)),
            wall_ms: typical(runs.iter().filter_map(|run| run.summary.wall_ms)),
            tracking_cpu_ms: typical(runs.iter().filter_map(|run| run.summary.tracking_cpu_ms)),
            process_cpu_ms: over(|run| run.process_cpu_ms),
            stages: stages(&runs),
            realtime_factor: over(|run| Some(run.summary.realtime_factor)),
            dropped: over(|run| Some(run.summary.dropped as f64 / run.summary.frames.max(1) as f64)),
            peak_memory_mib: over(|run| run.peak_memory_mib),
            runs,
        })
    }
}

/// Median of the medians and median of the 95th percentiles.
fn typical(distributions: impl Iterator<Item = Distribution>) -> Option<Distribution> {
    let (medians, p95s): (Vec<f64>, Vec<f64>) = distributions.map(|d| (d.median, d.p95)).unzip();
    Some(Distribution { median: Distribution::of(medians)?.median, p95: Distribution::of(p95s)?.median })
}

/// The stages of all runs, in the order in which they first appear.
fn stages(runs: &[RunResult]) -> Vec<StageSummary> {
    let all = || runs.iter().flat_map(|run| &run.summary.stages);
    let mut names: Vec<&str> = Vec::new();
    for stage in all() {
        if !names.contains(&stage.name.as_str()) {
            names.push(&stage.name);
        }
    }
    let summary = |name: &str| {
        let same = || all().filter(|stage| stage.name == name);
        let frames = Distribution::of(same().map(|stage| stage.frames as f64))?.median.round() as usize;
        Some(StageSummary { name: name.to_owned(), frames, ms: typical(same().map(|stage| stage.ms))? })
    };
    names.into_iter().filter_map(summary).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use client::StreamSummary;

    fn run(coverage: f64, wall_ms: f64, stage_ms: f64) -> RunResult {
        let distribution = |median| Distribution { median, p95: 2.0 * median };
        let stage = StageSummary { name: "points".into(), frames: 10, ms: distribution(stage_ms) };
        RunResult {
            sequence: "room".into(),
            coverage,
            evaluation: None,
            summary: StreamSummary {
                frames: 10,
                dropped: 1,
                wall_ms: Some(distribution(wall_ms)),
                stages: vec![stage],
                ..Default::default()
            },
            peak_memory_mib: None,
            process_cpu_ms: Some(3.0 * wall_ms),
        }
    }

    #[test]
    fn figures_are_medians_over_runs() {
        let runs = vec![run(0.5, 9.0, 1.0), run(0.9, 7.0, 3.0), run(0.8, 8.0, 2.0)];
        let row = Row::new("P", runs).unwrap();
        assert_eq!(row.coverage, Some(Spread { median: 0.8, min: 0.5, max: 0.9 }));
        assert_eq!(row.wall_ms, Some(Distribution { median: 8.0, p95: 16.0 }));
        assert_eq!((row.stages.len(), row.stages[0].ms.median), (1, 2.0));
        assert_eq!((row.ate_rmse, row.peak_memory_mib), (None, None));
        assert_eq!(row.process_cpu_ms.unwrap().median, 24.0);
        assert_eq!(row.dropped.unwrap().median, 0.1);
        assert!(Row::new("P", Vec::new()).is_none());
    }
}
