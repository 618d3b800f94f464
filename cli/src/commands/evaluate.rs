//! `monoslam evaluate`: compares an estimated trajectory with the true one.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use recordings::{
    Alignment, Evaluation, EvaluationOptions, ReadTrajectory, StampedPose, TimeOffset, TimeUnit, Trajectory,
    evaluate, find_offset, hints, parse_seconds_ns, read_times,
};
use serde_json::json;

use super::picture::Scene;

/// What to compare and how.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// The true trajectory: TUM, EuRoC or KITTI format
    groundtruth: PathBuf,
    /// The estimated trajectory: TUM, EuRoC or KITTI format
    estimate: PathBuf,
    /// What is taken out before the comparison: sim3, se3 or none
    #[arg(long, default_value = "sim3")]
    align: Alignment,
    /// Poses further apart in time than this are not of the same image, seconds
    #[arg(long, value_name = "S", default_value = "0.01", value_parser = seconds_ns)]
    max_dt: i64,
    /// List of the recording's images with their times, such as rgb.txt or times.txt: to measure coverage
    /// against [default: the ground truth], and the times of files in KITTI format
    #[arg(long, value_name = "FILE")]
    frames: Option<PathBuf>,
    /// Unit of the times in both files: s, ms, us or ns [default: told by their size]
    #[arg(long, value_name = "UNIT")]
    times: Option<TimeUnit>,
    /// Shift the times of the estimate by the constant offset under which it agrees best with the truth
    #[arg(long)]
    find_offset: bool,
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
    let frames = args.frames.as_deref().map(read_times).transpose()?;
    let (truth, estimate) = read_both(args, frames.as_deref())?;
    let offset = find_offset(&truth, &estimate);
    let (estimate, shift) = match offset {
        Some(found) if args.find_offset => (shifted(&estimate, found.offset_ns), Some(found)),
        _ => (estimate, None),
    };
    let n_frames = frames.map(|times| times.len());
    let options = EvaluationOptions { alignment: args.align, max_dt_ns: args.max_dt, n_frames };
    let outcome = evaluate(&truth, &estimate, &options);
    if let (Some(found), false) = (offset, args.find_offset) {
        eprintln!("{}", offer(&found));
    }
    let evaluation = outcome?;
    for hint in hints(&truth, &estimate, &options, &evaluation) {
        eprintln!("{hint}");
    }
    if let Some(path) = &args.picture {
        let title = "The true and the estimated path of the camera, seen from above".to_owned();
        Scene { title, truth: Some(truth), estimate, ..Scene::default() }.write(path)?;
    }
    if args.json {
        let mut object = serde_json::to_value(&evaluation)?;
        object["time_offset_ns"] = json!(shift.map(|found| found.offset_ns));
        println!("{object}");
    } else {
        if let Some(found) = shift {
            println!("{:<34} {:+.6} s", "times of the estimate shifted by", found.offset_ns as f64 * 1e-9);
        }
        print!("{}", table(&evaluation));
    }
    Ok(())
}

/// Both trajectories, those without times with the times of the images.
fn read_both(args: &EvaluateArgs, frames: Option<&[i64]>) -> Result<(Trajectory, Trajectory)> {
    let read = |path: &Path| -> Result<ReadTrajectory> {
        let read = Trajectory::read_as(path, args.times)?;
        for remark in read.remarks(path) {
            eprintln!("{remark}");
        }
        Ok(read)
    };
    let (truth, estimate) = (read(&args.groundtruth)?, read(&args.estimate)?);
    if !truth.has_times && !estimate.has_times && frames.is_none() {
        return Ok((truth.trajectory, estimate.trajectory));
    }
    let timed = |read: ReadTrajectory, path: &Path| match read.has_times {
        true => Ok(read.trajectory),
        false => {
            let name = path.display();
            let frames = frames.with_context(|| {
                format!("{name} is in KITTI format, which has no times: give the list of images with --frames times.txt")
            })?;
            let n_poses = read.trajectory.len() + read.n_without_pose;
            ensure!(
                n_poses == frames.len(),
                "{name} has {n_poses} poses, but the list of images {}",
                frames.len()
            );
            Ok(Trajectory::read_kitti(path, frames)?)
        }
    };
    Ok((timed(truth, &args.groundtruth)?, timed(estimate, &args.estimate)?))
}

fn shifted(trajectory: &Trajectory, offset_ns: i64) -> Trajectory {
    let poses = trajectory.poses().iter();
    let shifted =
        poses.map(|pose| StampedPose { timestamp_ns: pose.timestamp_ns.saturating_add(offset_ns), ..*pose });
    Trajectory::new(shifted.collect())
}

fn offer(found: &TimeOffset) -> String {
    let better = match found.gain {
        gain if gain < 1000.0 => format!("the positions agree {gain:.0} times better"),
        _ => "the positions agree".to_owned(),
    };
    let seconds = found.offset_ns as f64 * 1e-9;
    format!("with {seconds:+.6} s added to the times of the estimate {better}; --find-offset does that")
}

fn table(e: &Evaluation) -> String {
    let optional =
        |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |x| format!("{x:.digits$}"));
    let rows = [
        (
            "poses",
            format!(
                "{} of {} frames, {} matched ({:.1} %)",
                e.poses,
                e.frames,
                e.matched,
                100.0 * e.matched_share
            ),
        ),
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
        (
            "KITTI segments, t_rel / r_rel",
            e.segments.map_or("-".to_owned(), |errors| {
                let (t, r) = (errors.t_rel_percent, errors.r_rel_deg_per_100m);
                format!("{t:.4} % / {r:.4} deg per 100 m")
            }),
        ),
    ];
    rows.iter().map(|(name, value)| format!("{name:<34} {value}\n")).collect()
}
