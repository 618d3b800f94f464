//! `monoslam evaluate`: compares an estimated trajectory with the true one.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use recordings::{
    Alignment, Evaluation, EvaluationOptions, Trajectory, count_data_lines, evaluate, parse_seconds_ns,
};

use super::picture::Scene;

/// What to compare and how.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// The true trajectory: TUM or EuRoC format
    groundtruth: PathBuf,
    /// The estimated trajectory: TUM or EuRoC format
    estimate: PathBuf,
    /// What is taken out before the comparison: sim3, se3 or none
    #[arg(long, default_value = "sim3")]
    align: Alignment,
    /// Poses further apart in time than this are not of the same image, seconds
    #[arg(long, value_name = "S", default_value = "0.01", value_parser = seconds_ns)]
    max_dt: i64,
    /// List of the recording's images, such as rgb.txt, to measure coverage against [default: the ground
    /// truth]
    #[arg(long, value_name = "FILE")]
    frames: Option<PathBuf>,
    /// Draw both trajectories, seen from above, into an SVG file
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn seconds_ns(text: &str) -> Result<i64, String> {
    parse_seconds_ns(text).filter(|ns| *ns >= 0).ok_or_else(|| "a time in seconds expected".to_owned())
}

/// Compares them.
pub fn run(args: &EvaluateArgs) -> Result<()> {
    let truth = Trajectory::read(&args.groundtruth)?;
    let estimate = Trajectory::read(&args.estimate)?;
    let n_frames = args.frames.as_deref().map(count_data_lines).transpose()?;
    let options = EvaluationOptions { alignment: args.align, max_dt_ns: args.max_dt, n_frames };
    let evaluation = evaluate(&truth, &estimate, &options)?;
    if let Some(path) = &args.picture {
        let title = "The true and the estimated path of the camera, seen from above".to_owned();
        Scene { title, truth: Some(truth), estimate, ..Scene::default() }.write(path)?;
    }
    if args.json {
        println!("{}", serde_json::to_string(&evaluation)?);
    } else {
        print!("{}", table(&evaluation));
    }
    Ok(())
}

fn table(e: &Evaluation) -> String {
    let optional =
        |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |x| format!("{x:.digits$}"));
    let rows = [
        ("poses", format!("{} of {} frames, {} matched", e.poses, e.frames, e.matched)),
        ("coverage", format!("{:.4}", e.coverage)),
        ("ATE RMSE", format!("{:.6}", e.ate_rmse)),
        ("ATE mean / median / max", format!("{:.6} / {:.6} / {:.6}", e.ate_mean, e.ate_median, e.ate_max)),
        ("ATE in % of the path", optional(e.ate_percent_of_path, 4)),
        ("path", format!("{:.3}", e.path)),
        ("rotation RMSE (deg)", format!("{:.4}", e.rot_rmse_deg)),
        ("RPE RMSE, translation", format!("{:.6}", e.rpe_trans_rmse)),
        ("RPE RMSE, rotation (deg)", format!("{:.6}", e.rpe_rot_rmse_deg)),
        ("scale", format!("{:.6}", e.scale)),
        ("scale drift (second half / first)", optional(e.scale_drift, 5)),
    ];
    rows.iter().map(|(name, value)| format!("{name:<34} {value}\n")).collect()
}
